"""The layout of a room: where it comes from, and how a camera sees it.

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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import number, numbers, shown
from omniscv.cameras import Camera
from omniscv.compose.image import OmniImage
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room, SceneGeometry
from omniscv.truth.classes import ClassTable
from omniscv.truth.layout_curves import resolved, sample_edges
from omniscv.truth.layout_visibility import Tolerance, seen_in_depth, seen_in_room
from omniscv.truth.room_fit import Pictured, fit_room

VERSION = 1

_SAME_M = 1e-6  # heights and plans of corners that differ by less are one


@dataclass(frozen=True, eq=False)
class RoomLayout:
    """A room, and how well it is known.

    Attributes:
        room: the walls, the floor, the ceiling.
        source: as the scene has it, or fitted to what images show.
        residual_m: rms distance of the points that it was fitted to, metres; 0 of a scene.

    Raises:
        ArgumentError: no ring of corners counterclockwise, or a ceiling not above the floor.
    """

    room: Room
    source: Literal["scene", "fitted"] = "scene"
    residual_m: float = 0.0

    def __post_init__(self) -> None:
        corners = numbers("room.corners_w", self.room.corners_w, (None, 2))
        steps = np.roll(corners, -1, axis=0) - corners
        area = float((corners[:, 0] * steps[:, 1] - corners[:, 1] * steps[:, 0]).sum()) / 2
        if len(corners) < 3 or not np.abs(steps).max(axis=1).all() or area <= 0:
            wanted = "at least 3 corners that differ, counterclockwise from above"
            raise ArgumentError(f"room: expected {wanted}; got {shown(corners)}")
        if len(self.room.walls) != len(corners):
            raise ArgumentError(f"room.walls: expected {len(corners)} names, got {len(self.room.walls)}")
        number("room.ceiling_z", self.room.ceiling_z, above=number("room.floor_z", self.room.floor_z))


def layout(
    scene_or_frames: SceneGeometry | Sequence[Pictured | OmniImage], classes: ClassTable | None = None
) -> RoomLayout:
    """Return the layout of a room, as a scene has it or fitted to images.

    Args:
        scene_or_frames: what a source knows of its shapes; or images, or frames of a dataset, of one room,
            with depth, normals and labels, which together show every wall.
        classes: which objects are ``wall``, ``floor`` or ``ceiling``; those named ``Layout*`` if not given.

    Raises:
        ArgumentError: a scene without a room, or images that a room of upright walls between level planes
            fits worse than 2 cm; see :func:`omniscv.truth.room_fit.fit_room`.
    """
    if not isinstance(scene_or_frames, SceneGeometry):
        room, residual_m = fit_room(scene_or_frames, classes)
        return RoomLayout(room, "fitted", residual_m)
    if scene_or_frames.room is None:
        wanted = "a scene whose room is known"
        raise ArgumentError(f"layout: expected {wanted}, got none; give images to fit a room to")
    return RoomLayout(scene_or_frames.room)


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
        room: as :func:`layout` returns it.
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
    tolerance = Tolerance() if tolerance is None else tolerance
    corners_w, corner_kinds = _corners(known.room)
    ends, kinds, planes = _edges(known.room)
    corners_c = pose.to_camera(corners_w)
    corner_pixels, corner_origins_c, in_image = resolved(camera, corners_c, camera.project(corners_c)[0])
    curves = sample_edges(camera, corners_c[ends[:, 0]], corners_c[ends[:, 1]])

    points_c = np.concatenate([corners_c[in_image], curves.points_c])
    pixels = np.concatenate([corner_pixels[in_image], curves.pixels])
    origins_c = np.concatenate([corner_origins_c[in_image], curves.origins_c])
    room_flags = seen_in_room(known.room, pose, points_c, origins_c)
    if depth_room is not None:
        room_flags = seen_in_depth(known.room, camera, pose, pixels, depth_room, tolerance)
    flags = None
    if depth is not None:
        flags = room_flags & seen_in_depth(known.room, camera, pose, pixels, depth, tolerance)
    count = int(np.count_nonzero(in_image))
    pieces = _pieces(curves.edge, curves.joined, curves.pixels, room_flags[count:], _rest(flags, count))
    of_corner = np.where(in_image, np.cumsum(in_image) - 1, -1)
    return {
        "version": VERSION,
        "source": known.source,
        "residual_m": float(known.residual_m),
        "floor": float(known.room.floor_z),
        "ceiling": float(known.room.ceiling_z),
        "camera_height": float(pose.position[2] - known.room.floor_z),
        "corners": [
            {
                "id": i,
                "kind": corner_kinds[i],
                "world": corners_w[i].tolist(),
                "camera": corners_c[i].tolist(),
                "pixel": corner_pixels[i].tolist() if k >= 0 else None,
                "in_image": k >= 0,
                "visible_room": k >= 0 and bool(room_flags[k]),
                "visible": k >= 0 and bool(flags[k]) if flags is not None else None,
            }
            for i, k in enumerate(of_corner.tolist())
        ],
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


def _corners(room: Room) -> tuple[Array, list[str]]:
    """(2N, 3) metres, world frame, the floor's before the ceiling's, and their kinds."""
    count = len(room.corners_w)
    heights = np.repeat([room.floor_z, room.ceiling_z], count)
    corners_w = np.column_stack([np.tile(room.corners_w, (2, 1)), heights])
    return corners_w, ["floor"] * count + ["ceiling"] * count


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


def _rest(flags: NDArray[np.bool_] | None, count: int) -> NDArray[np.bool_] | None:
    return None if flags is None else flags[count:]


def _pieces(
    edge: NDArray[np.intp],
    joined: NDArray[np.bool_],
    pixels: Array,
    in_room: NDArray[np.bool_],
    in_full: NDArray[np.bool_] | None,
) -> dict[int, list[dict[str, Any]]]:
    """By edge, its curve cut where it breaks off and where a flag changes."""
    full = in_room if in_full is None else in_full
    cut = ~joined[:-1] | (in_room[1:] != in_room[:-1]) | (full[1:] != full[:-1])
    bounds = np.concatenate([[0], np.flatnonzero(cut) + 1, [len(edge)]]).astype(int).tolist()
    listed = pixels.tolist()
    found: dict[int, list[dict[str, Any]]] = {}
    for start, end in pairwise(bounds):
        if start < end:
            shown_full = None if in_full is None else bool(in_full[start])
            piece = {
                "pixels": listed[start:end],
                "visible_room": bool(in_room[start]),
                "visible": shown_full,
            }
            found.setdefault(int(edge[start]), []).append(piece)
    return found
