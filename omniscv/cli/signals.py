"""SIGINT, SIGTERM and SIGHUP unwind a command, so that its files are whole and its games stop."""

import atexit
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

STOPPED = 128 + signal.SIGINT
"""The exit code of a command that was stopped; of its signal where that is known."""

_ONE_STOP_S = 1.0
"""Signals within this time are one: terminals and ``timeout`` send several."""

_received: list[int] = []


def check() -> None:
    """Raise KeyboardInterrupt where a signal has come: raised within an import or callback it may be lost."""
    if _received:
        raise KeyboardInterrupt


def _unraisable(lost: Any) -> None:
    """Print what Python ignores, but for a stop raised in ``__del__``, which :func:`check` notices."""
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)


def _end(number: int, _: FrameType | None) -> None:
    os._exit(128 + (_received or [number])[0])


def _ignore(numbers: Sequence[int]) -> None:
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)


def unwound(command: Callable[[], int]) -> int:
    """Run a command and return its exit code: 128 + the signal's number where a signal stopped it.

    Each signal raises KeyboardInterrupt in the main thread. SIGINT counts also where it is ignored, as by
    background jobs of a shell; SIGHUP does not, as under ``nohup``.
    """
    _received.clear()
    latest = -_ONE_STOP_S

    def stop(number: int, _: FrameType | None) -> None:
        nonlocal latest
        if time.monotonic() - latest > _ONE_STOP_S:
            latest = time.monotonic()
            _received.append(number)
            raise KeyboardInterrupt

    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    for number in numbers:
        signal.signal(number, stop)
    atexit.register(_ignore, numbers)  # Python's own end brings the default back, which kills
    sys.unraisablehook = _unraisable
    try:
        code = command()
    except KeyboardInterrupt:
        code = STOPPED
    except Exception:
        if not _received:
            raise
        code = STOPPED  # an import that was interrupted may raise anything
    finally:
        for number in numbers:
            signal.signal(number, _end)  # what is left of the process ends at once
    return 128 + _received[0] if code == STOPPED and _received else code
