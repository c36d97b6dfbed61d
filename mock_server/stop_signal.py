"""The end of a server that runs in the foreground: the first SIGINT, SIGTERM or SIGHUP."""

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

_POLL_S = 0.1


@contextlib.contextmanager
def stop_signal() -> Iterator[Callable[..., signal.Signals | None]]:
    """Record SIGINT, SIGTERM and SIGHUP instead of ending the process; for the main thread only.

    Enter it before the server starts, so that no signal is lost in between::

        with mock_server.stop_signal() as wait, mock_server.serve("four-wall") as server:
            print(server.uri)
            wait(server)

    SIGINT counts also where the process inherited it as ignored, as shells start background jobs (``serve &``
    in a script): Ctrl-C then ends the script and its server. SIGHUP does not: ``nohup`` ignores it on
    purpose. The previous handlers are restored at the end.

    Yields:
        A function that waits for the first signal, and returns it at most 0.1 s after it came; None if the
        server that it is given has ended by itself.
    """
    received: list[signal.Signals] = []

    def handle(number: int, _: FrameType | None) -> None:
        """Record the signal ``number``; the frame ``_`` that it interrupts goes on."""
        received.append(signal.Signals(number))

    def wait(server: Any = None) -> signal.Signals | None:
        # The kernel may deliver a signal to any thread, but Python runs handlers in the main thread only, and
        # only when that runs Python code: so it must never sleep for long.
        while not received:
            if server is not None and not server.running:
                return None
            time.sleep(_POLL_S)
        return received[0]

    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    previous = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield wait
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler or signal.SIG_DFL)  # None: not installed from Python
