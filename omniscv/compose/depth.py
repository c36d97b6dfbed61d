"""Depth between pixels: exact on planes, and never a point between two surfaces.

On a plane 1 / (planar depth) is linear in the pixel, so bilinear interpolation of it is exact. Across the
edge of an object it would put points in the air: there the nearest pixel's own surface is taken.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_STEP_M = 0.004
_STEP_RELATIVE = 0.001
"""How far neighbours may lie off the line through the other two and still be one surface: less than a
phantom would be seen by (2 cm), more than half floats jump (0.05 %)."""


def sample_depth(
    atlas: NDArray[np.float32],
    rows: int,
    view: NDArray[np.int16],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    half_width: float,
    half_height: float,
    focal: NDArray[np.float64],
    nearest: bool,
) -> NDArray[np.float32]:
    """Distance along the ray at continuous places.

    Args:
        atlas: (V * rows, W) planar metres, +inf where there is no surface; views one below another.
        rows: height of a view.
        view, x, y: (N,) places as :class:`omniscv.plan.places.Places`.
        half_width, half_height: the principal point.
        focal: (V,) px.
        nearest: take the nearest pixel's plane everywhere.

    Returns:
        (N,) float32 metres along the ray; 0 where view is -1.
    """
    out = np.empty(len(view), np.float32)
    _sample(atlas, rows, view, x, y, half_width, half_height, focal, nearest, out)
    return out


@njit(cache=True, nogil=True)
def _sample(
    atlas: NDArray[np.float32],
    rows: int,
    view: NDArray[np.int16],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    half_width: float,
    half_height: float,
    focal: NDArray[np.float64],
    nearest: bool,
    out: NDArray[np.float32],
) -> None:
    width = atlas.shape[1]
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            out[i] = 0.0
            continue
        px, py = x[i] - 0.5, y[i] - 0.5
        top = k * rows
        z = 0.0
        c, r = int(np.floor(px)), int(np.floor(py))
        if not nearest and 1 <= c < width - 2 and 1 <= r < rows - 2 and _one_surface(atlas, top + r, c):
            a, b = px - c, py - r
            t = top + r
            inverse = (1 - b) * ((1 - a) / atlas[t, c] + a / atlas[t, c + 1]) + b * (
                (1 - a) / atlas[t + 1, c] + a / atlas[t + 1, c + 1]
            )
            z = 1.0 / inverse
        else:
            c = min(max(int(np.floor(x[i])), 0), width - 1)
            r = min(max(int(np.floor(y[i])), 0), rows - 1)
            z = atlas[top + r, c]
        u, v = (x[i] - half_width) / focal[k], (y[i] - half_height) / focal[k]
        out[i] = z * np.sqrt(1.0 + u * u + v * v)


@njit(cache=True, nogil=True)
def _one_surface(atlas: NDArray[np.float32], r: int, c: int) -> bool:
    """Whether the 2 x 2 pixels at (r, c) belong to one smooth surface."""
    for j in range(2):
        if not _continues(atlas[r + j, c - 1], atlas[r + j, c], atlas[r + j, c + 1], atlas[r + j, c + 2]):
            return False
        if not _continues(atlas[r - 1, c + j], atlas[r, c + j], atlas[r + 1, c + j], atlas[r + 2, c + j]):
            return False
    return True


@njit(cache=True, nogil=True)
def _continues(before: float, a: float, b: float, after: float) -> bool:
    """Whether a and b lie on one line in 1/z with a neighbour on either side, to a tolerance in metres."""
    if not (a < np.inf and b < np.inf):
        return False
    near = min(a, b)
    step = 1.0 / b - 1.0 / a
    allowed = (_STEP_M + _STEP_RELATIVE * near) / (near * near)
    if abs(step) <= allowed:
        return True
    from_left = before < np.inf and abs(step - (1.0 / a - 1.0 / before)) <= allowed
    from_right = after < np.inf and abs(step - (1.0 / after - 1.0 / b)) <= allowed
    return from_left and from_right
