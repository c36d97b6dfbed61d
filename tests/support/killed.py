"""Kills processes at moments of their work: see :mod:`support.recorder`."""

import json
import random
import signal
import subprocess
import sys

from support import recorder


class Processes:
    """Starts processes of :mod:`support.recorder`, and kills them."""

    def __init__(self):
        self._parent = subprocess.Popen(
            [sys.executable, recorder.__file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def run(self, action, *arguments, kill_after_s=None):
        """Run an action; the seconds that it took, None if it was killed first."""
        self._parent.stdin.write(json.dumps([action, kill_after_s, *map(str, arguments)]) + "\n")
        self._parent.stdin.flush()
        status, seconds = self._parent.stdout.readline().split()
        assert int(status) in (0, -signal.SIGKILL)
        return None if int(status) else float(seconds)

    def close(self):
        self._parent.communicate(timeout=60)


def moments(kills, longest_s, reached=(True,)):
    """When to kill, seconds after the start: at any moment, with all parts of the time alike.

    Later and later then, on a machine that has become slower, until a kill has ``reached`` some work.
    """
    draw = random.Random(kills)
    yield from ((i + draw.random()) / kills * longest_s for i in range(kills))
    for doubling in range(1, 6):
        if any(reached):
            return
        yield 2**doubling * longest_s
