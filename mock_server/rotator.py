"""Unreal's rotators: pitch, yaw, roll in degrees; left-handed, X forward, Y right, Z up.

Written from the protocol reference, section 4, and independent of ``omniscv``, which is tested against it.
"""

import math

import numpy as np
from numpy.typing import NDArray

Triple = tuple[float, float, float]
Array = NDArray[np.float64]

MIRROR = np.diag([1.0, -1.0, 1.0])
"""Unreal's axes to the scene's, and back."""

_POLE = 0.4999995
"""Half the sine of the pitch from which the engine reads it as 90 degrees; that pitch is 89.92."""


def axes(rotation: Triple) -> Array:
    """Return (3, 3) columns forward, right, up in Unreal's axes."""
    p, y, r = map(math.radians, rotation)
    sp, cp, sy, cy, sr, cr = math.sin(p), math.cos(p), math.sin(y), math.cos(y), math.sin(r), math.cos(r)
    forward = (cp * cy, cp * sy, sp)
    right = (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, -sr * cp)
    up = (-(cr * sp * cy + sr * sy), cy * sr - cr * sp * sy, cr * cp)
    return np.stack([forward, right, up], axis=1)


def camera_to_world(rotation: Triple) -> Array:
    """Return (3, 3) camera (x right, y down, z forward) to the scene's world frame."""
    forward, right, up = (MIRROR @ axes(rotation)).T
    return np.stack([right, -up, forward], axis=1)


def through_quaternion(rotation: Triple) -> Triple:
    """Return a rotation as it reads after the engine stored it as a quaternion, in single precision.

    Pitch comes back in [-90, 90], yaw and roll in (-180, 180]; near the poles yaw and roll are split
    arbitrarily.
    """
    half = [np.float32(math.radians(math.remainder(angle, 360.0)) / 2) for angle in rotation]
    sp, sy, sr = (np.sin(a) for a in half)
    cp, cy, cr = (np.cos(a) for a in half)
    x = cr * sp * sy - sr * cp * cy
    y = -cr * sp * cy - sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    w = cr * cp * cy + sr * sp * sy
    sine_half = z * x - w * y
    yaw = math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    turn = math.degrees(2 * math.atan2(x, w))
    if abs(sine_half) > _POLE:
        side = math.copysign(1.0, sine_half)
        roll = math.remainder(side * yaw - turn, 360.0)
        return side * 90.0, yaw, 180.0 if roll == -180.0 else roll
    roll = math.degrees(math.atan2(-2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
    return math.degrees(math.asin(2 * sine_half)), yaw, roll
