"""What lenses, mirrors and panoramas share: radius and azimuth, half of a field of view."""

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import shown
from omniscv.cameras.arrays import Array
from omniscv.errors import ArgumentError

_NO_RADIUS = float(np.finfo(np.float64).tiny)  # of what is nearer, float64 drops digits


def refuse_focal_and_fov(focal: object, fov_deg: object) -> None:
    """Raise ArgumentError where both of two ways to give one number are used."""
    if focal is not None and fov_deg is not None:
        got = f"both ({shown(focal)} px and {shown(fov_deg)} deg)"
        raise ArgumentError(f"focal: expected focal or fov_deg, got {got}")


def sin_cos_of_half(angle_deg: float) -> tuple[Array, Array]:
    """Sine and cosine of ``angle_deg / 2``, 0 to 180; exact to the last digits next to 0, 90, 180 degrees."""
    half = angle_deg / 2
    return np.sin(np.radians(min(half, 180 - half))), np.sin(np.radians(90 - half))


def polar(xy: Array, center: ArrayLike = (0.0, 0.0)) -> tuple[Array, Array, Array]:
    """Radius and the unit vector (cos a, sin a) of the azimuth of (..., 2); (1, 0) at the centre."""
    offset = xy - np.asarray(center)
    x, y = offset[..., 0], offset[..., 1]
    r = np.hypot(x, y)
    at_center = r < _NO_RADIUS
    safe = np.where(at_center, 1.0, r)
    return r, np.where(at_center, 1.0, x / safe), np.where(at_center, 0.0, y / safe)
