"""What the tests of launched games share."""

import json
import os
import time
from pathlib import Path

STAND_IN = Path(__file__).parents[1] / "sources" / "unreal" / "game.py"


def beside(game):
    return game.parent / "Game" / "Binaries" / "Linux"


def behave(game, **behaviour):
    (beside(game) / "behaviour.json").write_text(json.dumps(behaviour))


def is_running(game):
    try:
        os.kill(int((beside(game) / "pid").read_text()), 0)
    except ProcessLookupError:
        return False
    return True


def waited_for(condition):
    """Whether it comes true within a time that is long for any machine."""
    until = time.monotonic() + 60
    while not condition() and time.monotonic() < until:
        time.sleep(0.02)
    return condition()
