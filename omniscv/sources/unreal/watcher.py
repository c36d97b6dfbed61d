"""Runs a game, and stops it when the process that started this program is done or gone, also after SIGKILL.

A program of its own, of the standard library alone: ``watcher.py GRACE_S GAME``. It writes one line: the
game's process id, or why it cannot be run. Anything on the standard input, or its end, stops the game.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress

_POLL_S = 0.05


def main() -> int:
    """Return the game's exit code, negative for a signal."""
    grace_s = float(sys.argv[1])
    path = sys.argv[2]
    for number in {signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)}:
        signal.signal(number, lambda *_: None)  # not SIG_IGN, which the game would inherit
    try:
        game = subprocess.Popen(
            [path],
            cwd=os.path.dirname(path),
            stdin=subprocess.DEVNULL,
            stdout=sys.stderr.fileno(),
            stderr=sys.stderr.fileno(),
            process_group=0,  # the game's children too
        )
    except OSError as cause:
        _print(cause)
        return 1
    try:
        _print(game.pid)
        stopping = threading.Event()
        threading.Thread(target=_wait_for_input, args=(stopping,), daemon=True).start()
        while game.poll() is None and not stopping.wait(_POLL_S):
            pass
    finally:
        _stop(game, grace_s)
    return game.wait()


def _print(line: object) -> None:
    with suppress(OSError):  # the process that started this one may be gone already
        os.write(sys.stdout.fileno(), f"{line}\n".encode())


def _wait_for_input(stopping: threading.Event) -> None:
    os.read(0, 1)
    stopping.set()


def _stop(game: "subprocess.Popen[bytes]", grace_s: float) -> None:
    """End a game and its children, even if the game has ended: SIGTERM, and SIGKILL after ``grace_s``."""
    if sys.platform == "win32":  # there are no process groups: end the tree
        subprocess.run(["taskkill", "/T", "/F", "/PID", str(game.pid)], check=False, capture_output=True)
        return
    deadline = time.monotonic() + grace_s
    with suppress(ProcessLookupError, PermissionError):  # the latter on macOS, of processes that have ended
        os.killpg(game.pid, signal.SIGTERM)
        while time.monotonic() < deadline:
            game.poll()
            os.killpg(game.pid, 0)
            time.sleep(_POLL_S)
        os.killpg(game.pid, signal.SIGKILL)


if __name__ == "__main__":
    code = main()
    os._exit(code if code >= 0 else 128 - code)  # without waiting for the thread that reads
