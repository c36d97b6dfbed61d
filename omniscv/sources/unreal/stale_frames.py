"""Detects stale frames: pictures that still show what a camera saw before it moved.

Some cameras lag (protocol reference, section 7.2). No picture is marked as stale, but it equals,
byte for byte, the frame before the move.
"""

from collections.abc import Hashable, Mapping

SETTLED = 3  # after so many frames in one state of the camera, the next is taken to show it
_WAITS = (0, 1, SETTLED)  # more frames to skip at each attempt; what the last one shows is accepted


class StaleFrames:
    """Compares frames with the ones before a move, and learns how many of them are stale.

    The state of the camera is a view, or the pose and field of view that the camera reports.
    With ``each_mode``, modes lag independently; otherwise one fresh frame proves that the move has arrived
    in all modes. ``states`` has, by mode, the state of the camera at its last frame.
    """

    def __init__(self, *, each_mode: bool = False) -> None:
        self._each_mode = each_mode
        self.lag = 0  # frames after a move that are known to be stale; kept when the connection is made anew
        self._lookalikes: set[int] = set()  # hashes of frames that two states share
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the connection is new, and the camera may be anywhere."""
        self.states: dict[str, Hashable] = {}
        self._payloads: dict[str, bytes] = {}
        self._arrived: Hashable = None  # the state where a frame has differed from the one before the move
        self._rejected = 0

    @property
    def in_doubt(self) -> bool:
        """Whether the last frame that was compared was rejected."""
        return self._rejected > 0

    def skips(self) -> int:
        """Return how many frames to drop after the next move, or now, when in doubt."""
        # The first frames of a connection may be garbage, and there is none to compare them with.
        return max(self.lag + _WAITS[self._rejected], 0 if self.states else SETTLED)

    def accepts(self, state: Hashable, payloads: Mapping[str, bytes]) -> bool:
        """Return whether frames are fresh; if one may be stale, request them again, and skip more.

        Two states may show the same. Then waiting changes nothing, and the frames are accepted in the end;
        they are remembered, so that they are accepted at once the next time.
        """
        arrived = self._arrived == state and not self._each_mode
        moved = [mode for mode in payloads if not arrived and self.states.get(mode, state) != state]
        equal = [hash(payloads[mode]) for mode in moved if payloads[mode] == self._payloads[mode]]
        doubtful = {*equal} - self._lookalikes
        if doubtful and self._rejected + 1 < len(_WAITS):
            self._rejected += 1
            return False
        self._lookalikes |= doubtful
        if len(equal) < len(moved):
            self.lag += _WAITS[self._rejected]  # if there was waiting, it has helped
            self._arrived = state
        self._rejected = 0
        self.note(state, payloads)
        return True

    def note(self, state: Hashable, payloads: Mapping[str, bytes]) -> None:
        """Remember frames without comparing them."""
        if self._arrived != state:
            self._arrived = None
        self.states.update(dict.fromkeys(payloads, state))
        self._payloads.update(payloads)
