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
def nearest_hits(
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    solids: NDArray[np.float64],
    distance: NDArray[np.float64],
    index: NDArray[np.int64],
    normal: NDArray[np.float64],
) -> None:
    """Fills distance, index (row of ``solids``, -1 for none) and outward normal of each ray's first hit."""
    for i in range(origins.shape[0]):
        best, which = math.inf, -1
        n0 = n1 = n2 = 0.0
        for s in range(solids.shape[0]):
            row = solids[s]
            x, y, z = origins[i, 0] - row[2], origins[i, 1] - row[3], origins[i, 2] - row[4]
            a, b, c = directions[i, 0], directions[i, 1], directions[i, 2]
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
        distance[i], index[i] = best, which
        normal[i, 0], normal[i, 1], normal[i, 2] = n0, n1, n2
