"""Values kept for the next image, within a bound in bytes."""

from collections import deque
from collections.abc import Callable, Hashable
from typing import Any, Protocol, TypeVar


class Sized(Protocol):
    """A value with its size; it may grow while it is used."""

    @property
    def nbytes(self) -> int: ...


T = TypeVar("T", bound=Sized)
_REMEMBERED = 64  # keys


class ByteCache:
    """The values used last.

    Safe to use from several threads and in forked children: it has no lock, only single operations on its
    containers. Two threads may both make a value; one is kept.

    Args:
        limit: bytes, all values together, once :meth:`trim` has run.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._values: dict[Hashable, Any] = {}  # in the order of their last use
        self._made_once: deque[int] = deque(maxlen=_REMEMBERED)

    def get(self, key: Hashable, make: Callable[[], T], *, keep_at_once: bool = True) -> T:
        """Return the value of a key, made where there is none.

        Args:
            key: of the value.
            make: makes it.
            keep_at_once: keep it now; else only if it is made a second time, so that memory does not grow
                with a sequence of values that are used once.
        """
        value: T | None = self._values.pop(key, None)
        if value is None:
            value = make()
            if not keep_at_once and hash(key) not in self._made_once:
                self._made_once.append(hash(key))
                return value
        self._values[key] = value
        return value

    def trim(self) -> None:
        """Drop the values that were not used for longest, until the rest is within the bound."""
        for key in list(self._values):
            if self.nbytes <= self.limit:
                return
            self._values.pop(key, None)

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        return sum(value.nbytes for value in list(self._values.values()))
