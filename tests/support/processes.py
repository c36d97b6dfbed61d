"""Programs in processes of their own, and the signals that they inherit as ignored."""

import signal
import subprocess
import sys
from contextlib import contextmanager

OMNISCV = ("-c", "from omniscv.cli import main; main()")


@contextmanager
def started(*arguments, ignored=(), **options):
    """Start Python; kill it at the end, should it still run.

    Shells start jobs in the background with SIGINT ignored, and ``nohup`` has SIGHUP ignored, which may be
    how the tests themselves were started: here only ``ignored`` are. Options are those of Popen.
    """
    handlers = {
        number: signal.SIG_IGN if number in ignored else signal.SIG_DFL
        for number in (signal.SIGINT, signal.SIGHUP)
    }
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        process = subprocess.Popen(
            [sys.executable, *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            **options,
        )
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()
