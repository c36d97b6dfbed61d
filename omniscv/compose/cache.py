"""Values kept for the next image, within a bound in bytes."""

import os
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable
from threading import RLock
from typing import Any, Protocol, TypeVar


class Sized(Protocol):
    """A value that knows its size; it may grow while it is used."""

    @property
    def nbytes(self) -> int: ...


T = TypeVar("T", bound=Sized)


class ByteCache:
    """The values used last; safe to use from several threads, and in forked children.

    Args:
        limit: bytes, all values together, once :meth:`trim` has run.
    """

    def __init__(self, limit: int) -> None:
        self.limit, self._lock_here = limit, (RLock(), os.getpid())
        self._values: OrderedDict[Hashable, Any] = OrderedDict()
        self._seen_once: deque[int] = deque(maxlen=64)
        self._newest: Sized | None = None

    def get(self, key: Hashable, make: Callable[[], T], *, keep_at_once: bool = True) -> T:
        """Return the value of a key, made where there is none. Two threads may both make it; one is kept.

        Args:
            key: of the value.
            make: makes it.
            keep_at_once: keep it now; else only when the key comes a second time, so that a sequence of
                values that are used once displaces nothing.
        """
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                found: T = self._values[key]
                return found
            keep = keep_at_once or hash(key) in self._seen_once
            if not keep:
                self._seen_once.append(hash(key))
        made = make()
        with self._lock:
            if not keep:
                # Held until the next one is made: memory that is given back meanwhile costs fresh pages.
                self._newest = made
                return made
            kept: T = self._values.setdefault(key, made)
            return kept

    @property
    def _lock(self) -> RLock:
        """Its lock; a new one in a forked child, where a thread that is not there may hold the old one."""
        lock, process = self._lock_here
        if process != os.getpid():
            lock, _ = self._lock_here = RLock(), os.getpid()
        return lock

    def trim(self) -> None:
        """Drop the values that were not used for longest, until the rest is within the bound."""
        with self._lock:
            if self.nbytes > self.limit:
                self._newest = None
            while self.nbytes > self.limit:
                self._values.popitem(last=False)

    @property
    def nbytes(self) -> int:
        """What is held in memory."""
        with self._lock:
            return sum(value.nbytes for value in (*self._values.values(), self._newest) if value is not None)
