"""The tracing kernel: every ray against every solid, in float64.

A solid is a row of numbers; the columns are named below. It runs without the GIL and without numba's thread
pool, which must not be entered from two Python threads: callers distribute rays over threads.
"""

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

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Vector = tuple[float, float, float]
Hit = tuple[float, float, float, float]
"""Distance, and normal in the frame of the solid."""

_MISS = (math.inf, 0.0, 0.0, 0.0)

_BUNDLE = 128
"""Rays that are tested together: neighbours in an image miss most solids together."""

_SLACK_RAD = 1e-6
"""More than the rounding of an arc cosine near 1, which is 1.5e-8."""


@njit(cache=True, nogil=True)
def _box(p: Vector, d: Vector, half: Vector) -> Hit:
    """First hit from outside, or the wall hit from inside; the normal faces the ray."""
    near, far = -math.inf, math.inf
    axis_near = axis_far = 0
    for axis in range(3):
        if d[axis] == 0.0:
            if abs(p[axis]) > half[axis]:
                return _MISS
        else:
            t0, t1 = (-half[axis] - p[axis]) / d[axis], (half[axis] - p[axis]) / d[axis]
            if t0 > t1:
                t0, t1 = t1, t0
            if t0 > near:
                near, axis_near = t0, axis
            if t1 < far:
                far, axis_far = t1, axis
    if near > far or far <= 0.0:
        return _MISS
    t, axis = (near, axis_near) if near > 0.0 else (far, axis_far)
    m = -math.copysign(1.0, d[axis])
    return t, m if axis == 0 else 0.0, m if axis == 1 else 0.0, m if axis == 2 else 0.0


@njit(cache=True, nogil=True)
def _roots(a: float, half_b: float, c: float) -> tuple[float, float]:
    """Return the ordered roots of a t^2 + 2 half_b t + c, without cancellation; infinite if none."""
    square = half_b * half_b - a * c
    if square < 0.0 or a == 0.0:
        return math.inf, math.inf
    q = -(half_b + math.copysign(math.sqrt(square), half_b))
    t0 = q / a
    t1 = c / q if q != 0.0 else t0
    return (t0, t1) if t0 < t1 else (t1, t0)


@njit(cache=True, nogil=True)
def _sphere(p: Vector, d: Vector, r: float) -> Hit:
    x, y, z = p
    t0, t1 = _roots(1.0, x * d[0] + y * d[1] + z * d[2], x * x + y * y + z * z - r * r)
    t = t0 if t0 > 0.0 else t1
    if not 0.0 < t < math.inf:
        return _MISS
    side = 1.0 if t0 > 0.0 else -1.0
    return t, side * (x + t * d[0]) / r, side * (y + t * d[1]) / r, side * (z + t * d[2]) / r


@njit(cache=True, nogil=True)
def _cylinder(p: Vector, d: Vector, r: float, h: float) -> Hit:
    best = _MISS
    t0, t1 = _roots(d[0] * d[0] + d[1] * d[1], p[0] * d[0] + p[1] * d[1], p[0] * p[0] + p[1] * p[1] - r * r)
    for t in (t0, t1):
        if 0.0 < t < best[0] and abs(p[2] + t * d[2]) <= h:
            x, y = p[0] + t * d[0], p[1] + t * d[1]
            side = 1.0 if x * d[0] + y * d[1] < 0.0 else -1.0
            best = t, side * x / r, side * y / r, 0.0
    if d[2] != 0.0:
        for cap in (-h, h):
            t = (cap - p[2]) / d[2]
            x, y = p[0] + t * d[0], p[1] + t * d[1]
            if 0.0 < t < best[0] and x * x + y * y <= r * r:
                best = t, 0.0, 0.0, -math.copysign(1.0, d[2])
    return best


@njit(cache=True, nogil=True)
def _cull(origins: Floats, directions: Floats, solids: Floats, kept: Ints) -> int:
    """Put into ``kept`` the solids whose bounding spheres a bundle of rays may hit; return their number."""
    # The bundle lies in the cone about its mean direction, widened by how far its origins are apart. Rays
    # with NaN compare as false, so that no solid is left out for them.
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
    origins: Floats, directions: Floats, solids: Floats, distance: Floats, index: Ints, normal: Floats
) -> None:
    """Fill distance, index (row of ``solids``, -1 for none) and outward normal of each ray's first hit."""
    kept = np.empty(solids.shape[0], dtype=np.int64)
    for start in range(0, origins.shape[0], _BUNDLE):
        stop = min(start + _BUNDLE, origins.shape[0])
        number = _cull(origins[start:stop], directions[start:stop], solids, kept)
        for i in range(start, stop):
            distance[i], index[i] = _first(origins[i], directions[i], solids, kept[:number], normal[i])


@njit(cache=True, nogil=True)
def _first(o: Floats, d: Floats, solids: Floats, kept: Ints, normal: Floats) -> tuple[float, int]:
    """Return distance and row of one ray's first hit among the solids kept; fill its normal."""
    best, which = math.inf, -1
    n0 = n1 = n2 = 0.0
    for s in kept:
        row = solids[s]
        v = (o[0] - row[2], o[1] - row[3], o[2] - row[4])
        # Skipped unless the ray enters the solid's bounding sphere before the nearest hit so far.
        toward = -(d[0] * v[0] + d[1] * v[1] + d[2] * v[2])
        beside = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - toward * toward
        if toward < -row[17] or toward - row[17] > best or beside > row[17] * row[17]:
            continue
        p, e = _local(row, v), _local(row, (d[0], d[1], d[2]))
        hit = _MISS
        kind = int(row[0])
        if kind == RECTANGLE:
            if e[2] != 0.0:
                t = -p[2] / e[2]
                if t > 0.0 and abs(p[0] + t * e[0]) <= row[14] and abs(p[1] + t * e[1]) <= row[15]:
                    hit = t, 0.0, 0.0, -math.copysign(1.0, e[2])
        elif kind == BOX:
            hit = _box(p, e, (row[14], row[15], row[16]))
        elif kind == SPHERE:
            hit = _sphere(p, e, row[14])
        else:
            hit = _cylinder(p, e, row[14], row[16])
        if hit[0] < best:
            best, which = hit[0], s
            n0 = row[5] * hit[1] + row[8] * hit[2] + row[11] * hit[3]
            n1 = row[6] * hit[1] + row[9] * hit[2] + row[12] * hit[3]
            n2 = row[7] * hit[1] + row[10] * hit[2] + row[13] * hit[3]
    normal[0], normal[1], normal[2] = n0, n1, n2
    return best, which


@njit(cache=True, nogil=True)
def _local(row: Floats, v: Vector) -> Vector:
    """Return a vector in the frame of a solid."""
    x, y, z = v
    return (
        row[5] * x + row[6] * y + row[7] * z,
        row[8] * x + row[9] * y + row[10] * z,
        row[11] * x + row[12] * y + row[13] * z,
    )
