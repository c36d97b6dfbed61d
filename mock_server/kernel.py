"""The tracing kernel: every ray against every solid, in float64.

A solid is a row of numbers; the columns are named below. It runs without the GIL and without numba's
thread pool, which must not be entered from two Python threads: callers split rays among threads.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

RECTANGLE, BOX, SPHERE, CYLINDER = range(4)
COLUMNS = 20
"""kind, object, then 18 numbers: centre (3), axes as rows (9), half sizes (3), radius of the bounding sphere,
unused (2).

RECTANGLE spans its first two axes and faces along the third; BOX fills all three half sizes; SPHERE has
its radius in the first half size; CYLINDER stands on its third axis, radius first, half height third.
"""

_BUNDLE = 128
"""Rays that are looked at together: neighbours in a picture pass most solids at once."""

_SLACK_RAD = 1e-6
"""More than the rounding of an arc cosine near 1, which is 1.5e-8."""


@njit(cache=True, nogil=True)
def _box(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, hx: float, hy: float, hz: float
) -> tuple[float, float, float, float]:
    """First hit from outside, or the wall met from inside; the normal faces the ray."""
    near, far = -math.inf, math.inf
    axis_near = axis_far = 0
    for axis in range(3):
        p = px if axis == 0 else (py if axis == 1 else pz)
        d = dx if axis == 0 else (dy if axis == 1 else dz)
        h = hx if axis == 0 else (hy if axis == 1 else hz)
        if d == 0.0:
            if abs(p) > h:
                return math.inf, 0.0, 0.0, 0.0
        else:
            t0, t1 = (-h - p) / d, (h - p) / d
            if t0 > t1:
                t0, t1 = t1, t0
            if t0 > near:
                near, axis_near = t0, axis
            if t1 < far:
                far, axis_far = t1, axis
    if near > far or far <= 0.0:
        return math.inf, 0.0, 0.0, 0.0
    t, axis = (near, axis_near) if near > 0.0 else (far, axis_far)
    d = dx if axis == 0 else (dy if axis == 1 else dz)
    m = -math.copysign(1.0, d)
    return t, m if axis == 0 else 0.0, m if axis == 1 else 0.0, m if axis == 2 else 0.0


@njit(cache=True, nogil=True)
def _roots(a: float, half_b: float, c: float) -> tuple[float, float]:
    """Ordered roots of a t^2 + 2 half_b t + c, without cancellation; infinite if there are none."""
    square = half_b * half_b - a * c
    if square < 0.0 or a == 0.0:
        return math.inf, math.inf
    q = -(half_b + math.copysign(math.sqrt(square), half_b))
    t0 = q / a
    t1 = c / q if q != 0.0 else t0
    return (t0, t1) if t0 < t1 else (t1, t0)


@njit(cache=True, nogil=True)
def _sphere(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, r: float
) -> tuple[float, float, float, float]:
    t0, t1 = _roots(1.0, px * dx + py * dy + pz * dz, px * px + py * py + pz * pz - r * r)
    t = t0 if t0 > 0.0 else t1
    if not 0.0 < t < math.inf:
        return math.inf, 0.0, 0.0, 0.0
    side = 1.0 if t0 > 0.0 else -1.0
    return t, side * (px + t * dx) / r, side * (py + t * dy) / r, side * (pz + t * dz) / r


@njit(cache=True, nogil=True)
def _cylinder(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, r: float, h: float
) -> tuple[float, float, float, float]:
    best, m0, m1, m2 = math.inf, 0.0, 0.0, 0.0
    t0, t1 = _roots(dx * dx + dy * dy, px * dx + py * dy, px * px + py * py - r * r)
    for t in (t0, t1):
        if 0.0 < t < best and abs(pz + t * dz) <= h:
            x, y = px + t * dx, py + t * dy
            side = 1.0 if x * dx + y * dy < 0.0 else -1.0
            best, m0, m1, m2 = t, side * x / r, side * y / r, 0.0
    if dz != 0.0:
        for cap in (-h, h):
            t = (cap - pz) / dz
            x, y = px + t * dx, py + t * dy
            if 0.0 < t < best and x * x + y * y <= r * r:
                best, m0, m1, m2 = t, 0.0, 0.0, -math.copysign(1.0, dz)
    return best, m0, m1, m2


@njit(cache=True, nogil=True)
def _within_reach(
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    solids: NDArray[np.float64],
    kept: NDArray[np.int64],
) -> int:
    """Puts into ``kept`` the solids whose bounding spheres a bundle of rays may meet; their number.

    The bundle lies in the cone about its mean direction, widened by how far its origins are apart. Rays with
    NaN compare as false, so that nothing is left out for them.
    """
    count = origins.shape[0]
    o, a = np.zeros(3), np.zeros(3)
    for i in range(count):
        o += origins[i] / count
        a += directions[i]
    a /= math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    least, spread = 1.0, 0.0
    for i in range(count):
        cosine = a[0] * directions[i, 0] + a[1] * directions[i, 1] + a[2] * directions[i, 2]
        x, y, z = origins[i, 0] - o[0], origins[i, 1] - o[1], origins[i, 2] - o[2]
        least = least if least <= cosine else cosine
        spread = max(spread, math.sqrt(x * x + y * y + z * z))
    half_angle = math.acos(max(-1.0, least)) + _SLACK_RAD
    number = 0
    for s in range(solids.shape[0]):
        x, y, z = solids[s, 2] - o[0], solids[s, 3] - o[1], solids[s, 4] - o[2]
        distance, radius = math.sqrt(x * x + y * y + z * z), solids[s, 17] + spread
        if distance > radius:
            cosine = (a[0] * x + a[1] * y + a[2] * z) / distance
            if math.acos(min(1.0, max(-1.0, cosine))) > half_angle + math.asin(radius / distance):
                continue
        kept[number] = s
        number += 1
    return number


@njit(cache=True, nogil=True)
def nearest_hits(
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    solids: NDArray[np.float64],
    distance: NDArray[np.float64],
    index: NDArray[np.int64],
    normal: NDArray[np.float64],
) -> None:
    """Fills distance, index (row of ``solids``, -1 for none) and outward normal of each ray's first hit."""
    kept = np.empty(solids.shape[0], dtype=np.int64)
    for start in range(0, origins.shape[0], _BUNDLE):
        stop = min(start + _BUNDLE, origins.shape[0])
        number = _within_reach(origins[start:stop], directions[start:stop], solids, kept)
        for i in range(start, stop):
            distance[i], index[i] = _first(origins[i], directions[i], solids, kept[:number], normal[i])


@njit(cache=True, nogil=True)
def _first(
    o: NDArray[np.float64],
    d: NDArray[np.float64],
    solids: NDArray[np.float64],
    kept: NDArray[np.int64],
    normal: NDArray[np.float64],
) -> tuple[float, int]:
    """Distance and row of one ray's first hit among the solids kept; fills its normal."""
    best, which = math.inf, -1
    n0 = n1 = n2 = 0.0
    for s in kept:
        row = solids[s]
        x, y, z = o[0] - row[2], o[1] - row[3], o[2] - row[4]
        a, b, c = d[0], d[1], d[2]
        # Passed over unless the ray enters the solid's bounding sphere before the nearest hit so far.
        toward = -(a * x + b * y + c * z)
        beside = x * x + y * y + z * z - toward * toward
        if toward < -row[17] or toward - row[17] > best or beside > row[17] * row[17]:
            continue
        # The ray in the solid's own frame.
        px = row[5] * x + row[6] * y + row[7] * z
        py = row[8] * x + row[9] * y + row[10] * z
        pz = row[11] * x + row[12] * y + row[13] * z
        dx = row[5] * a + row[6] * b + row[7] * c
        dy = row[8] * a + row[9] * b + row[10] * c
        dz = row[11] * a + row[12] * b + row[13] * c
        t, m0, m1, m2 = math.inf, 0.0, 0.0, 0.0
        kind = int(row[0])
        if kind == RECTANGLE:
            if dz != 0.0:
                hit = -pz / dz
                if hit > 0.0 and abs(px + hit * dx) <= row[14] and abs(py + hit * dy) <= row[15]:
                    t, m2 = hit, -math.copysign(1.0, dz)
        elif kind == BOX:
            t, m0, m1, m2 = _box(px, py, pz, dx, dy, dz, row[14], row[15], row[16])
        elif kind == SPHERE:
            t, m0, m1, m2 = _sphere(px, py, pz, dx, dy, dz, row[14])
        else:
            t, m0, m1, m2 = _cylinder(px, py, pz, dx, dy, dz, row[14], row[16])
        if t < best:
            best, which = t, s
            n0 = row[5] * m0 + row[8] * m1 + row[11] * m2
            n1 = row[6] * m0 + row[9] * m1 + row[12] * m2
            n2 = row[7] * m0 + row[10] * m1 + row[13] * m2
    normal[0], normal[1], normal[2] = n0, n1, n2
    return best, which
