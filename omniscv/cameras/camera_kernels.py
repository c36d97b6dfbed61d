"""Compiled loops over pixels, imported on first use: numba takes longer to load than everything else.

A pixel has a radius and the cosine and sine of its azimuth; angles are not computed.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry.arrays import ROUNDING

Array = NDArray[np.float64]
Plane = tuple[float, float, float, float, float, float]
"""The map from offsets in px to the plane: a matrix row by row, and two divisors."""
Polar = tuple[NDArray[np.int64], Array, Array, Array]  # indices of pixels, their r, cos a, sin a


@njit("out float64[:, ::1], bool[::1]", nogil=True)
def blank(vectors: Array, keep: NDArray[np.bool_]) -> None:
    """Put NaN into the rows of ``vectors`` (N, 3) where ``keep`` (N,) is False."""
    for i in range(len(keep)):
        if not keep[i]:
            vectors[i, 0] = vectors[i, 1] = vectors[i, 2] = np.nan


@njit(nogil=True, error_model="numpy")
def in_plane(pixels: Array, i: int, center: tuple[float, float], plane: Plane) -> tuple[float, float]:
    """Return pixel i in the plane, whose unit is the focal length."""
    du, dv = pixels[i, 0] - center[0], pixels[i, 1] - center[1]
    return (plane[0] * du + plane[1] * dv) / plane[4], (plane[2] * du + plane[3] * dv) / plane[5]


@njit(nogil=True)
def store(polar: Polar, n: int, i: int, x: float, y: float, r: float) -> int:
    """Write pixel i with the coordinates (x, y) in the plane as the n-th entry; return n + 1."""
    index, radius, cos_a, sin_a = polar
    index[n], radius[n] = i, r
    if r == 0.0:
        cos_a[n], sin_a[n] = 1.0, 0.0
    else:
        cos_a[n], sin_a[n] = x / r, y / r
    return n + 1


@njit(nogil=True)
def length(x: float, y: float) -> float:
    """Return the length of (x, y)."""
    return math.sqrt(x * x + y * y)


@njit(
    "(float64, float64), (6 * float64), float64, float64[:, ::1], (out int64[::1], out float64[::1], "
    "out float64[::1], out float64[::1]) -> int64",
    nogil=True,
    error_model="numpy",
)
def polar_within(center: tuple[float, float], plane: Plane, end: float, pixels: Array, polar: Polar) -> int:
    """Write the pixels (N, 2) whose radius in the plane is at most ``end``; return their number."""
    n = 0
    for i in range(len(pixels)):
        x, y = in_plane(pixels, i, center, plane)
        r = length(x, y)
        if r <= end:
            n = store(polar, n, i, x, y, r)
    return n


@njit(
    "int64[::1], float64[::1], float64[::1], float64[::1], float64[::1], out float64[:, ::1], out bool[::1]",
    nogil=True,
)
def turn(
    index: NDArray[np.int64],
    across: Array,
    along: Array,
    cos_a: Array,
    sin_a: Array,
    directions: Array,
    valid: NDArray[np.bool_],
) -> None:
    """Write directions, given across and along the axis, into the rows ``index``."""
    for n in range(len(index)):
        i = index[n]
        directions[i, 0] = across[n] * cos_a[n]
        directions[i, 1] = across[n] * sin_a[n]
        directions[i, 2] = along[n]
        valid[i] = math.isfinite(along[n])


# -- polynomials --------------------------------------------------------------------------------


@njit("float64[::1], float64[::1], float64[::1], float64, out float64[::1]", nogil=True, error_model="numpy")
def invert(values: Array, coefficients: Array, table: Array, last: float, out: Array) -> None:
    """Write x (N,) with ``p(x) = y`` for values y (N,) in [0, last], where p increases from 0.

    Halley's steps, mostly one, from a table of x at equal steps of y, within an interval that holds the root.
    A step that would leave the interval, as where p turns back, is replaced by a bisection.
    """
    cells = len(table) - 1
    for n in range(len(values)):
        y = values[n]
        position = min(max(y / last * cells, 0.0), float(cells))
        j = min(int(position), cells - 1)
        low, high = table[max(j - 1, 0)], table[min(j + 2, cells)]
        x = table[j] + (position - j) * (table[j + 1] - table[j])
        for _ in range(100):
            value, slope, bend = _value_slope_bend(coefficients, x)
            if value > y:
                high = x
            else:
                low = x
            newton = (value - y) / slope
            turned = newton * bend / slope  # half of the relative change of the slope over a step
            step = newton / (1 - turned)
            if not (abs(turned) < 0.5 and low <= x - step <= high):
                x = (low + high) / 2
                if high - low <= 4e-16 * high:
                    break
                continue
            x -= step
            # The remaining error is about the third power of the step.
            if (turned * turned * x * x + step * step) * abs(step) <= 1e-18 * x * x * x:
                break
        out[n] = x


@njit(nogil=True)
def _value_slope_bend(coefficients: Array, x: float) -> tuple[float, float, float]:
    """Return p, p' and p'' / 2 at x."""
    value, slope, bend = coefficients[-1], 0.0, 0.0
    for k in range(len(coefficients) - 2, -1, -1):
        bend = bend * x + slope
        slope = slope * x + value
        value = value * x + coefficients[k]
    return value, slope, bend


# -- distortion ---------------------------------------------------------------------------------

Coefficients = tuple[float, ...]  # twelve, in OpenCV's order
Distorted = tuple[float, float, float, float, float, float]
"""x'', y'', and their slopes by x and y, row by row."""

Solver = tuple[Coefficients, float, float, float, float, Array]
"""Coefficients; the disc's radius; its distorted radius by the radial terms alone; the largest distorted
radius of its rim; rounding error; radii whose distorted radii by the radial terms are equally spaced."""

_STEPS = 3  # of Newton's: mostly enough
_RADII = 256  # of the disc that are searched for the first turn
_AZIMUTHS = 48  # of each radius
_FINE_AZIMUTHS = 360  # of the radius that is found, and of the rim


@njit(nogil=True, error_model="numpy")
def _distort(k: Coefficients, x: float, y: float) -> Distorted:
    """Return the distorted (x, y), and the derivative there; see :class:`distortion.Distortion`."""
    r2 = x * x + y * y
    above, below = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4])), 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    share = 1 / below
    c = above * share
    above_slope, below_slope = k[0] + r2 * (2 * k[1] + 3 * r2 * k[4]), k[5] + r2 * (2 * k[6] + 3 * r2 * k[7])
    steep = 2 * (above_slope - c * below_slope) * share  # twice c by r2
    p1, p2 = k[2], k[3]
    prism_x, prism_y = k[8] + k[9] * r2, k[10] + k[11] * r2
    bent_x, bent_y = 2 * (k[8] + 2 * k[9] * r2), 2 * (k[10] + 2 * k[11] * r2)
    both = x * y * steep + 2 * (p1 * x + p2 * y)
    return (
        x * c + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + prism_x * r2,
        y * c + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + prism_y * r2,
        c + x * x * steep + 2 * p1 * y + 6 * p2 * x + bent_x * x,
        both + bent_x * y,
        both + bent_y * x,
        c + y * y * steep + 6 * p1 * y + 2 * p2 * x + bent_y * y,
    )


@njit(
    "float64[:, ::1], (12 * float64), out float64[:, ::1]",
    nogil=True,
)
def distort_all(plane: Array, k: Coefficients, out: Array) -> None:
    """Write the distorted coordinates of (N, 2)."""
    for i in range(len(plane)):
        result = _distort(k, plane[i, 0], plane[i, 1])
        out[i, 0], out[i, 1] = result[0], result[1]


@njit(nogil=True)
def _stretches_everywhere(k: Coefficients, r: float, azimuths: int) -> bool:
    """Return whether the derivative is positive definite on the circle of radius r."""
    for j in range(azimuths):
        a = 2 * math.pi * j / azimuths
        _, _, xx, xy, yx, yy = _distort(k, r * math.cos(a), r * math.sin(a))
        if not (xx > 0 and 4 * xx * yy > (xy + yx) ** 2):
            return False
    return True


@njit(
    "(12 * float64), float64 -> float64",
    nogil=True,
)
def first_turn(k: Coefficients, end: float) -> float:
    """Return the radius, at most ``end``, up to which the derivative is positive definite."""
    for i in range(1, _RADII + 1):
        high = end * i / _RADII
        if not _stretches_everywhere(k, high, _AZIMUTHS):
            low = end * (i - 1) / _RADII
            for _ in range(45):
                middle = (low + high) / 2
                if _stretches_everywhere(k, middle, _FINE_AZIMUTHS):
                    low = middle
                else:
                    high = middle
            return low
    return end


@njit(
    "(12 * float64), float64 -> float64",
    nogil=True,
)
def farthest_of_rim(k: Coefficients, end: float) -> float:
    """Return the largest distorted radius of the circle of radius ``end``, times 1.001."""
    most = 0.0
    for j in range(_FINE_AZIMUTHS):
        a = 2 * math.pi * j / _FINE_AZIMUTHS
        x, y, _, _, _, _ = _distort(k, end * math.cos(a), end * math.sin(a))
        most = max(most, length(x, y))
    return 1.001 * most


@njit(
    "(float64, float64), (6 * float64), ((12 * float64), 4 * float64, float64[::1]), float64[:, ::1], "
    "(out int64[::1], out float64[::1], out float64[::1], out float64[::1]) -> int64",
    nogil=True,
    error_model="numpy",
)
def undistorted_within(
    center: tuple[float, float], plane: Plane, solver: Solver, pixels: Array, polar: Polar
) -> int:
    """Write the undistorted coordinates of pixels (N, 2) that have them in the disc; return their number."""
    k, end, last, farthest, _, table = solver
    index, target_x, target_y = np.empty(len(pixels), np.int64), np.empty(len(pixels)), np.empty(len(pixels))
    count = 0
    for i in range(len(pixels)):
        x, y = in_plane(pixels, i, center, plane)
        if length(x, y) <= farthest:
            index[count], target_x[count], target_y[count] = i, x, y
            count += 1
    guess_x, guess_y = np.empty(count), np.empty(count)
    for m in range(count):
        guess_x[m], guess_y[m] = _initial_guess(target_x[m], target_y[m], last, table)
    for _ in range(_STEPS):
        _newton_steps(k, target_x[:count], target_y[:count], guess_x, guess_y)
    n = 0
    for m in range(count):
        x, y = guess_x[m], guess_y[m]
        to_x, to_y, _, _, _, _ = _distort(k, x, y)
        off, r = abs(to_x - target_x[m]) + abs(to_y - target_y[m]), length(x, y)
        good = off <= 1e-15 * length(target_x[m], target_y[m]) and r <= end
        if not good:
            x, y, good = _undistort(target_x[m], target_y[m], solver)
            r = min(length(x, y), end)
        if good:
            n = store(polar, n, index[m], x, y, r)
    return n


@njit(nogil=True, error_model="numpy")
def _initial_guess(target_x: float, target_y: float, last: float, table: Array) -> tuple[float, float]:
    """Return the coordinates that the radial terms alone distort to the target."""
    reached, cells = length(target_x, target_y), len(table) - 1
    at = min(reached / last, 1.0) * cells
    j = min(int(at), cells - 1)
    scale = (table[j] + (at - j) * (table[j + 1] - table[j])) / reached if reached > 0 else 0.0
    return target_x * scale, target_y * scale


@njit(nogil=True, error_model="numpy")
def _newton_steps(k: Coefficients, target_x: Array, target_y: Array, x: Array, y: Array) -> None:
    """Make one of Newton's steps for all coordinates: without branches, so that it is vectorised."""
    for m in range(len(x)):
        to_x, to_y, xx, xy, yx, yy = _distort(k, x[m], y[m])
        off_x, off_y, scale = to_x - target_x[m], to_y - target_y[m], 1 / (xx * yy - xy * yx)
        x[m] -= (yy * off_x - xy * off_y) * scale
        y[m] -= (xx * off_y - yx * off_x) * scale


@njit(nogil=True, error_model="numpy")
def _undistort(target_x: float, target_y: float, solver: Solver) -> tuple[float, float, bool]:
    """Return the undistorted coordinates of a target, and whether it has them: Newton's steps in the disc."""
    k, end, last, _, slack, table = solver
    x, y = _initial_guess(target_x, target_y, last, table)
    # Next to a turn Newton's steps approach a root from the inside; from the outside they may diverge.
    inward = min(0.9 * end / max(length(x, y), 1e-300), 1.0)
    x, y = x * inward, y * inward
    at_the_rim = 0
    for _ in range(100):
        to_x, to_y, xx, xy, yx, yy = _distort(k, x, y)
        off_x, off_y, scale = to_x - target_x, to_y - target_y, 1 / (xx * yy - xy * yx)
        step_x, step_y = (yy * off_x - xy * off_y) * scale, (xx * off_y - yx * off_x) * scale
        step = length(step_x, step_y)
        if not step <= end:
            step_x, step_y = step_x * end / step, step_y * end / step
        before_x, before_y = x, y
        x, y = x - step_x, y - step_y
        r = length(x, y)
        at_the_rim = at_the_rim + 1 if r > end else 0
        if r > end:
            x, y = x * end / r, y * end / r
        if at_the_rim > 4 or length(x - before_x, y - before_y) <= 2e-16 * end:
            break
    to_x, to_y, _, _, _, _ = _distort(k, x, y)
    near = slack + 4e-16 * length(target_x, target_y)
    return x, y, abs(to_x - target_x) + abs(to_y - target_y) <= near


# -- cube maps ----------------------------------------------------------------------------------

_INSIDE = 2e-15  # distance of rays from a face's edge, so that they project to their own slot; half faces


@njit(
    "float64[:, ::1], (int64[::1], float64[::1], float64, bool, int64[::1], float64[:, :, ::1]), "
    "out float64[:, ::1], out bool[::1]",
    nogil=True,
)
def cast(pixels: Any, slots: Any, rays: Any, valid: Any) -> None:
    """Write the unit rays (N, 3) of pixels (N, 2), and which pixels lie in a slot with a face.

    Slots are grid, size and padding in px, whether pixels are at equal angles, and by slot face and axes.
    """
    grid, slot_px, padding, equiangular, face, axes = slots
    row_px, edge = slot_px[1] + 2 * padding, 1 - _INSIDE
    a = np.empty(2)
    for i in range(pixels.shape[0]):
        row = min(max(np.floor(pixels[i, 1] / row_px), 0), grid[1] - 1)
        a[0], a[1] = pixels[i, 0] - padding, pixels[i, 1] - row * row_px - padding
        column = min(max(np.floor(a[0] / slot_px[0]), 0), grid[0] - 1)
        a[0] -= column * slot_px[0]
        for k in range(2):
            a[k] = 2 * a[k] / slot_px[k] - 1
            # In the padding the plane of the face continues.
            if not (padding > 0 and abs(a[k]) > 1 + ROUNDING):
                a[k] = min(max(a[k], -edge), edge)
            if equiangular:
                a[k] = np.tan(np.pi / 4 * a[k])
        z = 1 / np.sqrt(1 + a[0] * a[0] + a[1] * a[1])
        slot = int(row * grid[0] + column)
        valid[i] = face[slot] >= 0
        for k in range(3):
            rays[i, k] = z * (axes[slot, k, 0] * a[0] + axes[slot, k, 1] * a[1] + axes[slot, k, 2])
