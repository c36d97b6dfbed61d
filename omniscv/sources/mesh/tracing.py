"""Rays through triangles, exact in float64.

Embree names the first triangle that a ray may meet. It works in float32, so each of its triangles is larger
than ours by more than its rounding: it never misses one that lies first. The named triangle is then
intersected in float64. Rays that pass beside it, or through a face that is not seen from there, look for
their first hit in a tree of boxes, in float64 alone.
"""

from collections.abc import Sequence
from functools import cached_property
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import fields, njit
from omniscv.errors import SourceError
from omniscv.geometry import Array

Ints32 = NDArray[np.int32]

_LEAF = 4  # triangles in a leaf of the tree
_INSIDE = 1e-10
"""A point is on a triangle if no weight of its vertices is less than minus this: rays along shared edges meet
one of both triangles, whatever float64 rounds."""
_ROUNDING = 8 * 2.0**-24
"""Of float32, as a part of the largest coordinate: of vertices, origins and directions, with a margin."""
_SHARPEST = 0.02  # sine of the sharpest corner whose tip is moved as far as its edges need
_LEAST_M = 1e-300  # of an edge: at coordinates of a map, a small triangle's corners may round to one
_FAR = 4.0
"""Origins that are farther from the middle, in half sizes of the mesh, are moved along their rays first."""
_BLOCK = 1 << 16  # rays that Embree gets at once, so that arrays stay small


@fields("float64[:, ::1], int32[:, ::1], bool[::1], float64[:, ::1]")
class Triangles(NamedTuple):
    """Triangles around the origin, in the order of the tree's leaves.

    Attributes:
        vertices: (N, 3) metres.
        faces: (M, 3).
        one_sided: (M,) whether rays pass them from behind.
        boxes: (2 L - 1, 6) of the tree's nodes, least and greatest corner: the children of node i are
            2 i + 1 and 2 i + 2, and the last L are leaves of four triangles each.
    """

    vertices: Array
    faces: Ints32
    one_sided: NDArray[np.bool_]
    boxes: Array


class Hits(NamedTuple):
    """What rays meet first.

    Attributes:
        distance: (N,) metres, +inf for nothing.
        face: (N,) int32 of the faces that the tracer was made of; -1 for nothing.
        weights: (N, 2) of the face's second and third vertex.
    """

    distance: Array
    face: Ints32
    weights: Array


class Tracer:
    """Triangles that rays can be traced through.

    Args:
        vertices: (N, 3) metres, world frame.
        faces: (M, 3) int32; at least one.
        one_sided: (M,) whether rays pass a face from behind.
    """

    def __init__(self, vertices: Array, faces: Ints32, one_sided: NDArray[np.bool_]) -> None:
        used = vertices[faces.ravel()]
        low = used.min(axis=0)
        high = used.max(axis=0)
        self._middle = (low + high) / 2
        self._half_m = float(np.linalg.norm(high - low)) / 2
        centred = np.ascontiguousarray(vertices - self._middle)
        self._order = _spatial_order(centred, faces)
        ordered = np.ascontiguousarray(faces[self._order])
        boxes = _tree(centred, ordered)
        self._triangles = Triangles(centred, ordered, one_sided[self._order], boxes)
        self._embree = _embree_scene(_enlarged(centred, ordered, self._half_m))

    def trace(self, origins_w: Array, directions_w: Array) -> Hits:
        """Return what rays meet first.

        Args:
            origins_w: (N, 3) metres, world frame; or (3,), of all rays.
            directions_w: (N, 3) unit vectors, world frame.
        """
        directions = np.ascontiguousarray(directions_w, np.float64)
        origins = np.ascontiguousarray(np.broadcast_to(origins_w - self._middle, directions.shape))
        count = len(directions)
        place = np.empty(count, np.int32)
        for first in range(0, count, _BLOCK):
            block = slice(first, first + _BLOCK)
            place[block] = self._nearest(origins[block], directions[block])
        distance = np.empty(count)
        weights = np.empty((count, 2))
        open_rays = np.empty(count, np.bool_)
        _verify(self._triangles, origins, directions, place, distance, weights, open_rays)
        rows = np.flatnonzero(open_rays)
        if len(rows):
            hits = self._search(origins[rows], directions[rows])
            distance[rows] = hits.distance
            place[rows] = hits.face
            weights[rows] = hits.weights
        return Hits(distance, self._faces_of(place), weights)

    def following(self, origins_w: Array, directions_w: Array, distance: Array, place: Ints32) -> Hits:
        """Return what rays meet behind a distance, or at it and of a place above one; see :meth:`places`.

        Args:
            origins_w, directions_w: as of :meth:`trace`.
            distance: (N,) metres.
            place: (N,) int32; -1 includes all that lies at the distance, the number of faces none of it.
        """
        directions = np.ascontiguousarray(directions_w, np.float64)
        origins = np.ascontiguousarray(np.broadcast_to(origins_w - self._middle, directions.shape))
        found = self._search(origins, directions, distance, place)
        return found._replace(face=self._faces_of(found.face))

    def _search(
        self, origins: Array, directions: Array, after: Array | None = None, behind: Ints32 | None = None
    ) -> Hits:
        """Return the first hits in the tree, behind a distance, or at it and of a greater number."""
        count = len(directions)
        distance = np.zeros(count) if after is None else after.copy()
        place = np.full(count, -1, np.int32) if behind is None else behind.copy()
        weights = np.zeros((count, 2))
        _search_tree(self._triangles, origins, directions, distance, place, weights)
        return Hits(distance, place, weights)

    def _nearest(self, origins: Array, directions: Array) -> Ints32:
        """Return the triangle that each ray may meet first, -1 for none."""
        starts = origins
        away = np.abs(origins).max(axis=1) > _FAR * self._half_m
        if away.any():
            ahead = np.maximum(-(origins * directions).sum(axis=1) - 2 * self._half_m, 0)
            starts = origins + np.where(away, ahead, 0)[:, None] * directions
        named = self._embree.run(starts.astype(np.float32), directions.astype(np.float32))
        return np.asarray(named, np.int32)

    def _faces_of(self, place: Ints32) -> Ints32:
        return np.where(place < 0, np.int32(-1), self._order.take(place, mode="clip")).astype(np.int32)

    @cached_property
    def places(self) -> Ints32:
        """(M,) the place of each face among faces at one distance."""
        places = np.empty(len(self._order), np.int32)
        places[self._order] = np.arange(len(self._order), dtype=np.int32)
        return places


class JoinedTracers:
    """Several tracers as one: rays meet the nearest of what each meets, of equal distances the first one's.

    Args:
        tracers: at least one.
        numbers: the numbers of each one's faces among all faces.
        count: of all faces.
    """

    def __init__(self, tracers: Sequence[Tracer], numbers: Sequence[Ints32], count: int) -> None:
        self._tracers = tracers
        self._numbers = numbers
        self._owner = np.zeros(count, np.int32)
        self._place = np.zeros(count, np.int32)
        for i, (tracer, own) in enumerate(zip(tracers, numbers, strict=True)):
            self._owner[own] = i
            self._place[own] = tracer.places

    def trace(self, origins_w: Array, directions_w: Array) -> Hits:
        """As :meth:`Tracer.trace`; ``face`` counts all faces."""
        return self._nearest([tracer.trace(origins_w, directions_w) for tracer in self._tracers])

    def beyond(self, origins_w: Array, directions_w: Array, hits: Hits) -> Hits:
        """Return what the same rays meet next, behind what they met: what lies at the same distance, too."""
        owner = self._owner[hits.face]
        found = []
        for i, tracer in enumerate(self._tracers):
            place = np.where(owner < i, np.int32(-1), np.int32(len(self._numbers[i])))
            place = np.where(owner == i, self._place[hits.face], place)
            found.append(tracer.following(origins_w, directions_w, hits.distance, place.astype(np.int32)))
        return self._nearest(found)

    def _nearest(self, found: Sequence[Hits]) -> Hits:
        """Return the nearest of what the tracers met."""
        nearest = self._numbered(0, found[0])
        for i in range(1, len(found)):
            other = self._numbered(i, found[i])
            closer = other.distance < nearest.distance
            nearest.distance[closer] = other.distance[closer]
            nearest.face[closer] = other.face[closer]
            nearest.weights[closer] = other.weights[closer]
        return nearest

    def _numbered(self, i: int, hits: Hits) -> Hits:
        """Return hits of one tracer with the numbers of all faces."""
        face = np.where(hits.face < 0, np.int32(-1), self._numbers[i].take(hits.face, mode="clip"))
        return hits._replace(face=face.astype(np.int32))


def require_embree() -> None:
    """Raise SourceError where embreex is not installed."""
    if find_spec("embreex") is None:
        platforms = "which there is for Linux on x86-64, for Windows and for macOS on ARM"
        raise SourceError(f"expected embreex, {platforms}; install omniscv[mesh]")


def _embree_scene(corners: NDArray[np.float32]) -> Any:
    """Return a scene of Embree of triangles (M, 3, 3)."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, corners)
    return scene


def _enlarged(vertices: Array, faces: Ints32, half_m: float) -> NDArray[np.float32]:
    """Return (M, 3, 3) triangles whose edges lie outside of ours by the rounding of float32.

    A corner moves by ``margin (a + b) / sin``, where a and b are the unit vectors to it from both other
    corners: so both its edges move by the margin.
    """
    corners = vertices[faces]
    margin = _ROUNDING * half_m
    moved = np.empty(corners.shape, np.float32)
    for k in range(3):
        own = corners[:, k]
        a = own - corners[:, (k + 1) % 3]
        b = own - corners[:, (k + 2) % 3]
        a /= np.maximum(np.linalg.norm(a, axis=1, keepdims=True), _LEAST_M)
        b /= np.maximum(np.linalg.norm(b, axis=1, keepdims=True), _LEAST_M)
        cosine = (a * b).sum(axis=1)
        sine = np.sqrt(np.maximum(1 - cosine**2, _SHARPEST**2))
        moved[:, k] = own + (margin / sine)[:, None] * (a + b)
    return moved


def _spatial_order(vertices: Array, faces: Ints32) -> NDArray[np.int64]:
    """Return the triangles in the order of a Z curve through their middles (Morton 1966)."""
    middles = vertices[faces].mean(axis=1)
    low = middles.min(axis=0)
    size = float((middles.max(axis=0) - low).max()) or 1.0
    cells = ((middles - low) / size * (2**21 - 1)).astype(np.uint64)
    code = np.zeros(len(faces), np.uint64)
    for axis in range(3):
        code |= _spread(cells[:, axis]) << np.uint64(axis)
    return np.argsort(code, kind="stable")


def _spread(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return whole numbers of 21 bits with two zeros between each two bits."""
    x = values
    for shift, mask in (
        (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249),
    ):  # fmt: skip
        x = (x | x << np.uint64(shift)) & np.uint64(mask)
    return x


def _tree(vertices: Array, faces: Ints32) -> Array:
    """Return the boxes of a complete binary tree over triangles in their order (:class:`Triangles`)."""
    leaves = 1
    while leaves * _LEAF < len(faces):
        leaves *= 2
    low = np.full((leaves * _LEAF, 3), np.inf)
    high = np.full((leaves * _LEAF, 3), -np.inf)
    corners = vertices[faces]
    low[: len(faces)] = corners.min(axis=1)
    high[: len(faces)] = corners.max(axis=1)
    low = low.reshape(leaves, _LEAF, 3).min(axis=1)
    high = high.reshape(leaves, _LEAF, 3).max(axis=1)
    levels = [np.concatenate([low, high], axis=1)]
    while len(low) > 1:
        low = low.reshape(-1, 2, 3).min(axis=1)
        high = high.reshape(-1, 2, 3).max(axis=1)
        levels.append(np.concatenate([low, high], axis=1))
    return np.ascontiguousarray(np.concatenate(levels[::-1]))


@njit(nogil=True, error_model="numpy")
def _meet(triangles: Any, k: int, origins: Any, directions: Any, i: int) -> Any:
    """Return the distance at which ray i meets triangle k, and the weights of its second and third corner.

    Moeller and Trumbore 1997. The distance is negative where it does not meet it, or meets a face that is
    not seen from behind.
    """
    a = triangles.faces[k, 0]
    b = triangles.faces[k, 1]
    c = triangles.faces[k, 2]
    v = triangles.vertices
    ux = v[b, 0] - v[a, 0]
    uy = v[b, 1] - v[a, 1]
    uz = v[b, 2] - v[a, 2]
    wx = v[c, 0] - v[a, 0]
    wy = v[c, 1] - v[a, 1]
    wz = v[c, 2] - v[a, 2]
    dx = directions[i, 0]
    dy = directions[i, 1]
    dz = directions[i, 2]
    px = dy * wz - dz * wy
    py = dz * wx - dx * wz
    pz = dx * wy - dy * wx
    determinant = ux * px + uy * py + uz * pz
    if determinant == 0 or (determinant < 0 and triangles.one_sided[k]):
        return -1.0, 0.0, 0.0
    sx = origins[i, 0] - v[a, 0]
    sy = origins[i, 1] - v[a, 1]
    sz = origins[i, 2] - v[a, 2]
    second = (sx * px + sy * py + sz * pz) / determinant
    qx = sy * uz - sz * uy
    qy = sz * ux - sx * uz
    qz = sx * uy - sy * ux
    third = (dx * qx + dy * qy + dz * qz) / determinant
    if not (second >= -_INSIDE and third >= -_INSIDE and second + third <= 1 + _INSIDE):
        return -1.0, 0.0, 0.0
    distance = (wx * qx + wy * qy + wz * qz) / determinant
    return distance, second, third


@njit(
    "Triangles, float64[:, ::1], float64[:, ::1], int32[::1], out float64[::1], out float64[:, ::1], "
    "out bool[::1]",
    nogil=True,
    error_model="numpy",
)
def _verify(
    triangles: Any, origins: Any, directions: Any, place: Any, distance: Any, weights: Any, open_rays: Any
) -> None:
    """Intersect each ray with its named triangle; leave ``open_rays`` where it does not meet that one."""
    for i in range(place.shape[0]):
        distance[i] = np.inf
        weights[i, 0] = 0.0
        weights[i, 1] = 0.0
        open_rays[i] = False
        if place[i] < 0:
            continue
        t, second, third = _meet(triangles, place[i], origins, directions, i)
        if t > 0:
            distance[i] = t
            weights[i, 0] = second
            weights[i, 1] = third
        else:
            open_rays[i] = True


@njit(nogil=True, error_model="numpy")
def _entry(boxes: Any, node: int, origins: Any, directions: Any, i: int, least: float, most: float) -> float:
    """Return the distance at which ray i enters a node's box between two distances, +inf if it does not."""
    near = least
    far = most
    for axis in range(3):
        o = origins[i, axis]
        d = directions[i, axis]
        low = boxes[node, axis]
        high = boxes[node, 3 + axis]
        if low > high:  # a leaf without triangles
            return np.inf
        slack = 1e-12 * (abs(o) + abs(low) + abs(high))
        low -= slack
        high += slack
        if d == 0:
            if o < low or o > high:
                return np.inf
            continue
        t0 = (low - o) / d
        t1 = (high - o) / d
        if t0 > t1:
            t0, t1 = t1, t0
        near = max(near, t0)
        far = min(far, t1)
    return near if near <= far * (1 + 1e-12) else np.inf


@njit(
    "Triangles, float64[:, ::1], float64[:, ::1], out float64[::1], out int32[::1], out float64[:, ::1]",
    nogil=True,
    error_model="numpy",
)
def _search_tree(  # noqa: PLR0915 - a kernel
    triangles: Any, origins: Any, directions: Any, distance: Any, place: Any, weights: Any
) -> None:
    """Write the first hit of each ray behind ``distance``, or at it and of a number above ``place``.

    Of equal distances, the smaller number is first.
    """
    first_leaf = triangles.boxes.shape[0] // 2
    count = triangles.faces.shape[0]
    boxes = triangles.boxes
    nodes = np.zeros(64, np.int64)
    entries = np.zeros(64)
    for i in range(directions.shape[0]):
        after = distance[i]
        behind = place[i]
        best = np.inf
        best_place = -1
        best_second = 0.0
        best_third = 0.0
        nodes[0] = 0
        entries[0] = _entry(boxes, 0, origins, directions, i, after, best)
        depth = 1
        while depth > 0:
            depth -= 1
            node = nodes[depth]
            if entries[depth] == np.inf or entries[depth] > best * (1 + 1e-12):
                continue
            if node < first_leaf:
                left = _entry(boxes, 2 * node + 1, origins, directions, i, after, best)
                right = _entry(boxes, 2 * node + 2, origins, directions, i, after, best)
                first = 2 * node + 1 if left <= right else 2 * node + 2
                nodes[depth] = 4 * node + 3 - first  # the other child, which is visited later
                nodes[depth + 1] = first
                entries[depth] = max(left, right)
                entries[depth + 1] = min(left, right)
                depth += 2
                continue
            start = _LEAF * (node - first_leaf)
            for k in range(start, min(start + _LEAF, count)):
                t, second, third = _meet(triangles, k, origins, directions, i)
                if not t > 0 or t < after or (t == after and k <= behind):
                    continue
                if t < best or (t == best and k < best_place):
                    best = t
                    best_place = k
                    best_second = second
                    best_third = third
        distance[i] = best
        place[i] = best_place
        weights[i, 0] = best_second
        weights[i, 1] = best_third
