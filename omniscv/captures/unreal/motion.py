"""Tells pictures of where a camera was from pictures of where it is.

Some cameras lag: the first pictures after a move still show what was seen before (protocol reference,
section 7.2). Nothing in a picture says so, but then it equals, byte for byte, the picture before the move.
"""

from __future__ import annotations

from omniscv.captures.view import Request, View

_WAITS = (0, 1, 3)
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
        self._doubts = 0
        self._alike: set[int] = set()

    def lost(self) -> None:
        """The connection is new: the camera may be anywhere."""
        self.latest = None
        self.shown.clear()
        self._payloads.clear()

    def skips(self) -> int:
        """How many pictures to throw away after the next move."""
        # A first picture may be garbage in any case (protocol reference, section 7.2).
        return max(self.lag + _WAITS[self._doubts], 1 if self.latest is None else 0)

    def shows(self, request: Request, payload: bytes) -> bool:
        """Whether a picture counts. False: it may be from before the move; ask again, and skip more.

        Two places may look the same. Then waiting changes nothing, and the picture counts in the end;
        it is remembered, so that there is no waiting for it again.
        """
        same = self._payloads.get(request.mode) == payload and self.shown[request.mode] != request.view
        if same and hash(payload) not in self._alike:
            if self._doubts + 1 < len(_WAITS):
                self._doubts += 1
                return False
            self._alike.add(hash(payload))
        else:
            self.lag += _WAITS[self._doubts]  # waiting has helped
        self._doubts = 0
        self.note(request, payload)
        return True

    def note(self, request: Request, payload: bytes) -> None:
        """A picture came that is not judged."""
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
