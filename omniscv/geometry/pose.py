"""Poses: position, rotation, and what is computed with them; the frames of the world and the camera.

Frames
    world ``w``   right-handed, metres: X forward, Y left, Z up
    camera ``c``  right-handed, metres: x right, y down, z forward (OpenCV's optical frame)
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import numbers, shown, wrong
from omniscv.errors import ArgumentError
from omniscv.geometry import unreal_frame
from omniscv.parallel import MIN_PARALLEL_ELEMENTS, row_blocks
from omniscv.records import checked, record

Array = NDArray[np.float64]

FARTHEST = 1e9
"""Metres: the largest coordinate of a position. Single-precision centimetres lose a metre before that."""

R_LEVEL: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera to world of the level pose that looks along world +X."""

_EYE = np.eye(3)
_NOT_ORTHONORMAL = 1e-6  # largest entry of |R R^T - I| that a rotation may have
_SHORTEST_QUATERNION = 1e-12  # that has a direction


def position_reader(name: str, value: ArrayLike, farthest: float = FARTHEST) -> Array:
    """Return the coordinates (3,) of ``value``, at most ``farthest``; ArgumentError with ``name`` for
    others."""
    position = numbers(name, value, (3,))
    if np.abs(position).max() > farthest:
        raise wrong(name, f"coordinates of at most {farthest:g}", position)
    return position


def rotation_reader(name: str, value: ArrayLike, shape: tuple[int | None, ...] = (3, 3)) -> Array:
    """Return the rotation matrix ``value``, or several (N, 3, 3) if ``shape`` is that; ArgumentError with
    ``name`` for anything else."""
    rotation = numbers(name, value, shape)
    with np.errstate(over="ignore", invalid="ignore"):
        drift = float(np.abs(rotation @ rotation.swapaxes(-1, -2) - _EYE).max())
        determinant = float(np.linalg.det(rotation).min())
    if not drift <= _NOT_ORTHONORMAL or determinant < 0:  # NaN where products overflow
        found = f"determinant {determinant:.6g} and |R R^T - I| = {drift:.3g}"
        raise ArgumentError(f"{name}: expected a right-handed orthonormal 3x3 matrix, got {found}")
    return rotation


class UnrealPose(NamedTuple):
    """A pose as UnrealCV prints it: (x, y, z) in cm and (pitch, yaw, roll) in degrees."""

    location_cm: tuple[float, float, float]
    rotation_deg: tuple[float, float, float]


@record(eq=False)
class Pose:
    """Position and rotation of a camera (or another body) in the world.

    Args:
        position: (3,) optical centre in the world, metres, each coordinate at most ``FARTHEST``.
        rotation: (3, 3) camera to world, ``p_w = rotation @ p_c + position``.

    Raises:
        ArgumentError: wrong shape, a number that is not finite, a position too far away, or no rotation.
    """

    position: Array = checked(position_reader)
    rotation: Array = checked(rotation_reader)

    @property
    def t_w_c(self) -> Array:
        """``position``, by its name in formulas."""
        return self.position

    @property
    def R_w_c(self) -> Array:
        """``rotation``, by its name in formulas."""
        return self.rotation

    @classmethod
    def from_angles(
        cls, position: ArrayLike, yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0
    ) -> Pose:
        """Return the pose of world angles; all 0 it looks along world +X.

        Args:
            position: (3,) metres, world frame.
            yaw_deg: to the left +.
            pitch_deg: nose up +.
            roll_deg: right side down +.
        """
        location_cm = unreal_frame.position_to_unreal(position_reader("position", position))
        return cls.from_unreal(location_cm, (pitch_deg, -yaw_deg, roll_deg))

    @classmethod
    def from_unreal(cls, location_cm: ArrayLike, rotation_deg: ArrayLike) -> Pose:
        """Return the pose of a location and a rotator in Unreal's frame.

        Args:
            location_cm: (x, y, z), cm.
            rotation_deg: (pitch, yaw, roll), degrees.
        """
        location = position_reader("location_cm", location_cm, 100 * FARTHEST)
        rotator = numbers("rotation_deg", rotation_deg, (3,))
        position = unreal_frame.position_from_unreal(location)
        return cls(position, unreal_frame.rotation_from_unreal(rotator) @ R_LEVEL)

    @classmethod
    def look_at(cls, position: ArrayLike, target: ArrayLike, up: ArrayLike = (0, 0, 1)) -> Pose:
        """Return the pose whose camera sees a point in the middle of its image, upright.

        Args:
            position: (3,) metres, world frame.
            target: (3,) metres, world frame: the point.
            up: (3,) the direction, of any length, that points upwards in the image.

        Raises:
            ArgumentError: the point is at the position, or straight up or down from it.
        """
        eye = position_reader("position", position)
        point = position_reader("target", target)
        upwards = numbers("up", up, (3,))
        forward = point - eye
        right = np.cross(forward, upwards)
        if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(forward) * np.linalg.norm(upwards):
            expected = f"expected a point that is not along 'up' from the position {shown(eye)}"
            raise ArgumentError(f"target: {expected}, got {shown(point)}; give another up")
        forward = forward / np.linalg.norm(forward)
        right = right / np.linalg.norm(right)
        return cls(eye, np.stack([right, np.cross(forward, right), forward], axis=1))

    @classmethod
    def from_quaternion(cls, position: ArrayLike, quaternion: Sequence[float]) -> Pose:
        """Return the pose of a position and a quaternion (x, y, z, w) of any length but 0."""
        from scipy.spatial.transform import Rotation  # slow to load

        xyzw = numbers("quaternion", quaternion, (4,))
        if not np.linalg.norm(xyzw) > _SHORTEST_QUATERNION:
            raise wrong("quaternion", "one of length 1", xyzw)
        return cls(np.asarray(position), Rotation.from_quat(xyzw).as_matrix())

    def quaternion(self) -> tuple[float, float, float, float]:
        """Return the rotation as a unit quaternion (x, y, z, w) with w >= 0."""
        from scipy.spatial.transform import Rotation

        x, y, z, w = (Rotation.from_matrix(self.rotation).as_quat(canonical=True) + 0.0).tolist()
        return x, y, z, w

    def interpolate(self, end: Pose, fraction: float) -> Pose:
        """Return the pose at a fraction of the way to another one.

        Positions are interpolated linearly, rotations along the shortest turn (slerp).

        Args:
            end: the other pose.
            fraction: 0 is this pose, 1 the other; numbers outside [0, 1] extrapolate.
        """
        from scipy.spatial.transform import Rotation

        whole = Rotation.from_matrix(self.rotation.T @ end.rotation).as_rotvec()
        turn = Rotation.from_rotvec(fraction * whole).as_matrix()
        position = self.position + fraction * (end.position - self.position)
        return Pose(position, self.rotation @ turn)

    def inverse(self) -> Pose:
        """Return the pose of the world in the camera's frame: ``pose.inverse() @ pose`` is the identity."""
        return Pose(-self.position @ self.rotation, self.rotation.T)

    def to_unreal(self) -> UnrealPose:
        """Return Unreal's location and rotator of this pose; pitch in [-90, 90].

        Straight up or down yaw and roll turn about the same axis: roll is 0 there.
        """
        return UnrealPose(
            unreal_frame.position_to_unreal(self.position),
            unreal_frame.rotation_to_unreal(self.rotation @ R_LEVEL.T),
        )

    def angles(self) -> tuple[float, float, float]:
        """Return (yaw, pitch, roll) in degrees, as :meth:`from_angles` takes them."""
        pitch, yaw, roll = self.to_unreal().rotation_deg
        return (0.0 - yaw, pitch, roll)

    def to_world(self, points_c: ArrayLike) -> Array:
        """Transform points (..., 3), metres, from the camera frame to the world frame."""
        return rotated(np.asarray(points_c, dtype=np.float64), self.rotation) + self.position

    def to_camera(self, points_w: ArrayLike) -> Array:
        """Transform points (..., 3), metres, from the world frame to the camera frame."""
        return rotated(np.asarray(points_w, dtype=np.float64) - self.position, self.rotation.T)

    def __matmul__(self, other: Pose) -> Pose:
        """Compose poses: ``T_w_c @ T_c_d = T_w_d``."""
        return Pose(self.to_world(other.position), self.rotation @ other.rotation)

    def to_dict(self) -> dict[str, Any]:
        """Return plain lists for JSON: position in metres, rotation row by row."""
        return {"position": self.position.tolist(), "rotation": self.rotation.tolist()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Pose:
        """Return the pose that :meth:`to_dict` described; other keys are ignored."""
        return cls(data["position"], data["rotation"])


def rotated(vectors: Array, R_b_a: Array) -> Array:
    """Return vectors (..., 3) of frame a in frame b, ``R_b_a`` (3, 3) times each.

    Large arrays go in blocks, too small for BLAS's own threads: these would take the cores from ours.
    """
    if vectors.size < MIN_PARALLEL_ELEMENTS:
        return np.asarray(vectors @ R_b_a.T)
    rows = vectors.reshape(-1, 3)
    result = np.empty(vectors.shape)
    turned = result.reshape(-1, 3)
    row_blocks(lambda block: np.matmul(rows[block], R_b_a.T, out=turned[block]), len(rows), 1)
    return result


@cache
def cube_rotations() -> tuple[tuple[str, Array], ...]:
    """Return the six faces of a cube aligned with the world: (name, R_w_c), in the order of captures.

    front, right, back, left, up, down have the rotators of the protocol reference, section 4.
    """
    names = ("front", "right", "back", "left", "up", "down")
    pitch_yaw = ((0, 0), (0, 90), (0, 180), (0, -90), (90, 0), (-90, 0))
    faces = []
    for name, (pitch_deg, yaw_deg) in zip(names, pitch_yaw, strict=True):
        faces.append((name, Pose.from_unreal((0, 0, 0), (pitch_deg, yaw_deg, 0)).rotation))
    return tuple(faces)
