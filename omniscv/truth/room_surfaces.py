"""The surfaces of a room that rays hit, exactly, and which points of its edges an image shows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import shown
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.job.recipe import Tolerance

Flags = NDArray[np.bool_]

_WALL_ROUNDING = 1e-12  # of a wall's length: rays through the corner of two walls must hit one of them
_ROUNDING = 1e-9  # of a distance
_OFF_GRID = 1e-6  # a weight that decides only where none of the nearer pixels is in the image


class RoomHits(NamedTuple):
    """The first surfaces of a room that rays hit.

    Attributes:
        distance: (...) metres along the unit direction; +inf where nothing is hit.
        surface: (...) int16, i for wall i, N for the floor, N + 1 for the ceiling, -1 for nothing.
    """

    distance: Array
    surface: NDArray[np.int16]


def first_hits(room: Room, origins_w: ArrayLike, directions_w: ArrayLike) -> RoomHits:
    """Return the first surfaces of a room that rays hit, from within it or from outside.

    Args:
        room: of N walls; both sides of a surface stop rays.
        origins_w: (..., 3) metres, world frame; broadcast against the directions.
        directions_w: (..., 3) unit vectors; a ray with NaN in it hits nothing.
    """
    o, d = np.broadcast_arrays(np.asarray(origins_w, np.float64), np.asarray(directions_w, np.float64))
    distance = np.full(o.shape[:-1], np.inf)
    surface = np.full(o.shape[:-1], -1, np.int16)
    with np.errstate(all="ignore"):
        for i, (start, end) in enumerate(_walls(room)):
            t = _wall_distance(room, start, end, o, d)
            nearer = t < distance
            distance, surface = np.where(nearer, t, distance), np.where(nearer, np.int16(i), surface)
        count = len(room.corners_w)
        for i, z in ((count, room.floor_z), (count + 1, room.ceiling_z)):
            t = (z - o[..., 2]) / d[..., 2]
            nearer = (t > 0) & (t < distance)
            nearer[nearer] = inside(room, o[nearer, :2] + t[nearer, None] * d[nearer, :2])
            distance, surface = np.where(nearer, t, distance), np.where(nearer, np.int16(i), surface)
    return RoomHits(distance, surface)


def inside(room: Room, points_w: ArrayLike) -> NDArray[np.bool_]:
    """Return which points (..., 2) of the ground plan, metres, world frame, lie within the walls."""
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
    """(...) metres to the wall between two corners (2,); +inf for rays that miss it."""
    along = end - start
    x, y = start[0] - o[..., 0], start[1] - o[..., 1]
    turn = d[..., 0] * along[1] - d[..., 1] * along[0]
    t = (x * along[1] - y * along[0]) / turn
    s = (x * d[..., 1] - y * d[..., 0]) / turn
    z = o[..., 2] + t * d[..., 2]
    slack = _WALL_ROUNDING * (1 + abs(room.floor_z) + abs(room.ceiling_z))
    upright = (z >= room.floor_z - slack) & (z <= room.ceiling_z + slack)
    hit = (t > 0) & (s >= -_WALL_ROUNDING) & (s <= 1 + _WALL_ROUNDING) & upright
    return np.where(hit, t, np.inf)


def seen_in_room(room: Room, pose: Pose, points_c: Array, origins_c: Array) -> Flags:
    """Return (S,) whether no wall of a room hides points on its edges.

    Args:
        room: with the edges.
        pose: of the camera.
        points_c: (S, 3) metres, camera frame.
        origins_c: (S, 3) metres, camera frame, the origins of the rays to the points.
    """
    offset = points_c - origins_c
    distance = np.linalg.norm(offset, axis=-1)
    hits = first_hits(room, pose.to_world(origins_c), (offset / distance[:, None]) @ pose.R_w_c.T)
    return np.asarray(hits.distance >= distance * (1 - _ROUNDING) - _ROUNDING)


def seen_in_depth(
    room: Room, camera: Camera, pose: Pose, pixels: Array, depth: ArrayLike, tolerance: Tolerance
) -> Flags:
    """Return (S,) whether an image shows the room's surfaces, not something nearer, at some pixels.

    Each pixel around a point is compared along its own ray: its depth is that of the room's surface there, or
    of something else. The weighted majority of the 3 x 3 pixels decides. So silhouettes are exact to a
    fraction of a pixel, and surfaces at grazing angles do not hide themselves.

    Args:
        room: whose surfaces are expected.
        camera, pose: of the image.
        pixels: (S, 2) px.
        depth: (H, W) metres along each pixel's ray; 0 outside the field of view.
        tolerance: between depths that are taken for equal.

    Raises:
        ArgumentError: a depth of another size than the image.
    """
    image = np.asarray(depth)
    if image.shape != (camera.height, camera.width):
        size = f"({camera.height}, {camera.width})"
        raise ArgumentError(f"depth: expected the image's shape {size}, got {shown(image.shape)}")
    column, row = _neighbours(pixels, camera)
    weight = _weights(pixels, column, row)
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


def _neighbours(pixels: Array, camera: Camera) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(S, 9) columns and rows of the 3 x 3 pixels around points; border pixels are repeated."""
    shift = np.arange(9)
    column = np.floor(pixels[:, :1]).astype(np.intp) + shift % 3 - 1
    row = np.floor(pixels[:, 1:]).astype(np.intp) + shift // 3 - 1
    return np.clip(column, 0, camera.width - 1), np.clip(row, 0, camera.height - 1)


def _weights(pixels: Array, column: NDArray[np.intp], row: NDArray[np.intp]) -> Array:
    """(S, 9) of the 3 x 3 pixels: a quadratic B-spline, and a little more for points outside the grid."""
    across, down = np.abs(pixels[:, :1] - column - 0.5), np.abs(pixels[:, 1:] - row - 0.5)
    return _spline(across) * _spline(down) + _OFF_GRID


def _spline(x: Array) -> Array:
    return np.where(x <= 0.5, 0.75 - x**2, 0.5 * np.maximum(1.5 - x, 0) ** 2)
