"""Values kept for the next image, within a bound in bytes."""

import os
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable
from threading import RLock
from typing import Any, Protocol, TypeVar


class Sized(Protocol):
    """A value with its size; it may grow while it is used."""

    @property
    def nbytes(self) -> int: ...


T = TypeVar("T", bound=Sized)
_REMEMBERED = 64  # keys


class ByteCache:
    """The values used last; safe to use from several threads, and in forked children.

    Args:
        limit: bytes, all values together, once :meth:`trim` has run.
    """

    def __init__(self, limit: int) -> None:
        self.limit, self._lock_here = limit, (RLock(), os.getpid())
        self._values: OrderedDict[Hashable, Any] = OrderedDict()
        self._made_once: deque[int] = deque(maxlen=_REMEMBERED)

    def get(self, key: Hashable, make: Callable[[], T], *, keep_at_once: bool = True) -> T:
        """Return the value of a key, made where there is none. Two threads may both make it; one is kept.

        Args:
            key: of the value.
            make: makes it.
            keep_at_once: keep it now; else only if it is made a second time, so that memory does not grow
                with a sequence of values that are used once.
        """
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                kept: T = self._values[key]
                return kept
            keep = keep_at_once or hash(key) in self._made_once
            if not keep:
                self._made_once.append(hash(key))
        value = make()
        if keep:
            with self._lock:
                value = self._values.setdefault(key, value)
        return value

    @property
    def _lock(self) -> RLock:
        """The lock; a new one in a forked child, where a thread that does not exist there may hold the old
        one."""
        lock, process = self._lock_here
        if process != os.getpid():
            lock, _ = self._lock_here = RLock(), os.getpid()
        return lock

    def trim(self) -> None:
        """Drop the values that were not used for longest, until the rest is within the bound."""
        with self._lock:
            while self.nbytes > self.limit:
                self._values.popitem(last=False)

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        with self._lock:
            return sum(value.nbytes for value in self._values.values())
