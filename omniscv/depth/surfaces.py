"""Depth between the pixels of a picture of planar depth.

A picture shows a point ``p = z (u, v, 1)`` at the pixel ``(f u, f v)`` from its principal point. On a plane
``m . p = 1`` with ``m = (a, b, e)``::

    1 / z = a u + b v + e

So inverse planar depth is linear in the pixel, and bilinear interpolation of it is exact on planes. Its
change per pixel is ``across = a / f`` and ``down = b / f``; hence :func:`plane_of`. Three things follow:

- depth along a ray is ``z |(u, v, 1)|`` (:mod:`omniscv.depth.depth_pictures`);
- the normal of the plane is ``-m / |m|`` (:mod:`omniscv.depth.nearest`);
- a ray ``o + t d`` meets the plane at ``t = (1 - m . o) / (m . d)`` (:mod:`omniscv.depth.ray_marching`).

Neighbouring pixels show one surface if inverse depth continues linearly on either side of the step between
them (:func:`discontinuities`). Across the edge of an object interpolation would put points into the air:
there the nearest pixel's own surface is continued by its own slope.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry.arrays import Floats
from omniscv.geometry.precision import (
    FLOAT32,
    LEAST_M,
    STEP,
    Precision,
    inverse_depth,
    inverse_depth32,
    rounding,
    stored_length,
)

CONTINUED = 0.006
"""How far a surface is continued in depth beyond the last pixel that shows it, relative to its depth: it may
end there."""
_NONE = np.float32(0)
_QUARTER = np.float32(0.25)
_NOWHERE = np.float32(np.inf)
_STEP = np.float32(STEP)


class Point(NamedTuple):
    """The surface at a continuous pixel.

    Attributes:
        inverse: 1 / planar depth, 1/m; 0: no surface.
        across, down: change of ``inverse`` per pixel, 1/m.
        error: bound on the error of ``inverse`` on this surface, 1/m.
        jump: difference in planar depth to neighbouring pixels that show other surfaces, metres; else 0.
    """

    inverse: float
    across: float
    down: float
    error: float
    jump: float


Shape = tuple[int, int]
"""Height and width, px."""
Corners = tuple[float, float, float, float]
"""Values of four pixels: of 2 x 2, row by row, or of four in line."""


@njit(nogil=True)
def surface_point(
    depth: Floats, first: int, shape: Shape, x: float, y: float, focal: float, precision: Precision
) -> Point:
    """Return the surface at continuous pixel (x, y) of a picture of planar depth; ``inverse`` is 0 without
    one.

    Pictures stand one after the other, row by row, in ``depth`` (N,), metres; ``first`` is the picture's
    first pixel; focal length in px.
    """
    height, width = shape
    px, py = x - 0.5, y - 0.5
    c, r = int(np.floor(px)), int(np.floor(py))
    if 1 <= c < width - 2 and 1 <= r < height - 2:
        o = first + r * width + c
        up, lower, below = o - width, o + width, o + 2 * width
        upper = (depth[o - 1], depth[o], depth[o + 1], depth[o + 2])
        under = (depth[lower - 1], depth[lower], depth[lower + 1], depth[lower + 2])
        left = (depth[up], depth[o], depth[lower], depth[below])
        right = (depth[up + 1], depth[o + 1], depth[lower + 1], depth[below + 1])
        corners, a, b = (upper[1], upper[2], under[1], under[2]), px - c, py - r
        length = stored_length(r, c, shape, focal, precision)
        inverse, across, down, error, noise = interpolated(
            corners, a, b, length, max(height, width), precision
        )
        bend = max(_bend(upper, a, noise), _bend(under, a, noise))
        bend += max(_bend(left, b, noise), _bend(right, b, noise))
        if bend < np.inf:
            return Point(inverse, across, down, error + bend, 0.0)
    return continued(depth, first, shape, x, y, focal, precision)  # type: ignore[no-any-return]


@njit(nogil=True, forceinline=True)
def nearest_pixel(shape: tuple[int, int], x: float, y: float) -> tuple[int, int]:
    """Return row and column of the pixel that holds (x, y), or of the nearest one at the border."""
    c = min(max(int(np.floor(x)), 0), shape[1] - 1)
    r = min(max(int(np.floor(y)), 0), shape[0] - 1)
    return r, c


@njit(nogil=True)
def plane_of(
    inverse: float, across: float, down: float, dx: float, dy: float, fx: float, fy: float
) -> tuple[float, float, float]:
    """Return m of the plane ``m . p = 1`` through a surface, in the picture's frame, 1/m.

    Args:
        inverse, across, down: as :class:`Point`.
        dx, dy: px from the principal point.
        fx, fy: focal lengths across and down, px.
    """
    return across * fx, down * fy, inverse - across * dx - down * dy


@njit(nogil=True, error_model="numpy", forceinline=True)
def interpolated(
    corners: Corners, a: float, b: float, length: float, size: int, precision: Precision
) -> tuple[float, float, float, float, float]:
    """Return ``inverse``, ``across``, ``down`` and ``error`` of the :class:`Point` between 2 x 2 pixels on a
    surface that does not bend; and what rounding makes of second differences of ``inverse``, 1/m: mostly they
    are smaller.

    It has no branch, so that it compiles to vector instructions.

    Args:
        corners: planar depth of the pixels, row by row.
        a, b: px from the first pixel, across and down, 0 to 1.
        length: :func:`stored_length` there.
        size: px of the longer side of the picture.
        precision: of the picture.
    """
    z00, z01, z10, z11 = corners
    i00, i01, i10, i11 = inverse_depth(z00), inverse_depth(z01), inverse_depth(z10), inverse_depth(z11)
    inverse = (1 - b) * ((1 - a) * i00 + a * i01) + b * ((1 - a) * i10 + a * i11)
    across, down = (1 - b) * (i01 - i00) + b * (i11 - i10), (1 - a) * (i10 - i00) + a * (i11 - i01)
    near, far = max(max(i00, i01), max(i10, i11)), min(min(i00, i01), min(i10, i11))
    least, most = min(min(z00, z01), min(z10, z11)), max(max(z00, z01), max(z10, z11))
    at_near = rounding(np.float64(least), length, precision)
    at_far = rounding(np.float64(most), length, precision)
    stored = max(near * near * at_near, far * far * at_far)
    placed = (abs(across) + abs(down)) * (FLOAT32 * size + precision.middle_px)  # coordinates are float32
    return inverse, across, down, stored + placed, 2.0 * stored


def discontinuities(face: Floats) -> NDArray[np.uint8]:
    """Return (h, w) uint8: 0 at pixels beside another surface than their own, 255 elsewhere."""
    out = np.full(face.shape, 255, np.uint8)
    _mark_discontinuities(face, out)
    return out


@njit("float32[:, ::1], out uint8[:, ::1]", nogil=True)
def _mark_discontinuities(face: Floats, out: NDArray[np.uint8]) -> None:
    height, width = face.shape
    for r in range(height):
        for c in range(width):
            if c + 1 < width:
                before, after = face[r, max(c - 1, 0)], face[r, min(c + 2, width - 1)]
                if not _same(before, face[r, c], face[r, c + 1], after):
                    out[r, c] = out[r, c + 1] = 0
            if r + 1 < height:
                before, after = face[max(r - 1, 0), c], face[min(r + 2, height - 1), c]
                if not _same(before, face[r, c], face[r + 1, c], after):
                    out[r, c] = out[r + 1, c] = 0


@njit(nogil=True, error_model="numpy")
def _same(before: float, a: float, b: float, after: float) -> bool:
    """Return whether neighbouring depths a and b are both no surface, or one."""
    return bool((a == np.inf and b == np.inf) or _bend((before, a, b, after), 0.0, 0.0) < np.inf)


@njit(nogil=True, error_model="numpy")
def _bend(line: Corners, at: float, noise: float) -> float:
    """Return how far 1/z of a curve or a crease may lie off the chord between the second and the third of
    four pixels, ``at`` the way along it, 1/m; +inf where these two are not one surface.

    Where the second difference on one side is unknown, because the surface ends there, the curve may go on
    from the other side as far as it likes; where both are, the surface is as narrow as the step.
    """
    before, a, b, after = line
    inverses = inverse_depth32(before), inverse_depth32(a), inverse_depth32(b), inverse_depth32(after)
    bend, left, right, one_surface = turns(line, inverses, np.float32(noise))
    if not one_surface:
        return math.inf
    if bend < np.inf:
        return float(at * (1.0 - at) * bend)
    known_left, known_right = inverses[0] > 0.0, inverses[3] > 0.0
    if known_left and known_right:
        return float(max(at * left, (1.0 - at) * right))
    if known_left or known_right:
        return float(at * left + (1.0 - at) * right + noise)
    return float(CONTINUED * max(inverses[1], inverses[2]))


@njit(nogil=True, error_model="numpy", forceinline=True)
def turns(line: Corners, inverses: Corners, noise: Any) -> tuple[Any, Any, Any, Any]:
    """Return how 1/z bends between the second and the third of four pixels, 1/m; its second differences on
    both sides; and whether the two show one surface: on one line with the neighbours on both sides, or nearly
    equal, or nearer than rounding tells.

    ``t`` the way along the chord 1/z lies at most ``t (1 - t)`` times the first off it; that is +inf where
    it has no such bound: beside an edge, and at a step. The second differences bound a crease, less what
    rounding makes of them. They are eight times what a curve is off in the middle, so a quarter of them
    bounds it, more what rounding hides. They count with their signs: a rounded plane bends one way and back
    by a rounding step, which the pixels' own errors hold already. Both of one sign, beyond rounding, they are
    a cusp, as between touching cylinders, whose slopes grow toward it. Of opposite signs, beyond rounding,
    they are a step.

    It has no branch, and all is float32, so that it compiles to vector instructions: differences of depths
    are exact.

    Args:
        line: planar depth.
        inverses: 1 / line.
        noise: what rounding makes of second differences, 1/m.
    """
    (before, a, b, after), (of_before, of_a, of_b, of_after) = line, inverses
    step, allowed = (a - b) * of_a * of_b, max(_STEP * max(of_a, of_b), noise + noise)
    turn_left, turn_right = (before - a) * of_before * of_a - step, step - (b - after) * of_b * of_after
    known_left, known_right = of_before > _NONE, of_after > _NONE
    left, right = abs(turn_left) if known_left else _NONE, abs(turn_right) if known_right else _NONE
    known, opposite = known_left & known_right, turn_left * turn_right < _NONE
    on_line = known & (left <= allowed) & (right <= allowed)
    one_surface = (of_a > _NONE) & (of_b > _NONE) & ((abs(step) <= allowed) | on_line)
    both, least = abs(turn_left + turn_right), min(left, right)
    cusp = (not opposite) & (least > noise + noise)
    bend = max(max(both - noise, _QUARTER * (both + noise)), both + both + both - noise if cusp else _NONE)
    bounded = known & one_surface & (not (opposite & (least > noise)))
    return bend if bounded else _NOWHERE, left, right, one_surface


@njit(nogil=True)
def continued(
    depth: Floats, first: int, shape: Shape, x: float, y: float, focal: float, precision: Precision
) -> Point:
    """Return the surface of the nearest pixel, continued by its own slope to continuous pixel (x, y).

    Arguments as :func:`surface_point`.
    """
    r, c = nearest_pixel(shape, x, y)
    dx, dy = x - 0.5 - c, y - 0.5 - r
    z = max(_at(depth, first, shape, r, c), LEAST_M)
    jump = _jump(depth, first, shape, r, c)
    if not z < np.inf:
        return Point(0.0, 0.0, 0.0, 0.0, jump)
    left, far_left = _at(depth, first, shape, r, c - 1), _at(depth, first, shape, r, c - 2)
    right, far_right = _at(depth, first, shape, r, c + 1), _at(depth, first, shape, r, c + 2)
    up, far_up = _at(depth, first, shape, r - 1, c), _at(depth, first, shape, r - 2, c)
    down, far_down = _at(depth, first, shape, r + 1, c), _at(depth, first, shape, r + 2, c)
    across, known_across = _slope((far_left, left, z, right, far_right), dx)
    along, known_along = _slope((far_up, up, z, down, far_down), dy)
    inverse = 1.0 / z + across * dx + along * dy
    most = CONTINUED * z
    limited = min(max(inverse, 1.0 / (z + most)), 1.0 / max(z - most, 0.5 * z))
    length = stored_length(r, c, shape, focal, precision)
    error = 3.0 * rounding(z, length, precision) / (z * z) + abs(inverse - limited)
    error += (abs(across) + abs(along)) * precision.middle_px
    if not (known_across and known_along):
        error += most / (z * z)
    return Point(limited, across, along, error, jump)


@njit(nogil=True)
def _at(depth: Floats, first: int, shape: Shape, r: int, c: int) -> float:
    """Return planar depth at a pixel; +inf beyond the picture."""
    return float(depth[first + r * shape[1] + c]) if 0 <= r < shape[0] and 0 <= c < shape[1] else np.inf


@njit(nogil=True, error_model="numpy")
def _jump(depth: Floats, first: int, shape: Shape, r: int, c: int) -> float:
    """Return the largest difference in depth to the surfaces of the neighbours, metres, each continued to
    this pixel by its slope on the far side: a wall at a grazing angle recedes by metres within a pixel."""
    height, width = shape
    o = first + r * width + c
    z = depth[o]
    most = 0.0
    inside = 3 <= r < height - 3 and 3 <= c < width - 3
    for j in range(max(r - 1, 0), min(r + 2, height)):
        for k in range(max(c - 1, 0), min(c + 2, width)):
            away = (j - r) * width + k - c
            near = depth[o + away]
            if near == z:
                continue
            most = max(most, abs(near - z))
            if not near < np.inf:
                continue
            if inside:
                next_ = float(depth[o + 2 * away])
                beyond = float(depth[o + 3 * away])
            else:
                next_ = _at(depth, first, shape, 2 * j - r, 2 * k - c)
                beyond = _at(depth, first, shape, 3 * j - 2 * r, 3 * k - 2 * c)
            if not next_ < np.inf:
                continue
            inverse = inverse_depth(near)
            step = inverse_depth(next_) - inverse
            allowed = allowed_step(near)
            on = abs(step) <= allowed
            if not on and beyond < np.inf:  # divisions are what takes time: the third only where it counts
                on = abs(inverse_depth(beyond) - inverse_depth(next_) - step) <= allowed
            if on:
                most = max(most, abs(1.0 / max(inverse - step, 0.5 * inverse) - z))
    return float(most)


@njit(nogil=True)
def _slope(line: tuple[float, float, float, float, float], toward: float) -> tuple[float, bool]:
    """Return the slope of 1/z at the middle of five pixels, from a side where the surface continues, that of
    ``toward`` if both sides differ; and whether it is known."""
    here = line[2]
    allowed = allowed_step(here)
    left, has_left = _one_sided(here, line[1], line[0], allowed)
    right, has_right = _one_sided(here, line[3], line[4], allowed)
    if has_left and has_right:
        if abs(left + right) <= allowed:
            return 0.5 * (right - left), True
        return (right if toward > 0 else -left), True
    if has_left or has_right:
        return (right if has_right else -left), True
    return 0.0, False


@njit(nogil=True)
def _one_sided(here: float, next_: float, beyond: float, allowed: float) -> tuple[float, bool]:
    """Return 1/z of the next pixel less that of this one, and whether both lie on one surface."""
    if not next_ < np.inf:
        return 0.0, False
    step = inverse_depth(next_) - inverse_depth(here)
    curve = inverse_depth(beyond) - inverse_depth(next_) - step
    on = abs(step) <= allowed or (beyond < np.inf and abs(curve) <= allowed)
    return step, on


@njit(nogil=True)
def allowed_step(z: float) -> float:
    """Return how far 1/z may be off a line through neighbours on the same surface."""
    return float(STEP * inverse_depth(z))


@njit(nogil=True)
def fitted_plane(face: Floats, r: int, c: int, reach: int) -> tuple[float, float, float, bool]:
    """Return 1/z at a pixel, its change across and down, and whether these are known.

    Least squares over the pixels within ``reach`` that continue the pixel's surface.
    """
    across, down = _smaller_step(face, r, c, 0, 1), _smaller_step(face, r, c, 1, 0)
    here, allowed = inverse_depth(face[r, c]), allowed_step(face[r, c])
    count = x = y = xx = xy = yy = 0  # sums over the pixels: whole numbers, so the determinant is exact
    value, value_x, value_y = 0.0, 0.0, 0.0
    for j in range(max(r - reach, 0), min(r + reach + 1, face.shape[0])):
        for k in range(max(c - reach, 0), min(c + reach + 1, face.shape[1])):
            dx, dy, inverse = k - c, j - r, inverse_depth(face[j, k])
            steps = max(1, abs(dx), abs(dy))
            if abs(inverse - here - across * dx - down * dy) > allowed * steps:
                continue
            count, x, y = count + 1, x + dx, y + dy
            xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
            value, value_x, value_y = value + inverse, value_x + dx * inverse, value_y + dy * inverse
    # Cramer's rule for the normal equations.
    of_value, of_x, of_y = xx * yy - xy * xy, xy * y - x * yy, x * xy - xx * y
    determinant = count * of_value + x * of_x + y * of_y
    if determinant == 0:  # the pixels lie on a line
        return here, 0.0, 0.0, False
    of_xx, of_xy, of_yy = count * yy - y * y, x * y - count * xy, count * xx - x * x
    return (
        (of_value * value + of_x * value_x + of_y * value_y) / determinant,
        (of_x * value + of_xx * value_x + of_xy * value_y) / determinant,
        (of_y * value + of_xy * value_x + of_yy * value_y) / determinant,
        True,
    )


@njit(nogil=True)
def _smaller_step(face: Floats, r: int, c: int, down: int, across: int) -> float:
    """Return the smaller change of 1/z to a neighbour along an axis, which is on the pixel's own surface."""
    least, slope = np.inf, 0.0
    for sign in (-1, 1):
        j, k = r + sign * down, c + sign * across
        if 0 <= j < face.shape[0] and 0 <= k < face.shape[1] and face[j, k] < np.inf:
            step = inverse_depth(face[j, k]) - inverse_depth(face[r, c])
            if abs(step) < least:
                least, slope = abs(step), sign * step
    return slope
