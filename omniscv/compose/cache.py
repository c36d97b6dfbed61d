"""What is kept for the next image: rays and lookups within a bound in bytes, and captures."""

from collections import Counter, deque
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from omniscv.sources.base import Capture, Request, Source, SourceWrapper
from omniscv.sources.requests import Held, in_order


class Sized(Protocol):
    """A value with its size; it may grow while it is used."""

    @property
    def nbytes(self) -> int: ...


T = TypeVar("T", bound=Sized)
_REMEMBERED = 64  # keys


class Once(Protocol):
    """Returns what a function makes of captures; a name of it tells what. It may be kept."""

    def __call__(self, name: Hashable, captures: Sequence[Capture], make: Callable[[], T]) -> T: ...


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


class HeldCaptures(SourceWrapper):
    """A source that delivers held captures in place of new ones. Closing it does not close the source.

    Of one moment: captures are held until the last image has used them; for one thread. Of a recording: those
    at the last optical centre, so that they are decoded once; for any threads.

    Args:
        source: where captures come from.
        needed: of one moment, how often each request comes; None of a recording.
        all_: whether all captures of the moment are held, as it is not known which of them come again.
        most_bytes: that are held of a recording; captures beyond it are read again.
    """

    def __init__(
        self,
        source: Source,
        needed: Mapping[Request, int] | None = None,
        *,
        all_: bool = False,
        most_bytes: int = 0,
    ) -> None:
        super().__init__(source)
        self._needed = None if needed is None else Counter(needed)
        self._all = all_
        self._most_bytes = most_bytes
        self._held = dict[Request, Capture]()

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        return sum(map(_nbytes, list(self._held.values())))

    @property
    def requests(self) -> Collection[Request]:
        """The requests of the moment so far, each once, in their order."""
        return (self._needed or {}).keys()

    def close(self) -> None:
        self._held = {}

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        def held(request: Request) -> Held | None:
            capture = self._find(request)
            return None if capture is None else lambda: capture

        def fresh(requests: Iterable[Request]) -> Iterator[Capture]:
            for capture in self._source.capture(requests):
                self._hold(capture)
                yield capture

        return in_order(requests, held, fresh)

    def _find(self, request: Request) -> Capture | None:
        if self._needed is None or self._all:
            return self._held.get(request)
        self._needed[request] -= 1
        return self._held.get(request) if self._needed[request] > 0 else self._held.pop(request, None)

    def _hold(self, capture: Capture) -> None:
        if self._needed is not None:
            if self._all or self._needed[capture.request] > 0:
                self._held[capture.request] = capture
            return
        held = next(iter(list(self._held)), capture.request)
        if (held.view.pose.t_w_c != capture.request.view.pose.t_w_c).any():
            self._held = {}
        if self.nbytes + _nbytes(capture) <= self._most_bytes:
            self._held[capture.request] = capture


def _nbytes(capture: Capture) -> int:
    marks = sum(mark.nbytes for mark in capture.marks.values())
    return capture.pixels.nbytes + len(capture.payload or b"") + marks
