"""How a camera sees the layout of a room.

A record of a layout, as :func:`project_layout` makes it and ``STEM.layout.json`` holds it: ``version``,
``source``, ``residual_m``, ``floor``, ``ceiling`` and ``camera_height`` in metres, then

``corners``  ``id``, ``kind`` (floor, ceiling), ``world`` and ``camera`` in metres, ``pixel`` (null outside
             the image), ``in_image``, ``visible_room``, ``visible``. Of N walls, corner i of the floor has
             the id i, counterclockwise from above, and the ceiling's above it N + i
``edges``    ``id``, ``kind`` (floor, ceiling, vertical), ``corners`` (two ids), ``planes`` (two names), and
             ``pieces`` of the curve: ``pixels`` at most 0.5 px apart, ``visible_room``, ``visible``

``visible_room`` is false behind a wall of the room, ``visible`` also behind all else, and null where no depth
is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import numbers, shown
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.truth.layout_curves import Samples, resolved, sample_edges
from omniscv.truth.layout_visibility import Flags, Tolerance, seen_in_depth, seen_in_room
from omniscv.truth.room_layout import RoomLayout

VERSION = 1

_SAME_M = 1e-6  # heights and plans of corners that differ by less are one


def project_layout(
    room: RoomLayout | Room,
    camera: Camera,
    pose: Pose,
    depth: ArrayLike | None = None,
    depth_room: ArrayLike | None = None,
    tolerance: Tolerance | None = None,
) -> dict[str, Any]:
    """Return the record of a room's layout in an image.

    Args:
        room: as :func:`omniscv.truth.layout` returns it.
        camera, pose: of the image, central or not.
        depth: (H, W) metres along each pixel's ray from its own origin, for ``visible``.
        depth_room: the same of the room without furniture, for ``visible_room``; the room's own walls
            decide if not given.
        tolerance: how far a surface may be off the room's and still be taken for it.

    Returns:
        Plain JSON values; see the module.

    Raises:
        ArgumentError: a depth of another size than the image, or a room that is none.
    """
    known = RoomLayout(room) if isinstance(room, Room) else room
    view = _View(known.room, camera, pose, depth, depth_room, tolerance or Tolerance())
    ends, kinds, planes = _edges(known.room)
    corners_c = pose.to_camera(_corners(known.room))
    curves = sample_edges(camera, corners_c[ends[:, 0]], corners_c[ends[:, 1]])
    pieces = _pieces(curves, *view.flags(curves.points_c, curves.pixels, curves.origins_c))
    return {
        "version": VERSION,
        "source": known.source,
        "residual_m": float(known.residual_m),
        "floor": float(known.room.floor_z),
        "ceiling": float(known.room.ceiling_z),
        "camera_height": float(pose.position[2] - known.room.floor_z),
        "corners": _corner_records(view),
        "edges": [
            {"id": i, "kind": kind, "corners": pair, "planes": names, "pieces": pieces.get(i, [])}
            for i, (kind, pair, names) in enumerate(zip(kinds, ends.tolist(), planes, strict=True))
        ],
    }


def room_of(record: Mapping[str, Any]) -> Room:
    """Return the room that a record describes.

    Raises:
        ArgumentError: it is no record of a layout, or the room is no prism: the floor's corners, or the
            ceiling's, differ in height, or one is not above the other.
    """
    try:
        if record["version"] != VERSION:
            raise ArgumentError(f"layout: expected version {VERSION}, got {shown(record['version'])}")
        corners_w = numbers("corners", [corner["world"] for corner in record["corners"]], (None, 3))
        walls = [edge["planes"] for edge in record["edges"] if edge["kind"] != "vertical"]
        count = len(corners_w) // 2
        floor, ceiling = corners_w[:count], corners_w[count:]
        walls = [tuple(walls[i]) for i in range(2 * count)]
    except (KeyError, TypeError, IndexError) as cause:
        raise ArgumentError(f"layout: expected a record of a layout, got {shown(record)}") from cause
    uneven = max(np.ptp(floor[:, 2]), np.ptp(ceiling[:, 2]), np.abs(floor[:, :2] - ceiling[:, :2]).max())
    if uneven > _SAME_M:
        wanted = "a room of upright walls between a level floor and a level ceiling"
        raise ArgumentError(f"layout: expected {wanted}, got corners that are {uneven:.3g} m off that")
    names = tuple(wall for wall, _ in walls[:count])
    heights = float(floor[0, 2]), float(ceiling[0, 2])
    return Room(floor[:, :2], *heights, names, walls[0][1], walls[count][1])


@dataclass(frozen=True, eq=False)
class _View:
    """A room, what sees it, and what of it an image shows."""

    room: Room
    camera: Camera
    pose: Pose
    depth: ArrayLike | None
    depth_room: ArrayLike | None
    tolerance: Tolerance

    def flags(self, points_c: Array, pixels: Array, origins_c: Array) -> tuple[Flags, Flags | None]:
        """(S,) ``visible_room`` and ``visible`` of points on the room's edges."""
        if self.depth_room is None:
            in_room = seen_in_room(self.room, self.pose, points_c, origins_c)
        else:
            in_room = self._in_depth(pixels, self.depth_room)
        return in_room, None if self.depth is None else in_room & self._in_depth(pixels, self.depth)

    def _in_depth(self, pixels: Array, depth: ArrayLike) -> Flags:
        return seen_in_depth(self.room, self.camera, self.pose, pixels, depth, self.tolerance)


def _corner_records(view: _View) -> list[dict[str, Any]]:
    corners_w = _corners(view.room)
    corners_c = view.pose.to_camera(corners_w)
    pixels, origins_c, seen = resolved(view.camera, corners_c, view.camera.project(corners_c)[0])
    in_room, in_full = view.flags(corners_c[seen], pixels[seen], origins_c[seen])
    flags = zip(in_room.tolist(), in_room.tolist() if in_full is None else in_full.tolist(), strict=True)
    count, found = len(corners_w) // 2, []
    for i, in_image in enumerate(seen.tolist()):
        visible_room, visible = next(flags) if in_image else (False, False)
        found.append(
            {
                "id": i,
                "kind": "floor" if i < count else "ceiling",
                "world": corners_w[i].tolist(),
                "camera": corners_c[i].tolist(),
                "pixel": pixels[i].tolist() if in_image else None,
                "in_image": in_image,
                "visible_room": visible_room,
                "visible": None if in_full is None else visible,
            }
        )
    return found


def _corners(room: Room) -> Array:
    """(2N, 3) metres, world frame, the floor's before the ceiling's."""
    heights = np.repeat([room.floor_z, room.ceiling_z], len(room.corners_w))
    return np.column_stack([np.tile(room.corners_w, (2, 1)), heights])


def _edges(room: Room) -> tuple[NDArray[np.intp], list[str], list[list[str]]]:
    """(3N, 2) corners at the ends of edges, their kinds, and the names of the planes that meet there."""
    count = len(room.corners_w)
    here = np.arange(count)
    ring = np.column_stack([here, np.roll(here, -1)])
    ends = np.concatenate([ring, ring + count, np.column_stack([here, here + count])])
    kinds = ["floor"] * count + ["ceiling"] * count + ["vertical"] * count
    walls = room.walls
    planes = [[wall, level] for level in (room.floor, room.ceiling) for wall in walls]
    return ends, kinds, planes + [[walls[i - 1], walls[i]] for i in range(count)]


def _pieces(curves: Samples, in_room: Flags, in_full: Flags | None) -> dict[int, list[dict[str, Any]]]:
    """By edge, its curve cut where it breaks off and where a flag changes."""
    full = in_room if in_full is None else in_full
    cut = ~curves.joined[:-1] | (in_room[1:] != in_room[:-1]) | (full[1:] != full[:-1])
    bounds = [0, *(np.flatnonzero(cut) + 1).tolist(), len(curves.edge)]
    pixels, found = curves.pixels.tolist(), dict[int, list[dict[str, Any]]]()
    for start, end in pairwise(bounds):
        if start < end:
            piece = {
                "pixels": pixels[start:end],
                "visible_room": bool(in_room[start]),
                "visible": None if in_full is None else bool(in_full[start]),
            }
            found.setdefault(int(curves.edge[start]), []).append(piece)
    return found
