"""Depth between pixels: exact on planes, and never a point between two surfaces.

On a plane 1 / (planar depth) is linear in the pixel, so bilinear interpolation of it is exact. Across the
edge of an object it would put points in the air: :func:`one_surface` detects that.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_STEP_M = 0.004
_STEP_RELATIVE = 0.001
"""How far neighbours may lie off the line through the other two and still be one surface: less than a
phantom would be seen by (2 cm), more than half floats jump (0.05 %)."""


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
