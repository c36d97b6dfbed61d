"""Answer requests in order: with held captures where there are some, with new ones elsewhere."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator

from omniscv.errors import SourceError
from omniscv.sources.requests import Capture, Request

Held = Callable[[], Capture]
"""Returns a held capture; called when it is delivered, so that no pixels are read too early."""

_MOST_HELD_IN_A_ROW = 24
"""After as many held captures in a row, those that wait are delivered before more requests are read: a stream
of requests is not read to its end before its first capture is delivered."""


def in_order(
    requests: Iterable[Request],
    find: Callable[[Request], Held | None],
    capture: Callable[[Iterable[Request]], Iterator[Capture]],
) -> Iterator[Capture]:
    """Yield one capture per request, in the order of the requests.

    Args:
        requests: read lazily, by ``capture``.
        find: returns the held capture of a request, or None where a new one is needed; called once for each
            request, when it is read.
        capture: captures what is not held: one capture for each request that it gets, in their order.

    Raises:
        SourceError: ``capture`` delivered too few captures.
    """
    remaining = iter(requests)
    waiting: deque[Held | None] = deque()  # None stands for the next new capture

    def missing() -> Iterator[Request]:
        held_in_a_row = 0
        while held_in_a_row < _MOST_HELD_IN_A_ROW and (request := next(remaining, None)):
            held = find(request)
            waiting.append(held)
            held_in_a_row = held_in_a_row + 1 if held else 0
            if held is None:
                yield request

    while True:
        for new in capture(missing()):
            while held := waiting.popleft():
                yield held()
            yield new
        if not waiting:
            return
        while waiting:
            held = waiting.popleft()
            if held is None:
                raise SourceError("source: expected a capture for each request, got too few")
            yield held()
