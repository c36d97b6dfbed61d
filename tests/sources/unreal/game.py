"""A stand-in for a packaged game: reads unrealcv.ini beside itself and serves the four-wall room there.

A file ``behaviour.json`` beside it makes it wait ``wait_s`` first, or say ``words`` and end with ``code``.
"""

import configparser
import json
import os
import sys
import threading
from pathlib import Path

HERE = Path(sys.argv[0]).resolve().parent

if __name__ == "__main__":
    (HERE / "pid").write_text(str(os.getpid()))
    import mock_server  # takes long: who starts the game can find its process before

    behaviour = {"wait_s": 0}
    if (HERE / "behaviour.json").exists():
        behaviour = json.loads((HERE / "behaviour.json").read_text())
    if "code" in behaviour:
        print(behaviour["words"], flush=True)
        sys.exit(behaviour["code"])
    settings = configparser.ConfigParser()
    settings.read(HERE / "unrealcv.ini")
    core = settings["UnrealCV.Core"]
    (HERE / "settings.json").write_text(json.dumps(dict(core)))
    threading.Event().wait(behaviour["wait_s"])
    size = (int(core["Width"]), int(core["Height"]))
    fov_deg = float(core["FOV"])
    with mock_server.serve("four-wall", int(core["Port"]), size=size, fov_deg=fov_deg):
        threading.Event().wait()
