"""How requests are divided: turns of whole viewpoints, and what of a turn is in flight at once."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby

from omniscv.sources.base import Request

_BATCH = 24  # requests in flight at once: enough to hide latency, few enough to wait in memory
_BATCH_PX = 1 << 24  # pixels in flight at once; a larger picture is requested alone
_TURN_PX = 1 << 27  # pixels of a turn, all of which are held in memory


def turns(
    requests: Iterable[Request], check: Callable[[Request], None], alone: bool
) -> Iterator[list[Request]]:
    """Yield requests in turns, between which the world may be changed; raise what ``check`` raises for one.

    A turn is of whole viewpoints: of what follows from one optical centre. Small ones share a turn, unless
    each is ``alone``; one of more pixels than memory should hold is divided.
    """
    turn: list[Request] = []
    for _, viewpoint in groupby(requests, lambda request: request.view.key()[2:5]):
        for request in viewpoint:
            check(request)
            if turn and not alone and _pixels(turn) + _pixels([request]) > _TURN_PX:
                yield turn
                turn = []
            turn.append(request)
        if alone or len(turn) >= _BATCH or _pixels(turn) >= _BATCH_PX:
            yield turn
            turn = []
    if turn:
        yield turn


def in_flight(requests: Sequence[Request]) -> list[Request]:
    """Return the first of some requests, as many as are sent together: one at least."""
    count = min(len(requests), _BATCH)
    while count > 1 and _pixels(requests[:count]) > _BATCH_PX:
        count -= 1
    return list(requests[:count])


def _pixels(requests: Sequence[Request]) -> int:
    return sum(request.view.width * request.view.height for request in requests)
