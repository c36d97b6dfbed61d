"""Poses and frames: the only module that knows that Unreal is left-handed.

Frames
    world ``w``   right-handed, metres: X forward, Y left, Z up
    camera ``c``  right-handed, metres: x right, y down, z forward (OpenCV's optical frame)
    Unreal        left-handed, centimetres: X forward, Y right, Z up; rotators are
                  (pitch, yaw, roll) in degrees: nose up +, turning right +, right side down +

World and Unreal differ by the mirror ``S = diag(1, -1, 1)`` and by centimetres: ``p_w = S p_ue / 100``.
A body turned by Unreal's ``R_ue`` is turned by ``S R_ue S`` in the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.errors import ArgumentError

Array = NDArray[np.float64]

R_LEVEL: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera to world of the level pose that looks along world +X."""

_MIRROR = np.diag([1.0, -1.0, 1.0])
_CM_PER_M = 100.0
_ROTATION_TOLERANCE = 1e-6


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
        ArgumentError: a shape is wrong, a number is not finite, or the matrix is no rotation.
    """

    position: Array
    rotation: Array

    def __post_init__(self) -> None:
        position = _finite("position", self.position, (3,))
        rotation = _finite("rotation", self.rotation, (3, 3))
        drift = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if drift > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
            raise ArgumentError(
                "rotation: expected a right-handed orthonormal 3x3 matrix, "
                f"got determinant {np.linalg.det(rotation):.6g} and |R R^T - I| = {drift:.3g}"
            )
        for name, value in (("position", position), ("rotation", rotation)):
            value.flags.writeable = False
            object.__setattr__(self, name, value)

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
        location_cm = np.asarray(_finite("position", position, (3,))) @ _MIRROR * _CM_PER_M
        return cls.from_unreal(location_cm, (pitch_deg, -yaw_deg, roll_deg))

    @classmethod
    def from_unreal(cls, location_cm: ArrayLike, rotation_deg: ArrayLike) -> Pose:
        """A pose from Unreal's location (x, y, z) in cm and rotator (pitch, yaw, roll) in degrees."""
        location = _finite("location_cm", location_cm, (3,))
        rotator = _finite("rotation_deg", rotation_deg, (3,))
        R_ue = _unreal_matrix(*rotator.tolist())
        return cls(_MIRROR @ location / _CM_PER_M, _MIRROR @ R_ue @ _MIRROR @ R_LEVEL)

    def to_unreal(self) -> UnrealPose:
        """Unreal's location and rotator of this pose; pitch in [-90, 90].

        Straight up or down yaw and roll turn about the same axis: roll is 0 there.
        """
        x, y, z = (_MIRROR @ self.position * _CM_PER_M).tolist()
        return UnrealPose((x, y, z), _unreal_rotator(_MIRROR @ self.rotation @ R_LEVEL.T @ _MIRROR))

    def angles(self) -> tuple[float, float, float]:
        """(yaw, pitch, roll) in degrees, as :meth:`from_angles` takes them."""
        pitch, yaw, roll = self.to_unreal().rotation_deg
        return (0.0 - yaw, pitch, roll)

    def to_world(self, points_c: ArrayLike) -> Array:
        """Points (..., 3) in the camera frame, metres, to the world frame."""
        result: Array = np.asarray(points_c, dtype=np.float64) @ self.rotation.T + self.position
        return result

    def to_camera(self, points_w: ArrayLike) -> Array:
        """Points (..., 3) in the world frame, metres, to the camera frame."""
        result: Array = (np.asarray(points_w, dtype=np.float64) - self.position) @ self.rotation
        return result

    def __matmul__(self, other: Pose) -> Pose:
        """``T_w_c @ T_c_d = T_w_d``: a pose given in this camera's frame, in the world."""
        return Pose(self.to_world(other.position), self.rotation @ other.rotation)

    def to_dict(self) -> dict[str, Any]:
        """Plain lists for JSON: position in metres, rotation row by row."""
        return {"position": self.position.tolist(), "rotation": self.rotation.tolist()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Pose:
        """The inverse of :meth:`to_dict`."""
        return cls(np.asarray(data["position"]), np.asarray(data["rotation"]))


def _finite(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as cause:
        raise ArgumentError(f"{name}: expected {shape} finite numbers, got {value!r}") from cause
    if array.shape != shape or not np.isfinite(array).all():
        raise ArgumentError(f"{name}: expected {shape} finite numbers, got {array.tolist()!r}")
    return array


def _unreal_matrix(pitch_deg: float, yaw_deg: float, roll_deg: float) -> Array:
    """Columns forward, right, up of FRotator(pitch, yaw, roll) in Unreal's frame."""
    (sp, cp), (sy, cy), (sr, cr) = map(_sin_cos_deg, (pitch_deg, yaw_deg, roll_deg))
    forward = (cp * cy, cp * sy, sp)
    right = (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, -sr * cp)
    up = (-(cr * sp * cy + sr * sy), cy * sr - cr * sp * sy, cr * cp)
    return np.array([forward, right, up]).T


def _sin_cos_deg(angle_deg: float) -> tuple[float, float]:
    """Sine and cosine, exact at multiples of 90 degrees, so that cube faces are exact."""
    turned = angle_deg % 360.0
    exact = {0.0: (0.0, 1.0), 90.0: (1.0, 0.0), 180.0: (0.0, -1.0), 270.0: (-1.0, 0.0)}
    if turned in exact:
        return exact[turned]
    return float(np.sin(np.radians(turned))), float(np.cos(np.radians(turned)))


def _unreal_rotator(R_ue: Array) -> tuple[float, float, float]:
    forward, right, up = R_ue.T
    horizontal = float(np.hypot(forward[0], forward[1]))
    pitch = np.arctan2(forward[2], horizontal)
    if horizontal < 1e-9:  # straight up or down: give the whole turn to yaw
        yaw, roll = np.arctan2(-right[0], right[1]), 0.0
    else:
        yaw, roll = np.arctan2(forward[1], forward[0]), np.arctan2(-right[2], up[2])
    return (float(np.degrees(pitch)), float(np.degrees(yaw)), float(np.degrees(roll)))


def cube_rotations() -> tuple[tuple[str, Array], ...]:
    """The six faces of a cube aligned with the world: (name, R_w_c), in the order of a capture.

    front, right, back, left, up, down are Unreal's rotators of the protocol reference, section 4.
    """
    rotators: Sequence[tuple[str, tuple[float, float, float]]] = (
        ("front", (0, 0, 0)),
        ("right", (0, 90, 0)),
        ("back", (0, 180, 0)),
        ("left", (0, -90, 0)),
        ("up", (90, 0, 0)),
        ("down", (-90, 0, 0)),
    )
    return tuple((name, Pose.from_unreal((0, 0, 0), rotator).R_w_c) for name, rotator in rotators)
