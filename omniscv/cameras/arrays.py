"""Arrays of pixels and vectors: grids, radius and azimuth."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import shown
from omniscv.errors import ArgumentError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ROUNDING = 1e-12
"""Relative rounding error of a radius."""


def grid_axes(pixels: Array) -> tuple[Array, Array]:
    """Return u and v of pixels (..., 2); of a grid (H, W, 2), a row (1, W) of u and a column (H, 1) of v."""
    u, v = pixels[..., 0], pixels[..., 1]
    if pixels.ndim == 3 and (u == u[:1]).all() and (v == v[:, :1]).all():
        return u[:1], v[:, :1]
    return u, v


def vectors(x: Array, y: Array, z: Array) -> Array:
    """Return vectors (..., 3) of coordinates that broadcast, such as rows and columns of a grid."""
    xyz = np.empty((*np.broadcast_shapes(x.shape, y.shape, z.shape), 3))
    xyz[..., 0], xyz[..., 1], xyz[..., 2] = x, y, z
    return xyz


def refuse_focal_and_fov(focal: object, fov_deg: object) -> None:
    """Raise ArgumentError if both ways to give the focal length are used."""
    if focal is not None and fov_deg is not None:
        got = f"{shown(focal)} px and {shown(fov_deg)} deg"
        raise ArgumentError(f"focal: expected focal or fov_deg, got both ({got})")


def sin_cos_of_half(angle_deg: float) -> tuple[Array, Array]:
    """Return sine and cosine of ``angle_deg / 2``; exact to the last digits near 0, 90 and 180 degrees."""
    half = angle_deg / 2
    return np.sin(np.radians(min(half, 180 - half))), np.sin(np.radians(90 - half))


def polar(xy: Array, center: ArrayLike = (0.0, 0.0)) -> tuple[Array, Array, Array]:
    """Return radius r and azimuth (cos a, sin a) of (..., 2); (1, 0) at the centre."""
    offset = xy - np.asarray(center)
    x, y = offset[..., 0], offset[..., 1]
    r = np.hypot(x, y)
    at_center = r == 0
    safe = np.where(at_center, 1.0, r)
    return r, np.where(at_center, 1.0, x / safe), np.where(at_center, 0.0, y / safe)
