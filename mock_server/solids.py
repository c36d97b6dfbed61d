"""Solids as rows of numbers, which ``COLUMNS`` names: their extent, points and moves, and the tracing kernel.

The kernel tests each ray, in float64, against the solids whose boxes it meets, found in a tree of boxes. It
runs without the GIL and without numba's thread pool, which two Python threads must not enter: callers
distribute rays over threads. Functions that take arrays for each ray are inlined: counting references would
take as long as testing a few solids.
"""

import itertools
import math
from typing import Any

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

Tree = tuple[Floats, Ints, Ints]
"""Boxes of the nodes (M, 6), least and greatest corner; links (M, 4): the second child (the first is the next
node) and the axis that divides them, and, of a leaf, where its solids begin in the order, and how many (else
0); the order of the solids (N,)."""

_LEAF = 2  # solids of a leaf
_VISIT = 1.0  # cost of visiting a node, in tests of a solid
_SLACK = 1e-9  # of boxes, against rounding; part of their size and coordinates

_THINNEST = 1e-9  # the least factor: a solid of size 0 cannot be traced
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_ANGLES = np.linspace(0, 2 * np.pi, 64, endpoint=False)
_TILTS = np.linspace(-np.pi / 2, np.pi / 2, 9)


def _circle(radius: float, z: float) -> list[tuple[float, float, float]]:
    """Return points of a circle about the z axis."""
    return [(radius * np.cos(angle), radius * np.sin(angle), z) for angle in _ANGLES]


_RIMS = np.array([*_circle(1.0, -1.0), *_circle(1.0, 1.0)])
_GLOBE = np.concatenate([_circle(np.cos(tilt), np.sin(tilt)) for tilt in _TILTS])
_MESHES = {RECTANGLE: _CORNERS, BOX: _CORNERS, CYLINDER: _RIMS, SPHERE: _GLOBE}
"""By kind, (N, 3) points of a solid whose half sizes are 1."""


@njit(nogil=True)
def _rectangle(p: Vector, d: Vector, half_x: float, half_y: float) -> Hit:
    if d[2] == 0.0:
        return _MISS
    t = -p[2] / d[2]
    if t > 0.0 and abs(p[0] + t * d[0]) <= half_x and abs(p[1] + t * d[1]) <= half_y:
        return t, 0.0, 0.0, -math.copysign(1.0, d[2])
    return _MISS


@njit(nogil=True)
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


@njit(nogil=True)
def _roots(a: float, half_b: float, c: float) -> tuple[float, float]:
    """Return the ordered roots of a t^2 + 2 half_b t + c, without cancellation; infinite if none."""
    square = half_b * half_b - a * c
    if square < 0.0 or a == 0.0:
        return math.inf, math.inf
    q = -(half_b + math.copysign(math.sqrt(square), half_b))
    t0 = q / a
    t1 = c / q if q != 0.0 else t0
    return (t0, t1) if t0 < t1 else (t1, t0)


@njit(nogil=True)
def _sphere(p: Vector, d: Vector, r: float) -> Hit:
    x, y, z = p
    t0, t1 = _roots(1.0, x * d[0] + y * d[1] + z * d[2], x * x + y * y + z * z - r * r)
    t = t0 if t0 > 0.0 else t1
    if not 0.0 < t < math.inf:
        return _MISS
    side = 1.0 if t0 > 0.0 else -1.0
    return t, side * (x + t * d[0]) / r, side * (y + t * d[1]) / r, side * (z + t * d[2]) / r


@njit(nogil=True)
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


def tree(rows: Floats) -> Tree:
    """Return the tree of boxes around solids that :func:`nearest_hits` descends.

    In NumPy: a kernel that sorts takes longer to compile than this does for thousands of solids.
    """
    low, high = extents(rows, np.eye(3))
    slack = _SLACK * np.maximum(np.abs(low), np.abs(high)).max(axis=1, initial=0.0)[:, None]
    low = low - slack
    high = high + slack
    boxes: list[Floats] = []
    links: list[list[int]] = []
    order: list[int] = []
    parts = [(np.arange(len(rows)), -1)] if len(rows) else []
    while parts:
        part, parent = parts.pop()
        if parent >= 0:
            links[parent][0] = len(boxes)
        ranked, cut, axis = _divided(part, low[part], high[part])
        if cut:
            parts += [(ranked[cut:], len(boxes)), (ranked[:cut], -1)]
        links.append([0, axis, len(order), 0 if cut else len(part)])
        boxes.append(np.concatenate([low[part].min(axis=0), high[part].max(axis=0)]))
        if not cut:
            order += part.tolist()
    return np.array(boxes).reshape(-1, 6), np.array(links, np.int64).reshape(-1, 4), np.array(order, np.int64)


def _divided(part: Ints, low: Floats, high: Floats) -> tuple[Ints, int, int]:
    """Return the solids of a node in their order along an axis, how many the first child has, and the axis.

    It has 0 in a leaf. The surface area heuristic (MacDonald and Booth, 1990) decides.
    """
    axis = int(np.ptp(low + high, axis=0).argmax())
    ranks = np.argsort(low[:, axis] + high[:, axis], kind="stable")
    low = low[ranks]
    high = high[ranks]
    count = np.arange(1, len(part))
    first = np.maximum.accumulate(high) - np.minimum.accumulate(low)
    last = (np.maximum.accumulate(high[::-1]) - np.minimum.accumulate(low[::-1]))[::-1]
    cost = _half_areas(first[:-1]) * count + _half_areas(last[1:]) * count[::-1]
    if len(part) <= _LEAF or not cost.min() < (len(part) - _VISIT) * _half_areas(first[-1:])[0]:
        return part, 0, 0
    return part[ranks], int(count[cost.argmin()]), axis


def _half_areas(sizes: Floats) -> Floats:
    """Return (N,) half the surface areas of boxes of sizes (N, 3)."""
    return np.asarray((sizes * np.roll(sizes, 1, axis=1)).sum(axis=1))


@njit(
    "float64[:, ::1], out float64[:, ::1], float64[:, ::1], (float64[:, ::1], int64[:, ::1], "
    "int64[::1]), bool[::1], out float64[::1], out int64[::1], out float64[:, ::1]",
    nogil=True,
    error_model="numpy",
)
def nearest_hits(
    origins: Floats,
    directions: Floats,
    solids: Floats,
    tree: Tree,
    shown: NDArray[np.bool_],
    distance: Floats,
    index: Ints,
    normal: Floats,
) -> None:
    """Fill distance, index (row of ``solids``, -1 for none) and outward normal of each ray's first hit.

    ``directions`` of any length become unit vectors. Only solids that are ``shown`` are hit; of hits at one
    distance, the solid of the least index counts.
    """
    # Arrays are read by element below: a view of a row takes longer than testing a solid.
    boxes, links, order = tree
    stack = np.empty(len(boxes) + 1, dtype=np.int64)
    for i in range(origins.shape[0]):
        o = (origins[i, 0], origins[i, 1], origins[i, 2])
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        length = math.sqrt(x * x + y * y + z * z)
        d = (x / length, y / length, z / length)  # NaN for a vector of zeros
        directions[i, 0], directions[i, 1], directions[i, 2] = d
        distance[i], index[i], n = _first(o, d, solids, boxes, links, order, shown, stack)
        normal[i, 0], normal[i, 1], normal[i, 2] = n


@njit(nogil=True, inline="always", error_model="numpy")
def _first(
    o: Vector, d: Vector, solids: Floats, boxes: Floats, links: Ints, order: Ints, shown: Any, stack: Ints
) -> tuple[float, int, Vector]:
    """Return distance, row and normal of one ray's first hit: nodes on its side come first."""
    best, which, normal = math.inf, -1, (0.0, 0.0, 0.0)
    inverse = (1.0 / d[0], 1.0 / d[1], 1.0 / d[2])
    x, y, z = inverse[0] < 0.0, inverse[1] < 0.0, inverse[2] < 0.0
    sides = (
        (0, 3 if x else 0, 0 if x else 3),
        (1, 4 if y else 1, 1 if y else 4),
        (2, 5 if z else 2, 2 if z else 5),
    )  # columns of each axis, the entered side first
    stack[0], size = 0, min(1, boxes.shape[0])
    while size:
        size -= 1
        node = stack[size]
        # Comparisons with NaN, of 0 times infinity, are false, so that no box is skipped.
        near, far = 0.0, best
        for k, low, high in sides:
            t0, t1 = (boxes[node, low] - o[k]) * inverse[k], (boxes[node, high] - o[k]) * inverse[k]
            near = t0 if t0 > near else near
            far = t1 if t1 < far else far
        if near > far:
            continue
        if not links[node, 3]:
            backward = d[links[node, 1]] < 0.0
            stack[size] = node + 1 if backward else links[node, 0]
            stack[size + 1] = links[node, 0] if backward else node + 1
            size += 2
            continue
        for j in range(links[node, 2], links[node, 2] + links[node, 3]):
            s = order[j]
            v = (o[0] - solids[s, 2], o[1] - solids[s, 3], o[2] - solids[s, 4])
            # Skip it unless the ray enters its bounding sphere before the nearest hit so far.
            toward, radius = -(d[0] * v[0] + d[1] * v[1] + d[2] * v[2]), solids[s, 17]
            beside = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - toward * toward
            if not shown[s] or toward < -radius or toward - radius > best or beside > radius * radius:
                continue
            hit = _hit(solids, s, _local(solids, s, v), _local(solids, s, d))
            if hit[0] < best or (hit[0] == best and s < which):
                best, which, normal = hit[0], s, _world(solids, s, (hit[1], hit[2], hit[3]))
    return best, which, normal


@njit(nogil=True, inline="always")
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


@njit(nogil=True, inline="always")
def _local(solids: Floats, s: int, v: Vector) -> Vector:
    """Return a vector in the frame of a solid."""
    x, y, z = v
    return (
        solids[s, 5] * x + solids[s, 6] * y + solids[s, 7] * z,
        solids[s, 8] * x + solids[s, 9] * y + solids[s, 10] * z,
        solids[s, 11] * x + solids[s, 12] * y + solids[s, 13] * z,
    )


@njit(nogil=True, inline="always")
def _world(solids: Floats, s: int, v: Vector) -> Vector:
    """Return a vector of the frame of a solid in the world's."""
    x, y, z = v
    return (
        solids[s, 5] * x + solids[s, 8] * y + solids[s, 11] * z,
        solids[s, 6] * x + solids[s, 9] * y + solids[s, 12] * z,
        solids[s, 7] * x + solids[s, 10] * y + solids[s, 13] * z,
    )


def extents(rows: Floats, frame: Floats) -> tuple[Floats, Floats]:
    """Return the least and the greatest coordinates (N, 3) of each solid along the rows of ``frame``."""
    kind = rows[:, 0]
    axes = rows[:, 5:14].reshape(-1, 3, 3) @ frame.T
    half = rows[:, 14:17]
    reach = np.abs(axes * half[:, :, None]).sum(axis=1)
    disc = half[:, :1] * np.hypot(axes[:, 0], axes[:, 1]) + np.abs(axes[:, 2]) * half[:, 2:]
    reach[kind == CYLINDER] = disc[kind == CYLINDER]
    reach[kind == SPHERE] = half[kind == SPHERE, :1]
    centers = rows[:, 2:5] @ frame.T
    return centers - reach, centers + reach


def extent(rows: Floats, frame: Floats) -> tuple[Floats, Floats]:
    """Return the least and the greatest coordinates of solids along the rows of ``frame``."""
    low, high = extents(rows, frame)
    return low.min(axis=0), high.max(axis=0)


def center(rows: Floats) -> Floats:
    """Return the centre (3,) of the box around solids."""
    low, high = extent(rows, np.eye(3))
    return np.asarray((low + high) / 2)


def points(rows: Floats) -> Floats:
    """Return (N, 3) mesh points: corners of boxes and rectangles, 64 on each rim of a cylinder or circle of a
    sphere."""
    meshes = []
    for row in rows:
        kind = int(row[0])
        half = row[14:17].copy()
        if kind == SPHERE:
            half[1:] = half[0]
        elif kind == CYLINDER:
            half[1] = half[0]
        meshes.append(row[2:5] + (_MESHES[kind] * half) @ row[5:14].reshape(3, 3))
    return np.concatenate(meshes)


def moved(rows: Floats, R: Floats, pivot: Floats, target: Floats) -> Floats:
    """Return solids rotated about a point, which moves.

    Args:
        rows: (N, COLUMNS) solids.
        R: (3, 3) rotation.
        pivot: (3,) the point, metres.
        target: (3,) where the point is then, metres.
    """
    result = rows.copy()
    result[:, 2:5] = (rows[:, 2:5] - pivot) @ R.T + target
    result[:, 5:14] = (rows[:, 5:14].reshape(-1, 3, 3) @ R.T).reshape(-1, 9)
    return result


def scaled(rows: Floats, factors: Floats, pivot: Floats) -> Floats:
    """Return the solids ``rows`` scaled by three ``factors`` along the world's axes about a ``pivot`` (3,).

    Boxes and rectangles take the factors of the nearest axes. Round solids stay round, by the least factor
    across their axis, as an engine scales collision shapes.
    """
    result = rows.copy()
    sizes = np.maximum(np.abs(factors), _THINNEST)
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
