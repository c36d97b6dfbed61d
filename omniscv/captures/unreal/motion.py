"""Tells pictures of where a camera was from pictures of where it is.

Some cameras lag: the first pictures after a move still show what was seen before (protocol reference,
section 7.2). Nothing in a picture says so, but then it equals, byte for byte, the picture before the move.
"""

from __future__ import annotations

from omniscv.captures.view import Request, View

SETTLED = 3
"""After so many pictures in one place, the next is taken to show it."""
_WAITS = (0, 1, SETTLED)
"""How many more pictures to skip when the one behind them seems late; after the last it is taken as true."""


class Motion:
    """What a camera has shown since the connection was made.

    Attributes:
        lag: how many pictures after a move are known to come too late; learnt, and kept.
        latest: the last picture's request; None while nobody knows where the camera is.
        shown: by mode, the view of its last picture.
    """

    def __init__(self) -> None:
        self.lag = 0
        self.latest: Request | None = None
        self.shown: dict[str, View] = {}
        self._payloads: dict[str, bytes] = {}
        self._settled: View | None = None  # where a picture has differed from the one before the move
        self._doubts = 0
        self._alike: set[int] = set()

    def lost(self) -> None:
        """The connection is new: the camera may be anywhere."""
        self.latest = self._settled = None
        self._doubts = 0
        self.shown.clear()
        self._payloads.clear()

    @property
    def in_doubt(self) -> bool:
        """Whether the last picture that was judged did not count."""
        return self._doubts > 0

    def skips(self) -> int:
        """How many pictures to throw away after the next move, or now, when in doubt."""
        # The first pictures of a connection may be garbage, and there is nothing to compare them with.
        return max(self.lag + _WAITS[self._doubts], SETTLED if self.latest is None else 0)

    def shows(self, request: Request, payload: bytes) -> bool:
        """Whether a picture counts. False: it may be from before the move; ask again, and skip more.

        Two places may look the same. Then waiting changes nothing, and the picture counts in the end;
        it is remembered, so that there is no waiting for it again.
        """
        before = self.shown.get(request.mode)
        if self._settled != request.view and before is not None and before != request.view:
            if self._payloads[request.mode] != payload:
                self.lag += _WAITS[self._doubts]  # if there was waiting, it has helped
                self._doubts = 0
                self._settled = request.view
            elif hash(payload) not in self._alike:
                if self._doubts + 1 < len(_WAITS):
                    self._doubts += 1
                    return False
                self._alike.add(hash(payload))
                self._doubts = 0
        self.note(request, payload)
        return True

    def note(self, request: Request, payload: bytes) -> None:
        """A picture came that is not judged."""
        if self._settled != request.view:
            self._settled = None
        self.latest = request
        self.shown[request.mode] = request.view
        self._payloads[request.mode] = payload


def witness(request: Request, latest: Request | None, shown: dict[str, View]) -> Request | None:
    """A picture to ask for first, where a late one of this request could not be told from a true one.

    It has the mode of the picture before the move, so that the two can be compared.

    Args:
        request: what is asked for next.
        latest: the picture before it.
        shown: by mode, the view of its last picture.
    """
    if latest is None or latest.view == request.view or shown.get(request.mode) == latest.view:
        return None
    return Request(request.view, latest.mode)
