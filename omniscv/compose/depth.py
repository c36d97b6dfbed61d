"""Depth between pixels: exact on planes, and never a point between two surfaces.

On a plane 1 / (planar depth) is linear in the pixel, so bilinear interpolation of it is exact. Across the
edge of an object it would put points in the air: there the nearest pixel's own surface is taken.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from omniscv.parallel import blocks
from omniscv.plan.places import Places

_STEP_M = 0.004
_STEP_RELATIVE = 0.001
"""How far neighbours may lie off the line through the other two and still be one surface: less than a
phantom would be seen by (2 cm), more than half floats jump (0.05 %)."""


def sample_depth(
    faces: Sequence[NDArray[np.float32]],
    places: Places,
    half_width: float,
    half_height: float,
    focal: NDArray[np.float64],
    nearest: bool,
) -> NDArray[np.float32]:
    """Distance along the ray at places.

    Args:
        faces: (h, w) planar metres of each view, +inf where there is no surface.
        places: (N,) where rays lie.
        half_width, half_height: the principal point, px.
        focal: (V,) px.
        nearest: take the nearest pixel's plane everywhere.

    Returns:
        (N,) float32 metres along the ray; 0 where no view sees it.
    """
    stack = np.stack(faces)
    out = np.empty(len(places.view), np.float32)

    def part(rows: slice) -> None:
        _sample(
            stack, places.view[rows], places.x[rows], places.y[rows], half_width, half_height, focal, nearest,
            out[rows],
        )  # fmt: skip

    blocks(part, len(out))
    return out


@njit(cache=True, nogil=True)
def _sample(
    stack: NDArray[np.float32],
    view: NDArray[np.int16],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    half_width: float,
    half_height: float,
    focal: NDArray[np.float64],
    nearest: bool,
    out: NDArray[np.float32],
) -> None:
    height, width = stack.shape[1], stack.shape[2]
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            out[i] = 0.0
            continue
        face = stack[k]
        px, py = x[i] - 0.5, y[i] - 0.5
        z = 0.0
        c, r = int(np.floor(px)), int(np.floor(py))
        if not nearest and 1 <= c < width - 2 and 1 <= r < height - 2 and one_surface(face, r, c):
            z = interpolated(face, r, c, px - c, py - r)
        else:
            c = min(max(int(np.floor(x[i])), 0), width - 1)
            r = min(max(int(np.floor(y[i])), 0), height - 1)
            z = face[r, c]
        u, v = (x[i] - half_width) / focal[k], (y[i] - half_height) / focal[k]
        out[i] = z * np.sqrt(1.0 + u * u + v * v)


@njit(cache=True, nogil=True)
def interpolated(face: NDArray[np.float32], r: int, c: int, a: float, b: float) -> float:
    """Between the 2 x 2 pixels at (r, c), linear in the inverse: a across, b down, 0..1."""
    above = (1 - a) / face[r, c] + a / face[r, c + 1]
    below = (1 - a) / face[r + 1, c] + a / face[r + 1, c + 1]
    return float(1.0 / ((1 - b) * above + b * below))


@njit(cache=True, nogil=True)
def one_surface(face: NDArray[np.float32], r: int, c: int) -> bool:
    """Whether the 2 x 2 pixels at (r, c) belong to one smooth surface, for depths or distances."""
    for j in range(2):
        if not _continues(face[r + j, c - 1], face[r + j, c], face[r + j, c + 1], face[r + j, c + 2]):
            return False
        if not _continues(face[r - 1, c + j], face[r, c + j], face[r + 1, c + j], face[r + 2, c + j]):
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
