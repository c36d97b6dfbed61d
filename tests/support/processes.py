"""Programs in processes of their own, and the signals that they inherit as ignored; functions in children."""

import multiprocessing
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


def sent_by_child(method, target, *arguments, timeout_s=60):
    """What a child process sends through the pipe that ``target`` gets first; one that hangs is killed."""
    context = multiprocessing.get_context(method)
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=target, args=(sender, *arguments))
    child.start()
    sender.close()
    try:
        assert receiver.poll(timeout_s), "the child hangs"
        message = receiver.recv()
        child.join(timeout_s)
        assert child.exitcode == 0
        return message
    finally:
        child.kill()
        child.join()
