"""How requests are divided: turns of whole viewpoints, and what of a turn is in flight at once."""

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import accumulate, groupby

from omniscv.sources.base import Request

_BATCH = 96  # requests of a turn, at least: enough to hide latency, few enough for others to wait for
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
    pixels = 0
    for _, viewpoint in groupby(requests, lambda request: request.view.key().position):
        for request in viewpoint:
            check(request)
            if turn and not alone and pixels + _pixels(request) > _TURN_PX:
                yield turn
                turn, pixels = [], 0
            turn.append(request)
            pixels += _pixels(request)
        if alone or len(turn) >= _BATCH or pixels >= _BATCH_PX:
            yield turn
            turn, pixels = [], 0
    if turn:
        yield turn


def in_flight(requests: Sequence[Request]) -> list[Request]:
    """Return the first of some requests, as many as are sent together: one at least, and equal shares."""
    pixels = list(accumulate(map(_pixels, requests)))
    share = pixels[-1] / -(-pixels[-1] // _BATCH_PX)
    return list(requests[: max(1, bisect_right(pixels, share))])


def _pixels(request: Request) -> int:
    return request.view.width * request.view.height
