"""Unreal's frame and the world's: the only module that knows that Unreal is left-handed.

    world ``w``   right-handed, metres: X forward, Y left, Z up
    Unreal        left-handed, centimetres: X forward, Y right, Z up; rotators are
                  (pitch, yaw, roll) in degrees: nose up +, turning right +, right side down +

They differ by the mirror ``S = diag(1, -1, 1)`` and by centimetres: ``p_w = S p_ue / 100``.
A body turned by Unreal's ``R_ue`` is turned by ``S R_ue S`` in the world.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

_MIRROR = np.diag([1.0, -1.0, 1.0])
_CM_PER_M = 100.0


def position_from_unreal(location_cm: Array) -> Array:
    """(3,) metres in the world of (3,) centimetres in Unreal's frame."""
    return np.asarray(_MIRROR @ location_cm / _CM_PER_M)


def position_to_unreal(position: Array) -> Triple:
    """Centimetres in Unreal's frame of (3,) metres in the world."""
    x, y, z = (_MIRROR @ position * _CM_PER_M).tolist()
    return x, y, z


def direction_from_unreal(directions: NDArray[np.floating]) -> None:
    """Turn vectors (..., 3) from Unreal's frame into the world's, in place."""
    directions[..., 1] *= -1


def rotation_from_unreal(rotators_deg: Array) -> Array:
    """(..., 3, 3) how bodies turned by rotators (..., 3), pitch, yaw, roll, are turned in the world."""
    (sp, cp), (sy, cy), (sr, cr) = map(_sin_cos_deg, np.moveaxis(rotators_deg, -1, 0))
    forward = (cp * cy, cp * sy, sp)
    right = (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, -sr * cp)
    up = (-(cr * sp * cy + sr * sy), cy * sr - cr * sp * sy, cr * cp)
    # Axes (3 axes, 3 coordinates, ...) as the columns of matrices (..., 3, 3).
    axes = np.moveaxis(np.stack([np.stack(forward), np.stack(right), np.stack(up)]), (0, 1), (-1, -2))
    return np.asarray(_MIRROR @ axes @ _MIRROR)


def rotation_to_unreal(rotation: Array) -> Triple:
    """Return the rotator (pitch, yaw, roll), degrees, of a body's rotation (3, 3) in the world.

    The pitch is in [-90, 90].
    """
    forward, right, up = (_MIRROR @ rotation @ _MIRROR).T
    horizontal = float(np.hypot(forward[0], forward[1]))
    pitch = np.arctan2(forward[2], horizontal)
    if horizontal < 1e-9:  # straight up or down yaw and roll turn about the same axis
        yaw = np.arctan2(-right[0], right[1])
        roll = 0.0
    else:
        yaw = np.arctan2(forward[1], forward[0])
        roll = np.arctan2(-right[2], up[2])
    return float(np.degrees(pitch)), float(np.degrees(yaw)), float(np.degrees(roll))


def _sin_cos_deg(angles_deg: Array) -> tuple[Array, Array]:
    """Return sines and cosines of angles of any shape, exact at multiples of 90 degrees, as of cube faces."""
    reduced_deg = angles_deg % 360.0
    is_right = reduced_deg % 90.0 == 0
    quarters = np.where(is_right, reduced_deg // 90, 0).astype(np.int64)
    exact_sines = np.array([0.0, 1.0, 0.0, -1.0])
    radians = np.radians(reduced_deg)
    sine = np.where(is_right, exact_sines[quarters % 4], np.sin(radians))
    cosine = np.where(is_right, exact_sines[(quarters + 1) % 4], np.cos(radians))
    return sine, cosine
