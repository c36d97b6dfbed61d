"""Predictions of another size, and truth as another camera sees it."""

from typing import NamedTuple

import cv2
import numpy as np

from omniscv.cameras import Camera
from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask
from omniscv.reprojection import reproject

_SMOOTH = 0.05  # most relative spread of depth around a pixel that can be interpolated
_FAR_M = 1e30  # stands for no surface, where a largest neighbour is looked for


class Seen(NamedTuple):
    """Depth by another camera.

    Attributes:
        depth: (H, W) metres along rays; 0 where the first camera shows nothing, infinite for no surface.
        doubt: (H, W) bool; also where depth changes between pixels.
        error: (H, W) metres; the whole spread of depth and its bounds around the pixel.
    """

    depth: Array
    doubt: Mask
    error: Array


def seen_by(
    depth: Array, doubt: Mask, error: Array | None, camera: Camera, other: Camera, rotation: Array | None
) -> Seen:
    """Return depth along the rays of another camera at the same place.

    The nearest pixel's depth counts. Its neighbours bound the error of that; where they differ by more than
    5 % the pixel is in doubt.

    Args:
        depth: (H, W) metres along rays.
        doubt: (H, W) bool.
        error: (H, W) metres; None: unknown, as 0.
        camera: of these.
        other: the camera whose rays are asked for, central.
        rotation: (3, 3) from the other camera's frame to that of the first; None: both look in one direction.
    """
    off = np.zeros(depth.shape) if error is None else error
    is_known = camera.valid() & (depth > 0)
    low = np.where(is_known, depth - off, 0)
    high = np.where(is_known, np.minimum(depth + off, _FAR_M), _FAR_M)
    least = _filtered(low, cv2.erode, camera.wraps)
    greatest = _filtered(high, cv2.dilate, camera.wraps)
    is_rough = _filtered(depth, cv2.dilate, camera.wraps) > (1 + _SMOOTH) * _filtered(
        depth, cv2.erode, camera.wraps
    )
    spread = np.maximum(greatest - depth, depth - least)
    spread = np.where(np.isfinite(spread) & (spread < _FAR_M / 2), spread, np.inf)
    in_doubt = _filtered(doubt.astype(np.float64), cv2.dilate, camera.wraps) > 0

    def turned(values: Array) -> Array:
        """Return a picture as the other camera sees it."""
        return np.asarray(
            reproject(values, from_=camera, to=other, rotation=rotation, filter="nearest"), np.float64
        )

    return Seen(turned(depth), turned((in_doubt | is_rough).astype(np.uint8)) > 0, turned(spread))


def _filtered(values: Array, filter_: object, wraps: bool) -> Array:
    """Return the least or the greatest value around each pixel, also across the border of a panorama."""
    finite = np.minimum(values, _FAR_M)
    wide = np.pad(finite, ((0, 0), (1, 1)), mode="wrap" if wraps else "edge")
    return np.asarray(filter_(wide, np.ones((3, 3), np.uint8))[:, 1:-1])  # type: ignore[operator]


def resized(values: Array, shape: tuple[int, int], wraps: bool) -> Array:
    """Return a picture in another size, linearly between pixel centres.

    The first and the last column of a panorama are neighbours. A pixel beside one without a value (0,
    negative, infinite or NaN) takes the nearest one.

    Args:
        values: (H, W).
        shape: of the result.
        wraps: whether the picture is a panorama, whose borders meet.
    """
    height, width = values.shape
    v = (np.arange(shape[0]) + 0.5) * height / shape[0] - 0.5
    u = (np.arange(shape[1]) + 0.5) * width / shape[1] - 0.5
    nearest_row = np.clip(np.round(v), 0, height - 1).astype(np.int64)
    nearest_column = np.clip(np.round(u), 0, width - 1).astype(np.int64)
    nearest = values[nearest_row][:, nearest_column]
    with np.errstate(invalid="ignore"):
        mixed = _between(_between(values, v, 0, wraps=False), u, 1, wraps)
    has_value = np.where(np.isfinite(values) & (values > 0), 1.0, np.nan)
    is_mixed = np.isfinite(_between(_between(has_value, v, 0, wraps=False), u, 1, wraps))
    return np.where(is_mixed, mixed, nearest)


def _between(values: Array, at: Array, axis: int, wraps: bool) -> Array:
    """Return rows or columns between those of a picture, linearly."""
    count = values.shape[axis]
    first = np.floor(at).astype(np.int64)
    share = at - first
    second = first + 1
    if wraps:
        first = first % count
        second = second % count
    else:
        first = np.clip(first, 0, count - 1)
        second = np.clip(second, 0, count - 1)
    weight = share[:, None] if axis == 0 else share[None, :]
    start = np.take(values, first, axis=axis)
    return np.asarray(start * (1 - weight) + np.take(values, second, axis=axis) * weight)
