"""Captures that several images need, held from the first of them to the last."""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping

from omniscv.sources.base import Capture, Request, Source, SourceWrapper


class SharedCaptures(SourceWrapper):
    """A source that captures once what is requested several times, and holds it as long as that is needed.

    It belongs to the images of one moment, and to one thread; the source is not closed with it.

    Args:
        source: where captures come from.
        needed: how many times each request is made that is made several times.
    """

    def __init__(self, source: Source, needed: Mapping[Request, int]) -> None:
        super().__init__(source)
        self._needed = Counter(needed)
        self._held: dict[Request, Capture] = {}

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        coming, waiting = iter(requests), deque[Capture | None]()
        for fresh in self._source.capture(self._missing(coming, waiting)):
            while held := waiting.popleft():
                yield held
            if self._needed[fresh.request] > 0:
                self._held[fresh.request] = fresh
            yield fresh
        while waiting and (held := waiting.popleft()):
            yield held

    def close(self) -> None:
        self._held.clear()

    def _missing(self, coming: Iterator[Request], waiting: deque[Capture | None]) -> Iterator[Request]:
        """The requests that are captured now; to ``waiting`` go the captures held, and None for these."""
        for request in coming:
            self._needed[request] -= 1
            held = self._held.get(request)
            waiting.append(held)
            if self._needed[request] <= 0:
                self._held.pop(request, None)
            if held is None:
                yield request
