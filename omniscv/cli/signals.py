"""SIGINT, SIGTERM and SIGHUP unwind a command, so that its files are whole and its games stop."""

import atexit
import os
import signal
import sys
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

STOPPED = 128 + signal.SIGINT
"""The exit code of a stopped command if its signal is not known."""

_ONE_STOP_S = 1.0
"""Signals within this time count as one: terminals and ``timeout`` send several."""

_received: list[int] = []


def check() -> None:
    """Raise KeyboardInterrupt after a signal: one raised within an import or callback may be lost."""
    if _received:
        raise KeyboardInterrupt


def _unraisable(lost: Any) -> None:
    """Print an unraisable error, except a stop raised in ``__del__``, which :func:`check` raises again."""
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)


def unwound(command: Callable[[], int]) -> int:
    """Run a command and return its exit code: 128 + the signal's number if a signal stopped it.

    Each signal raises KeyboardInterrupt in the main thread. An inherited SIG_IGN of SIGINT, as in background
    jobs of a shell, is overridden; that of SIGHUP, as under ``nohup``, is kept.
    """
    _received.clear()
    latest = -_ONE_STOP_S

    def stop(number: int, _: FrameType | None) -> None:
        nonlocal latest
        if time.monotonic() - latest > _ONE_STOP_S:
            latest = time.monotonic()
            _received.append(number)
            raise KeyboardInterrupt

    def end(number: int, _: FrameType | None) -> None:
        os._exit(128 + (_received or [number])[0])

    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    for number in numbers:
        signal.signal(number, stop)
        atexit.register(signal.signal, number, signal.SIG_IGN)  # the shutdown restores the default: it kills
    sys.unraisablehook = _unraisable
    try:
        code = command()
    except KeyboardInterrupt:
        code = STOPPED
    except Exception:
        if not _received:
            raise
        code = STOPPED  # an interrupted import may raise anything
    finally:
        for number in numbers:
            signal.signal(number, end)  # a second signal ends the process at once
    return 128 + _received[0] if code == STOPPED and _received else code
