"""Perspective pictures: focal length, field of view, rays, projection. Pixel centres lie at +0.5."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Projection(NamedTuple):
    """Focal lengths across and down, and the principal point from the top-left corner; all px."""

    fx: float
    fy: float
    cx: float
    cy: float


def focal_px(width: int, fov_deg: float) -> float:
    """Focal length in px of a picture ``width`` px wide with a horizontal field of view ``fov_deg``,
    degrees."""
    return float(width / 2 / np.tan(np.radians(fov_deg) / 2))


def fov_deg(width: float, focal: float) -> float:
    """The field of view across ``width`` px, degrees, of a focal length in px."""
    return float(np.degrees(2 * np.arctan(width / 2 / focal)))


def project(p_c: Array, projection: Projection) -> Array:
    """Return (..., 3): u, v in px, and planar depth z (z <= 0: behind).

    Args:
        p_c: (..., 3) points in the picture's frame, metres.
        projection: of the picture.
    """
    z = p_c[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = p_c[..., :2] / z * projection[:2] + projection[2:]
    return np.concatenate([uv, z], axis=-1)


def rays(pixels: ArrayLike, projection: Projection) -> Array:
    """Return the rays (..., 3) ``(x/z, y/z, 1)`` of pixels in the picture's frame.

    Args:
        pixels: (..., 2) px.
        projection: of the picture.
    """
    xy = (np.asarray(pixels) - projection[2:]) / projection[:2]
    return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)


def ray_lengths(projection: Projection, width: int, height: int) -> Array:
    """Return (H, W) the length of the ray to each pixel's centre per unit of planar depth.

    Args:
        projection: of the picture.
        width: of the picture, px.
        height: of the picture, px.
    """
    x = (np.arange(width) + 0.5 - projection.cx) / projection.fx
    y = (np.arange(height) + 0.5 - projection.cy) / projection.fy
    return np.asarray(np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2))
