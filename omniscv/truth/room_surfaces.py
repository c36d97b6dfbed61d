"""What rays meet in an empty room: walls, floor and ceiling, exactly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room

_ROUNDING = 1e-12  # of a wall's length: rays through the corner of two walls must hit one of them


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
    slack = _ROUNDING * (1 + abs(room.floor_z) + abs(room.ceiling_z))
    upright = (z >= room.floor_z - slack) & (z <= room.ceiling_z + slack)
    hit = (t > 0) & (s >= -_ROUNDING) & (s <= 1 + _ROUNDING) & upright
    return np.where(hit, t, np.inf)
