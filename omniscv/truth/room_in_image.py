"""A room in an image, of cameras with one optical centre or many: its edges as curves, the surfaces that rays
hit, and which points of the edges are seen."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import shown
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.render_options import Tolerance

Flags = NDArray[np.bool_]

SPACING_PX = 0.5
"""Largest distance between neighbouring samples of a curve."""
RESOLVED_M = 5e-7
"""Largest distance between a sample and the ray of its pixel."""
_AIM_PX = 0.42  # spacing that is aimed at: below the limit, so that most curves need one iteration
_COARSE_PX = 8  # spacing of the first samples at the image's middle; a shorter piece may be missed
_COARSE = np.radians([0.01, 1.0])  # limits of that spacing
_FINEST = 1e-9  # rad: precision of a curve's ends
_MOST_PARTS = 16  # into which an interval is divided at once
_PARALLEL = 1e-9  # rad between the rays of neighbouring pixels
_DECIMALS = 8  # of pixels in px, as files have them
_THINNEST_PX = 0.04  # spacing to which the dense samples near a curve's ends are thinned
_LEAST_DISTANCE = 1e-2  # of an edge's length: an edge through the camera has no steps of equal angle
_WALL_ROUNDING = 1e-12  # of a wall's length: rays through the corner of two walls must hit one of them
_ROUNDING = 1e-9  # of a distance
_OFF_GRID = 1e-6  # a weight that decides only where none of the nearer pixels is in the image


@dataclass(frozen=True, eq=False)
class Samples:
    """Points of edges that a camera sees, edge by edge, along each.

    Attributes:
        edge: (S,) which edge.
        points_c: (S, 3) metres, camera frame.
        pixels: (S, 2) px, rounded as files have them.
        origins_c: (S, 3) metres, camera frame, of the pixels' rays.
        joined: (S,) bool, whether the next sample continues the curve: it lies within ``SPACING_PX``.
    """

    edge: NDArray[np.intp]
    points_c: Array
    pixels: Array
    origins_c: Array
    joined: NDArray[np.bool_]


def sample_edges(camera: Camera, starts_c: Array, ends_c: Array) -> Samples:
    """Return samples of straight edges, at most ``SPACING_PX`` apart in the image.

    Curves are interrupted where the edge leaves the field of view, and where samples stay apart in the image
    however near they are on the edge, as at the seam of a panorama.

    Args:
        camera: of the image.
        starts_c: (E, 3) metres, camera frame.
        ends_c: (E, 3) metres, camera frame.
    """
    edges = _Edges(starts_c, ends_c)
    edge, angle = edges.coarse(float(np.clip(_COARSE_PX * radians_per_pixel(camera), *_COARSE)))
    pixels, valid = camera.project(edges.points(edge, angle))
    while True:
        parts = _parts(edge, angle, pixels, valid)
        wide = np.flatnonzero(parts > 1)
        if not wide.size:
            break
        more_edge, more_angle = _between(edge, angle, wide, parts[wide])
        more_pixels, more_valid = camera.project(edges.points(more_edge, more_angle))
        edge = np.concatenate([edge, more_edge])
        angle = np.concatenate([angle, more_angle])
        pixels = np.concatenate([pixels, more_pixels])
        valid = np.concatenate([valid, more_valid])
        order = np.lexsort((angle, edge))
        edge = edge[order]
        angle = angle[order]
        pixels = pixels[order]
        valid = valid[order]
    return _samples(camera, edge, edges.points(edge, angle), pixels)


def resolved(camera: Camera, points_c: Array, pixels: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return pixels as files have them, the origins of their rays, and whether these pass their points.

    A ray passes a point if it is within ``RESOLVED_M``. At the tip of a conical mirror it does not.

    Args:
        camera: of the image.
        points_c: (S, 3) metres, camera frame.
        pixels: (S, 2) px, at which the camera projects the points.

    Returns:
        (S, 2) px, rounded; (S, 3) metres, camera frame; (S,) bool.
    """
    rounded = np.round(pixels, _DECIMALS)
    rays = camera.unproject(rounded)
    with np.errstate(invalid="ignore"):
        off = np.linalg.norm(np.cross(points_c - rays.origins, rays.directions), axis=-1)
    return rounded, rays.origins, np.asarray(off <= RESOLVED_M)


def _samples(camera: Camera, edge: NDArray[np.intp], points_c: Array, pixels: Array) -> Samples:
    """The visible samples, thinned near the ends of curves."""
    pixels, origins_c, seen = resolved(camera, points_c, pixels)
    gaps = _gaps(pixels)
    near = seen[1:] & seen[:-1] & (edge[1:] == edge[:-1]) & (gaps <= SPACING_PX)
    joined = np.append(near, False)
    continued = np.append(False, near)
    step = np.floor(np.cumsum(np.append(0.0, np.where(near, gaps, 0.0))) / _THINNEST_PX)
    keep = seen & (~joined | ~continued | (np.diff(step, prepend=-1) > 0))
    return Samples(edge[keep], points_c[keep], pixels[keep], origins_c[keep], joined[keep])


class _Edges:
    """Edges in steps of equal angle, as the camera's origin sees them."""

    def __init__(self, starts_c: Array, ends_c: Array) -> None:
        self._start = starts_c
        along = ends_c - starts_c
        self._length = np.linalg.norm(along, axis=-1)
        self._direction = along / self._length[:, None]
        self._nearest = -(starts_c * self._direction).sum(axis=-1)
        away = np.linalg.norm(starts_c + self._nearest[:, None] * self._direction, axis=-1)
        self._away = np.maximum(away, _LEAST_DISTANCE * self._length)

    def coarse(self, step: float) -> tuple[NDArray[np.intp], Array]:
        """Edge and angle of the first samples: both ends, and steps of at most ``step`` radians."""
        first = np.arctan2(-self._nearest, self._away)
        last = np.arctan2(self._length - self._nearest, self._away)
        counts = np.ceil((last - first) / step).astype(int) + 1
        angles = list(map(np.linspace, first, last, counts))
        return np.repeat(np.arange(len(counts)), counts), np.concatenate(angles)

    def points(self, edge: NDArray[np.intp], angle: Array) -> Array:
        """Return (S, 3) metres, camera frame, the points at an ``angle``, radians, of an ``edge``."""
        along = np.clip(self._nearest[edge] + self._away[edge] * np.tan(angle), 0, self._length[edge])
        return np.asarray(self._start[edge] + along[:, None] * self._direction[edge])


def radians_per_pixel(camera: Camera) -> float:
    """Return the angle between neighbouring pixels right of the image's middle; of a panorama, 2 pi / width.

    The middle itself is left out: at the tip of a conical mirror there is no ray, and rays beside it are
    opposite. A camera with parallel rays gets a panorama's 2 pi / width.
    """
    center = camera.center if camera.valid(camera.center) else [camera.width / 2, camera.height / 2]
    steps = np.column_stack([np.arange(camera.width // 2 + 1) + 0.5, np.zeros(camera.width // 2 + 1)])
    rays = camera.unproject(np.asarray(center) + steps)
    first = int(np.argmax(rays.valid[1:] & rays.valid[:-1]))
    a, b = rays.directions[first : first + 2]
    turn = float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
    return turn if turn > _PARALLEL else 2 * np.pi / camera.width


def _gaps(pixels: Array) -> Array:
    """(S - 1,) px between neighbours; NaN where a sample has no pixel."""
    return np.asarray(np.linalg.norm(np.diff(pixels, axis=0), axis=-1))


def _parts(edge: NDArray[np.intp], angle: Array, pixels: Array, valid: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(S - 1,) the number of parts to divide the intervals between neighbours into; 1 where they are fine."""
    gaps = _gaps(pixels)
    both = valid[1:] & valid[:-1]
    parts = np.where(both, np.clip(np.ceil(gaps / _AIM_PX), 2, _MOST_PARTS), _MOST_PARTS)
    fine = np.where(both, gaps <= SPACING_PX - _THINNEST_PX, valid[1:] == valid[:-1])
    fine |= (edge[1:] != edge[:-1]) | (np.diff(angle) <= _FINEST)
    parts[fine] = 1
    return parts.astype(np.intp)


def _between(
    edge: NDArray[np.intp], angle: Array, wide: NDArray[np.intp], parts: NDArray[np.intp]
) -> tuple[NDArray[np.intp], Array]:
    """Edge and angle of new samples that divide intervals ``wide`` into equal parts."""
    count = parts - 1
    step = np.arange(1, count.sum() + 1) - np.repeat(np.cumsum(count) - count, count)
    interval = np.repeat(wide, count)
    share = step / np.repeat(parts, count)
    return edge[interval], angle[interval] + share * (angle[interval + 1] - angle[interval])


# -- surfaces ---------------------------------------------------------------------------------------------


class RoomHits(NamedTuple):
    """The first surfaces of a room that rays hit.

    Attributes:
        distance: (...) metres along the unit direction; +inf where nothing is hit.
        surface: (...) int16, i for wall i, N for the floor, N + 1 for the ceiling, -1 for nothing.
    """

    distance: Array
    surface: NDArray[np.int16]


def first_hits(room: Room, origins_w: ArrayLike, directions_w: ArrayLike) -> RoomHits:
    """Return the first surfaces of a ``room`` that rays hit, from either side.

    Rays start at ``origins_w`` (..., 3), metres, along ``directions_w`` (..., 3), unit, world frame. A ray
    with NaN in it hits nothing.
    """
    o, d = np.broadcast_arrays(np.asarray(origins_w, np.float64), np.asarray(directions_w, np.float64))
    distance = np.full(o.shape[:-1], np.inf)
    surface = np.full(o.shape[:-1], -1, np.int16)
    with np.errstate(all="ignore"):
        for number, (start, end) in enumerate(_walls(room)):
            t = _wall_distance(room, start, end, o, d)
            nearer = t < distance
            distance = np.where(nearer, t, distance)
            surface = np.where(nearer, np.int16(number), surface)
        count = len(room.corners_w)
        for number, z in ((count, room.floor_z), (count + 1, room.ceiling_z)):
            t = (z - o[..., 2]) / d[..., 2]
            nearer = (t > 0) & (t < distance)
            nearer[nearer] = inside(room, o[nearer, :2] + t[nearer, None] * d[nearer, :2])
            distance = np.where(nearer, t, distance)
            surface = np.where(nearer, np.int16(number), surface)
    return RoomHits(distance, surface)


def inside(room: Room, points_w: ArrayLike) -> NDArray[np.bool_]:
    """Return which points ``points_w`` (..., 2) of the ground plan lie within the walls of a ``room``.

    They are in metres, world frame.
    """
    x, y = np.moveaxis(np.asarray(points_w, np.float64), -1, 0)
    crossed = np.zeros(x.shape, np.bool_)
    for (x0, y0), (x1, y1) in _walls(room):
        if y0 != y1:
            beside = (y0 > y) != (y1 > y)
            crossed ^= beside & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return crossed


def _walls(room: Room) -> list[tuple[Array, Array]]:
    return list(zip(room.corners_w, np.roll(room.corners_w, -1, axis=0), strict=True))


def _wall_distance(room: Room, start: Array, end: Array, o: Array, d: Array) -> Array:
    """Return (...) metres to the wall between two corners (2,); +inf for rays that miss it.

    Rays start at o (..., 3) along d (..., 3), world frame.
    """
    along = end - start
    x = start[0] - o[..., 0]
    y = start[1] - o[..., 1]
    turn = d[..., 0] * along[1] - d[..., 1] * along[0]
    t = (x * along[1] - y * along[0]) / turn
    s = (x * d[..., 1] - y * d[..., 0]) / turn
    z = o[..., 2] + t * d[..., 2]
    slack = _WALL_ROUNDING * (1 + abs(room.floor_z) + abs(room.ceiling_z))
    upright = (z >= room.floor_z - slack) & (z <= room.ceiling_z + slack)
    hit = (t > 0) & (s >= -_WALL_ROUNDING) & (s <= 1 + _WALL_ROUNDING) & upright
    return np.where(hit, t, np.inf)


def seen_in_room(room: Room, pose: Pose, points_c: Array, origins_c: Array) -> Flags:
    """Return (S,) whether no wall of a room hides points on its edges from the origins of their rays.

    Args:
        room: with these edges.
        pose: of the camera, world frame.
        points_c: (S, 3) metres, camera frame.
        origins_c: (S, 3) metres, camera frame.
    """
    offset = points_c - origins_c
    distance = np.linalg.norm(offset, axis=-1)
    hits = first_hits(room, pose.to_world(origins_c), (offset / distance[:, None]) @ pose.R_w_c.T)
    return np.asarray(hits.distance >= distance * (1 - _ROUNDING) - _ROUNDING)


def seen_in_depth(
    room: Room, camera: Camera, pose: Pose, pixels: Array, depth: ArrayLike, tolerance: Tolerance
) -> Flags:
    """Return (S,) whether an image with depth (H, W) shows the room's surfaces, not something nearer, at
    pixels.

    Each pixel around a point is compared along its own ray: its depth is that of the room's surface there, or
    of something else. The weighted majority of the 3 x 3 pixels decides. So silhouettes are exact to a
    fraction of a pixel, and surfaces at grazing angles do not hide themselves.

    Args:
        room: that the image shows.
        camera: of the image.
        pose: of the camera, world frame.
        pixels: (S, 2) px of points on the room's edges.
        depth: (H, W) metres along the rays.
        tolerance: between depths that are taken for equal.

    Raises:
        ArgumentError: a depth of another size than the image.
    """
    image = np.asarray(depth)
    if image.shape != (camera.height, camera.width):
        size = f"({camera.height}, {camera.width})"
        raise ArgumentError(f"depth: expected the image's shape {size}, got {shown(image.shape)}")
    shift = np.arange(9)  # the 3 x 3 pixels around points; border pixels are repeated
    column = np.clip(np.floor(pixels[:, :1]).astype(np.intp) + shift % 3 - 1, 0, camera.width - 1)
    row = np.clip(np.floor(pixels[:, 1:]).astype(np.intp) + shift // 3 - 1, 0, camera.height - 1)
    across = np.abs(pixels[:, :1] - column - 0.5)
    down = np.abs(pixels[:, 1:] - row - 0.5)
    weight = _spline(across) * _spline(down) + _OFF_GRID
    flat, inverse = np.unique(row * camera.width + column, return_inverse=True)
    centers = np.column_stack([flat % camera.width, flat // camera.width]) + 0.5
    rays = camera.unproject(centers)
    hits = first_hits(room, pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T)
    measured = image.reshape(-1)[flat].astype(np.float64)
    with np.errstate(invalid="ignore"):
        allowed = np.maximum(tolerance.abs_m, tolerance.rel * hits.distance)
        is_room = np.abs(measured - hits.distance) <= allowed
    weight *= (rays.valid & (measured > 0))[inverse].reshape(weight.shape)
    share = (weight * is_room[inverse].reshape(weight.shape)).sum(axis=1)
    return np.asarray((2 * share >= weight.sum(axis=1)) & (share > 0))


def _spline(x: Array) -> Array:
    """Return a quadratic B-spline of distances in px."""
    return np.where(x <= 0.5, 0.75 - x**2, 0.5 * np.maximum(1.5 - x, 0) ** 2)
