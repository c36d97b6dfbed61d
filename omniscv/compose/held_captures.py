"""Captures that are held in memory, and delivered again in place of new ones."""

from abc import abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

from omniscv.sources.base import Capture, Request, Source, SourceWrapper
from omniscv.sources.requests import Held, in_order


class HeldCaptures(SourceWrapper):
    """A source of which some captures are held. The source is not closed with it."""

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        return in_order(requests, self._held_capture, self._capture_and_hold)

    @abstractmethod
    def _find(self, request: Request) -> Capture | None:
        """Return the capture that is held for a request; None if there is none."""

    @abstractmethod
    def _hold(self, capture: Capture) -> None:
        """Take a new capture."""

    def _held_capture(self, request: Request) -> Held | None:
        capture = self._find(request)
        return None if capture is None else lambda: capture

    def _capture_and_hold(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for capture in self._source.capture(requests):
            self._hold(capture)
            yield capture


class SharedCaptures(HeldCaptures):
    """A source whose captures are held until the last image of one moment has used them. For one thread.

    Args:
        source: where captures come from.
        needed: how often each request comes; other requests are not held.
    """

    def __init__(self, source: Source, needed: Mapping[Request, int]) -> None:
        super().__init__(source)
        self._needed = Counter(needed)
        self._held: dict[Request, Capture] = {}

    def close(self) -> None:
        self._held.clear()

    def _find(self, request: Request) -> Capture | None:
        self._needed[request] -= 1
        return self._held.get(request) if self._needed[request] > 0 else self._held.pop(request, None)

    def _hold(self, capture: Capture) -> None:
        if self._needed[capture.request] > 0:
            self._held[capture.request] = capture


class CapturesOfCenter(HeldCaptures):
    """A recording whose captures at the last optical centre are held, so that they are decoded once.

    Safe to use from several threads.

    Args:
        recording: where captures come from.
        most_bytes: that are held; captures beyond it are read again.
    """

    def __init__(self, recording: Source, most_bytes: int) -> None:
        super().__init__(recording)
        self._most_bytes, self._held = most_bytes, dict[Request, Capture]()

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        return sum(map(_nbytes, list(self._held.values())))

    def close(self) -> None:
        self._held = {}

    def _find(self, request: Request) -> Capture | None:
        return self._held.get(request)

    def _hold(self, capture: Capture) -> None:
        held = next(iter(list(self._held)), capture.request)
        if (held.view.pose.t_w_c != capture.request.view.pose.t_w_c).any():
            self._held = {}
        if self.nbytes + _nbytes(capture) <= self._most_bytes:
            self._held[capture.request] = capture


def _nbytes(capture: Capture) -> int:
    return capture.pixels.nbytes + len(capture.payload or b"")
