"""The player: a pawn that commands move, and what its view shows, some frames later."""

from __future__ import annotations

from collections import deque

from mock_server.rotator import Triple

_STEEPEST_DEG = 89.9
"""Degrees: how far the engine's controller lets pitch and roll go."""

_FRAMES = 4


class Player:
    """Location (cm) and control rotation (degrees) of the pawn; ``seen`` tells what views show.

    Commands run before a frame's tick. The tick limits the rotation and shows the pose to whatever
    follows the pawn; followers are later still (protocol reference, sections 2.2, 4 and 7.2).
    """

    def __init__(self, location: Triple) -> None:
        self.location: Triple = location
        self.rotation: Triple = (0.0, 0.0, 0.0)
        start = (self.location, self.rotation)
        self._shown: deque[tuple[Triple, Triple]] = deque([start] * _FRAMES, maxlen=_FRAMES)

    def tick(self) -> None:
        """A frame ends."""
        pitch, yaw, roll = self.rotation
        self.rotation = (_limited(pitch), yaw % 360.0, _limited(roll))
        self._shown.append((self.location, self.rotation))

    def seen(self, location_frames: int, rotation_frames: int) -> tuple[Triple, Triple]:
        """Location and rotation as they were that many ticks before the last one."""
        return self._shown[-1 - location_frames][0], self._shown[-1 - rotation_frames][1]


def _limited(angle: float) -> float:
    """Between -89.9 and 89.9 degrees, written in [0, 360)."""
    signed = (angle + 180.0) % 360.0 - 180.0
    return max(-_STEEPEST_DEG, min(_STEEPEST_DEG, signed)) % 360.0
