"""Solids as rows of numbers, which ``COLUMNS`` names: their extent, points and moves, and the tracing kernel.

The kernel tests every ray against every solid, in float64. It runs without the GIL and without numba's
thread pool, which two Python threads must not enter: callers distribute rays over threads. Functions that
take arrays for each ray are inlined: counting references would take as long as testing a few solids.
"""

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from mock_server.compiled import njit

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
"""Rays that are culled together: neighbours in an image miss the same solids."""

_SLACK_RAD = 1e-6
"""More than the rounding of an arc cosine near 1, which is 1.5e-8."""

_THINNEST = 1e-9  # the least factor: a solid of size 0 cannot be traced
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_CIRCLE = [(np.cos(t), np.sin(t)) for t in np.linspace(0, 2 * np.pi, 64, endpoint=False)]
_RIMS = np.array([(x, y, z) for z in (-1.0, 1.0) for x, y in _CIRCLE])
_GLOBE = np.array(
    [
        (np.cos(t) * x, np.cos(t) * y, np.sin(t))
        for t in np.linspace(-np.pi / 2, np.pi / 2, 9)
        for x, y in _CIRCLE
    ]
)
_MESHES = {RECTANGLE: _CORNERS, BOX: _CORNERS, CYLINDER: _RIMS, SPHERE: _GLOBE}


@njit(cache=True, nogil=True)
def _rectangle(p: Vector, d: Vector, half_x: float, half_y: float) -> Hit:
    if d[2] == 0.0:
        return _MISS
    t = -p[2] / d[2]
    if t > 0.0 and abs(p[0] + t * d[0]) <= half_x and abs(p[1] + t * d[1]) <= half_y:
        return t, 0.0, 0.0, -math.copysign(1.0, d[2])
    return _MISS


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
def nearest_hits(
    origins: Floats, directions: Floats, solids: Floats, distance: Floats, index: Ints, normal: Floats
) -> None:
    """Fill distance, index (row of ``solids``, -1 for none) and outward normal of each ray's first hit.

    ``directions`` of any length become unit vectors.
    """
    # Arrays are read by element below: a view of a row takes longer than testing a solid.
    near = np.empty(solids.shape[0], dtype=np.int64)
    for start in range(0, origins.shape[0], _BUNDLE):
        stop = min(start + _BUNDLE, origins.shape[0])
        _normalise(directions, start, stop)
        number = _cull(origins, directions, start, stop, solids, near)
        for i in range(start, stop):
            o = (origins[i, 0], origins[i, 1], origins[i, 2])
            d = (directions[i, 0], directions[i, 1], directions[i, 2])
            distance[i], index[i], n = _first(o, d, solids, near, number)
            normal[i, 0], normal[i, 1], normal[i, 2] = n


@njit(cache=True, nogil=True, error_model="numpy")
def _normalise(directions: Floats, start: int, stop: int) -> None:
    """Make vectors unit vectors; NaN where they are zero."""
    for i in range(start, stop):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        length = math.sqrt(x * x + y * y + z * z)
        directions[i, 0], directions[i, 1], directions[i, 2] = x / length, y / length, z / length


@njit(cache=True, nogil=True)
def _cull(origins: Floats, directions: Floats, start: int, stop: int, solids: Floats, near: Ints) -> int:
    """Put into ``near`` the solids whose bounding spheres a bundle may hit, and return their number."""
    # The bundle lies in a cone about its mean direction, widened by the spread of its origins. Comparisons
    # with NaN, of a ray or of a mean of length 0, are false, so that no solid is skipped.
    count = stop - start
    o0 = o1 = o2 = a0 = a1 = a2 = 0.0
    for i in range(start, stop):
        o0, o1, o2 = o0 + origins[i, 0], o1 + origins[i, 1], o2 + origins[i, 2]
        a0, a1, a2 = a0 + directions[i, 0], a1 + directions[i, 1], a2 + directions[i, 2]
    o0, o1, o2 = o0 / count, o1 / count, o2 / count
    length = math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    if length == 0.0:
        length = math.nan
    a0, a1, a2 = a0 / length, a1 / length, a2 / length
    least, spread = 1.0, 0.0
    for i in range(start, stop):
        cosine = a0 * directions[i, 0] + a1 * directions[i, 1] + a2 * directions[i, 2]
        x, y, z = origins[i, 0] - o0, origins[i, 1] - o1, origins[i, 2] - o2
        least = least if least <= cosine else cosine
        spread = max(spread, math.sqrt(x * x + y * y + z * z))
    half_angle = math.acos(max(-1.0, least)) + _SLACK_RAD
    number = 0
    for s in range(solids.shape[0]):
        x, y, z = solids[s, 2] - o0, solids[s, 3] - o1, solids[s, 4] - o2
        distance, radius = math.sqrt(x * x + y * y + z * z), solids[s, 17] + spread
        if distance > radius:
            cosine = (a0 * x + a1 * y + a2 * z) / distance
            if math.acos(min(1.0, max(-1.0, cosine))) > half_angle + math.asin(radius / distance):
                continue
        near[number] = s
        number += 1
    return number


@njit(cache=True, nogil=True, inline="always")
def _first(o: Vector, d: Vector, solids: Floats, near: Ints, number: int) -> tuple[float, int, Vector]:
    """Return distance, row and normal of one ray's first hit among the first ``number`` solids near."""
    best, which, normal = math.inf, -1, (0.0, 0.0, 0.0)
    for k in range(number):
        s = near[k]
        v = (o[0] - solids[s, 2], o[1] - solids[s, 3], o[2] - solids[s, 4])
        # Skip it unless the ray enters its bounding sphere before the nearest hit so far.
        toward, radius = -(d[0] * v[0] + d[1] * v[1] + d[2] * v[2]), solids[s, 17]
        beside = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - toward * toward
        if toward < -radius or toward - radius > best or beside > radius * radius:
            continue
        hit = _hit(solids, s, _local(solids, s, v), _local(solids, s, d))
        if hit[0] < best:
            best, which, normal = hit[0], s, _world(solids, s, (hit[1], hit[2], hit[3]))
    return best, which, normal


@njit(cache=True, nogil=True, inline="always")
def _hit(solids: Floats, s: int, p: Vector, d: Vector) -> Hit:
    """First hit of a ray in the frame of a solid."""
    kind = int(solids[s, 0])
    hit: Hit = _MISS
    if kind == RECTANGLE:
        hit = _rectangle(p, d, solids[s, 14], solids[s, 15])
    elif kind == BOX:
        hit = _box(p, d, (solids[s, 14], solids[s, 15], solids[s, 16]))
    elif kind == SPHERE:
        hit = _sphere(p, d, solids[s, 14])
    else:
        hit = _cylinder(p, d, solids[s, 14], solids[s, 16])
    return hit


@njit(cache=True, nogil=True, inline="always")
def _local(solids: Floats, s: int, v: Vector) -> Vector:
    """Return a vector in the frame of a solid."""
    x, y, z = v
    return (
        solids[s, 5] * x + solids[s, 6] * y + solids[s, 7] * z,
        solids[s, 8] * x + solids[s, 9] * y + solids[s, 10] * z,
        solids[s, 11] * x + solids[s, 12] * y + solids[s, 13] * z,
    )


@njit(cache=True, nogil=True, inline="always")
def _world(solids: Floats, s: int, v: Vector) -> Vector:
    """Return a vector of the frame of a solid in the world's."""
    x, y, z = v
    return (
        solids[s, 5] * x + solids[s, 8] * y + solids[s, 11] * z,
        solids[s, 6] * x + solids[s, 9] * y + solids[s, 12] * z,
        solids[s, 7] * x + solids[s, 10] * y + solids[s, 13] * z,
    )


def extent(rows: Floats, frame: Floats) -> tuple[Floats, Floats]:
    """Return the least and the greatest coordinates of solids along the rows of ``frame``."""
    kind, axes, half = rows[:, 0], rows[:, 5:14].reshape(-1, 3, 3) @ frame.T, rows[:, 14:17]
    reach = np.abs(axes * half[:, :, None]).sum(axis=1)
    disc = half[:, :1] * np.hypot(axes[:, 0], axes[:, 1]) + np.abs(axes[:, 2]) * half[:, 2:]
    reach[kind == CYLINDER] = disc[kind == CYLINDER]
    reach[kind == SPHERE] = half[kind == SPHERE, :1]
    centers = rows[:, 2:5] @ frame.T
    return (centers - reach).min(axis=0), (centers + reach).max(axis=0)


def center(rows: Floats) -> Floats:
    """Return the centre (3,) of the box around solids."""
    low, high = extent(rows, np.eye(3))
    return np.asarray((low + high) / 2)


def points(rows: Floats) -> Floats:
    """Return (N, 3) mesh points: corners of boxes and rectangles, 64 on each rim of a cylinder or circle of a
    sphere."""
    meshes = []
    for row in rows:
        unit, (a, b, c) = _MESHES[int(row[0])], row[14:17]
        half = {SPHERE: (a, a, a), CYLINDER: (a, a, c)}.get(int(row[0]), (a, b, c))
        meshes.append(row[2:5] + (unit * half) @ row[5:14].reshape(3, 3))
    return np.concatenate(meshes)


def moved(rows: Floats, R: Floats, pivot: Floats, target: Floats) -> Floats:
    """Return solids rotated about a point that moves to ``target``."""
    result = rows.copy()
    result[:, 2:5] = (rows[:, 2:5] - pivot) @ R.T + target
    result[:, 5:14] = (rows[:, 5:14].reshape(-1, 3, 3) @ R.T).reshape(-1, 9)
    return result


def scaled(rows: Floats, factors: Floats, pivot: Floats) -> Floats:
    """Return solids scaled along the world's axes about a fixed point.

    Boxes and rectangles take the factors of the nearest axes. Round solids stay round, by the least factor
    across their axis, as an engine scales collision shapes.
    """
    result, sizes = rows.copy(), np.maximum(np.abs(factors), _THINNEST)
    result[:, 2:5] = (rows[:, 2:5] - pivot) * factors + pivot
    for row in result:
        along = sizes[np.abs(row[5:14].reshape(3, 3)).argmax(axis=1)]
        if row[0] == SPHERE:
            along[:] = sizes.min()
        elif row[0] == CYLINDER:
            along[:2] = along[:2].min()
        row[14:17] *= along
        row[17] *= along.max()
    return result
