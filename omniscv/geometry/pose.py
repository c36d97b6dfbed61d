"""Poses and the frames of the world and the camera.

Frames
    world ``w``   right-handed, metres: X forward, Y left, Z up
    camera ``c``  right-handed, metres: x right, y down, z forward (OpenCV's optical frame)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import numbers, shown
from omniscv.errors import ArgumentError
from omniscv.geometry import unreal_frame

Array = NDArray[np.float64]

FARTHEST = 1e9
"""Metres from the origin, along each axis: Unreal's own numbers of centimetres lose a metre before that."""

R_LEVEL: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera to world of the level pose that looks along world +X."""


class UnrealPose(NamedTuple):
    """A pose as UnrealCV prints it: (x, y, z) in cm and (pitch, yaw, roll) in degrees."""

    location_cm: tuple[float, float, float]
    rotation_deg: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a camera is and how it is turned.

    Args:
        position: (3,) optical centre in the world, metres.
        rotation: (3, 3) camera to world, ``p_w = rotation @ p_c + position``.

    Raises:
        ArgumentError: a shape is wrong, a number is not finite, a position is farther than ``FARTHEST``,
            or the matrix is no rotation.
    """

    position: Array
    rotation: Array

    def __post_init__(self) -> None:
        position = _placed("position", self.position, FARTHEST)
        rotation = numbers("rotation", self.rotation, (3, 3))
        drift = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if drift > 1e-6 or np.linalg.det(rotation) < 0:
            raise ArgumentError(
                "rotation: expected a right-handed orthonormal 3x3 matrix, "
                f"got determinant {np.linalg.det(rotation):.6g} and |R R^T - I| = {drift:.3g}"
            )
        vars(self).update(position=position, rotation=rotation)

    @property
    def t_w_c(self) -> Array:
        """(3,) the camera's origin in the world, metres."""
        return self.position

    @property
    def R_w_c(self) -> Array:
        """(3, 3) camera to world."""
        return self.rotation

    @classmethod
    def from_angles(
        cls, position: ArrayLike, yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0
    ) -> Pose:
        """A pose from world angles: yaw to the left +, nose up +, right side down +."""
        location_cm = unreal_frame.position_to_unreal(_placed("position", position, FARTHEST))
        return cls.from_unreal(location_cm, (pitch_deg, -yaw_deg, roll_deg))

    @classmethod
    def from_unreal(cls, location_cm: ArrayLike, rotation_deg: ArrayLike) -> Pose:
        """A pose from Unreal's location (x, y, z) in cm and rotator (pitch, yaw, roll) in degrees."""
        location = _placed("location_cm", location_cm, 100 * FARTHEST)
        rotator = numbers("rotation_deg", rotation_deg, (3,))
        position = unreal_frame.position_from_unreal(location)
        return cls(position, unreal_frame.rotation_from_unreal(rotator) @ R_LEVEL)

    @classmethod
    def look_at(cls, position: ArrayLike, target: ArrayLike, up: ArrayLike = (0, 0, 1)) -> Pose:
        """A pose whose camera sees a point in the middle of its image, upright.

        Args:
            position, target: (3,) metres, world frame.
            up: (3,) the direction, of any length, that points upwards in the image.

        Raises:
            ArgumentError: the point is at the position, or straight up or down from it.
        """
        place, point = _placed("position", position, FARTHEST), _placed("target", target, FARTHEST)
        upwards = numbers("up", up, (3,))
        forward = point - place
        right = np.cross(forward, upwards)
        if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(forward) * np.linalg.norm(upwards):
            wanted = "expected a point elsewhere than along 'up' from the position"
            raise ArgumentError(f"target: {wanted} {shown(place)}, got {shown(point)}; give another up")
        forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
        return cls(place, np.stack([right, np.cross(forward, right), forward], axis=1))

    def inverse(self) -> Pose:
        """The pose of the world in the camera's frame: ``pose.inverse() @ pose`` is the identity."""
        return Pose(-self.position @ self.rotation, self.rotation.T)

    def to_unreal(self) -> UnrealPose:
        """Unreal's location and rotator of this pose; pitch in [-90, 90].

        Straight up or down yaw and roll turn about the same axis: roll is 0 there.
        """
        return UnrealPose(
            unreal_frame.position_to_unreal(self.position),
            unreal_frame.rotation_to_unreal(self.rotation @ R_LEVEL.T),
        )

    def angles(self) -> tuple[float, float, float]:
        """(yaw, pitch, roll) in degrees, as :meth:`from_angles` takes them."""
        pitch, yaw, roll = self.to_unreal().rotation_deg
        return (0.0 - yaw, pitch, roll)

    def to_world(self, points_c: ArrayLike) -> Array:
        """Points (..., 3) in the camera frame, metres, to the world frame."""
        return np.asarray(points_c, dtype=np.float64) @ self.rotation.T + self.position

    def to_camera(self, points_w: ArrayLike) -> Array:
        """Points (..., 3) in the world frame, metres, to the camera frame."""
        return np.asarray((np.asarray(points_w, dtype=np.float64) - self.position) @ self.rotation)

    def __matmul__(self, other: Pose) -> Pose:
        """``T_w_c @ T_c_d = T_w_d``: a pose given in this camera's frame, in the world."""
        return Pose(self.to_world(other.position), self.rotation @ other.rotation)

    def to_dict(self) -> dict[str, Any]:
        """Plain lists for JSON: position in metres, rotation row by row."""
        return {"position": self.position.tolist(), "rotation": self.rotation.tolist()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Pose:
        """The inverse of :meth:`to_dict`."""
        return cls(data["position"], data["rotation"])


def _placed(name: str, value: ArrayLike, farthest: float) -> Array:
    """Three numbers of a place that is not too far away, or an ArgumentError."""
    place = numbers(name, value, (3,))
    if np.abs(place).max() > farthest:
        raise ArgumentError(f"{name}: expected numbers within {farthest:g} of the origin, got {shown(place)}")
    return place


def cube_rotations() -> tuple[tuple[str, Array], ...]:
    """The six faces of a cube aligned with the world: (name, R_w_c), in the order of a capture.

    front, right, back, left, up, down are Unreal's rotators of the protocol reference, section 4.
    """
    names = ("front", "right", "back", "left", "up", "down")
    pitch_yaw = ((0, 0), (0, 90), (0, 180), (0, -90), (90, 0), (-90, 0))
    rotations = [Pose.from_unreal((0, 0, 0), (*turn, 0)).R_w_c for turn in pitch_yaw]
    return tuple(zip(names, rotations, strict=True))
