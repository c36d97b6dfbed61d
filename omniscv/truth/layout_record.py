"""The truth ``layout``: the layout of a room as a camera sees it, in ``STEM.layout.json``.

A record, as :func:`project_layout` returns it, has ``version``, ``source``, ``residual_m``, ``floor``,
``ceiling`` and ``camera_height`` in metres, then

``corners``  ``id``, ``kind`` (floor, ceiling), ``world`` and ``camera`` in metres, ``pixel`` (null outside
             the image), ``in_image``, ``visible_room``, ``visible``. In a room of N walls, corner i of the
             floor has the id i, counterclockwise from above; the ceiling's corner above it has N + i
``edges``    ``id``, ``kind`` (floor, ceiling, vertical), ``corners`` (two ids), ``planes`` (two names), and
             ``pieces`` of the curve: ``pixels`` at most 0.5 px apart, ``visible_room``, ``visible``

``visible_room`` is false behind a wall of the room, exactly. ``visible`` is also false behind anything else,
and null without depth. A pixel has one depth, so that the place of a silhouette is known to a pixel: samples
within one of it may be wrong.
"""

from collections.abc import Callable, Collection, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import numbers, shown
from omniscv.cameras import Camera, create
from omniscv.compose.image import OmniImage
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room, SceneGeometry
from omniscv.records import checked, nested, record
from omniscv.render_options import LayoutSource, Tolerance, layout_source
from omniscv.truth.registry import Truth, register
from omniscv.truth.room_in_image import Flags, Samples, resolved, sample_edges, seen_in_depth, seen_in_room
from omniscv.truth.room_layout import Picture, RoomLayout, is_room, layout

VERSION = 1

_SAME_M = 1e-6  # corners whose heights or plans differ by less are equal
_PANORAMA = "equirectangular", 1024, 512
_FIT_MODES = ("object_mask", "depth", "normals")


def project_layout(
    room: RoomLayout | Room,
    camera: Camera,
    pose: Pose,
    depth: ArrayLike | None = None,
    tolerance: Tolerance | None = None,
) -> dict[str, Any]:
    """Return the record of a room's layout in an image.

    Args:
        room: as :func:`omniscv.truth.layout` returns it.
        camera: of the image, central or not.
        pose: of the camera, world frame.
        depth: (H, W) metres along each pixel's ray from its own origin, for ``visible``; null without.
        tolerance: between depths that are taken for equal; the default if not given.

    Returns:
        Plain JSON values; see the module.

    Raises:
        ArgumentError: a depth of another size than the image, or a room that is none.
    """
    known = RoomLayout(room) if isinstance(room, Room) else room
    room = known.room
    allowed = tolerance or Tolerance()

    def flags(points_c: Array, pixels: Array, origins_c: Array) -> tuple[Flags, Flags | None]:
        """Return (S,) ``visible_room`` and ``visible`` of points on the room's edges.

        They are at ``points_c`` (S, 3), and their rays, from ``origins_c`` (S, 3), at ``pixels`` (S, 2).
        """
        in_room = seen_in_room(room, pose, points_c, origins_c)
        if depth is None:
            return in_room, None
        return in_room, in_room & seen_in_depth(room, camera, pose, pixels, depth, allowed)

    ends, kinds, planes = edges_of(room)
    corners_c = pose.to_camera(corners_of(room))
    curves = sample_edges(camera, corners_c[ends[:, 0]], corners_c[ends[:, 1]])
    pieces = _pieces(curves, *flags(curves.points_c, curves.pixels, curves.origins_c))
    edges = []
    for number, kind in enumerate(kinds):
        edge = {"id": number, "kind": kind, "corners": ends[number].tolist(), "planes": planes[number]}
        edges.append({**edge, "pieces": pieces.get(number, [])})
    return {
        "version": VERSION,
        "source": known.source,
        "residual_m": float(known.residual_m),
        "floor": float(room.floor_z),
        "ceiling": float(room.ceiling_z),
        "camera_height": float(pose.position[2] - room.floor_z),
        "corners": _corner_records(corners_of(room), corners_c, camera, flags),
        "edges": edges,
    }


def room_of(record: Mapping[str, Any]) -> Room:
    """Return the room that a record describes.

    Raises:
        ArgumentError: it is no record of a layout, or the room is no prism: corners of the floor, or of the
            ceiling, differ in height, or a corner of the ceiling is not above the floor's.
    """
    try:
        if record["version"] != VERSION:
            raise ArgumentError(f"layout: expected version {VERSION}, got {shown(record['version'])}")
        corners_w = numbers("corners", [corner["world"] for corner in record["corners"]], (None, 3))
        planes = []  # the wall of each level edge, and the floor or ceiling that it meets
        for edge in record["edges"]:
            if edge["kind"] != "vertical":
                planes.append(edge["planes"])
        count = len(corners_w) // 2
        floor = corners_w[:count]
        ceiling = corners_w[count:]
        walls = [tuple(planes[number]) for number in range(2 * count)]
    except (KeyError, TypeError, IndexError) as cause:
        raise ArgumentError(f"layout: expected a record of a layout, got {shown(record)}") from cause
    uneven = max(np.ptp(floor[:, 2]), np.ptp(ceiling[:, 2]), np.abs(floor[:, :2] - ceiling[:, :2]).max())
    if uneven > _SAME_M:
        wanted = "expected a room of upright walls between a level floor and a level ceiling"
        raise ArgumentError(f"layout: {wanted}, got corners that are {uneven:.3g} m off that")
    names = tuple(wall for wall, _ in walls[:count])
    heights = float(floor[0, 2]), float(ceiling[0, 2])
    return Room(floor[:, :2], *heights, names, walls[0][1], walls[count][1])


def _corner_records(
    corners_w: Array,
    corners_c: Array,
    camera: Camera,
    flags: Callable[[Array, Array, Array], tuple[Flags, Flags | None]],
) -> list[dict[str, Any]]:
    pixels, origins_c, seen = resolved(camera, corners_c, camera.project(corners_c)[0])
    in_room, in_full = flags(corners_c[seen], pixels[seen], origins_c[seen])
    visible_room = np.zeros_like(seen)
    visible = np.zeros_like(seen)
    visible_room[seen] = in_room
    visible[seen] = in_room if in_full is None else in_full
    count = len(corners_w) // 2
    records = []
    for number, in_image in enumerate(seen.tolist()):
        corner = {
            "id": number,
            "kind": "floor" if number < count else "ceiling",
            "world": corners_w[number].tolist(),
            "camera": corners_c[number].tolist(),
            "pixel": pixels[number].tolist() if in_image else None,
            "in_image": in_image,
            "visible_room": bool(visible_room[number]),
            "visible": None if in_full is None else bool(visible[number]),
        }
        records.append(corner)
    return records


def corners_of(room: Room) -> Array:
    """Return (2N, 3) metres, world frame, the corners of the floor before those of the ceiling."""
    heights = np.repeat([room.floor_z, room.ceiling_z], len(room.corners_w))
    return np.column_stack([np.tile(room.corners_w, (2, 1)), heights])


def edges_of(room: Room) -> tuple[NDArray[np.intp], list[str], list[list[str]]]:
    """Return (3N, 2) corners at the ends of edges, their kinds, and the names of the planes that meet."""
    count = len(room.corners_w)
    corner = np.arange(count)
    ring = np.column_stack([corner, np.roll(corner, -1)])
    ends = np.concatenate([ring, ring + count, np.column_stack([corner, corner + count])])
    kinds = ["floor"] * count + ["ceiling"] * count + ["vertical"] * count
    planes = []
    for level in (room.floor, room.ceiling):
        for wall in room.walls:
            planes.append([wall, level])
    for number in range(count):
        planes.append([room.walls[number - 1], room.walls[number]])
    return ends, kinds, planes


def _pieces(curves: Samples, in_room: Flags, in_full: Flags | None) -> dict[int, list[dict[str, Any]]]:
    """By edge, its curve, cut where it is interrupted and where a flag changes."""
    full = in_room if in_full is None else in_full
    cut = ~curves.joined[:-1] | (in_room[1:] != in_room[:-1]) | (full[1:] != full[:-1])
    bounds = [0, *(np.flatnonzero(cut) + 1).tolist(), len(curves.edge)]
    pixels = curves.pixels.tolist()
    pieces = dict[int, list[dict[str, Any]]]()
    for start, end in pairwise(bounds):
        if start < end:
            piece = {
                "pixels": pixels[start:end],
                "visible_room": bool(in_room[start]),
                "visible": None if in_full is None else bool(in_full[start]),
            }
            pieces.setdefault(int(curves.edge[start]), []).append(piece)
    return pieces


# -- the truth ------------------------------------------------------------------------------------------


@record
class LayoutOptions:
    """Options of the truth ``layout``."""

    source: LayoutSource | None = checked(
        layout_source, default=None, help="scene, or fitted to the image [scene where it knows its room]"
    )
    tolerance: Tolerance = checked(nested(Tolerance), default=Tolerance(), help="of depths that are equal")


def _derive(frame: Frame, options: LayoutOptions) -> dict[str, Any]:
    """Return the record of the room's layout in an image.

    A room that the source does not know is fitted to the image; where it does not show every wall, to a
    panorama from the same position without furniture, if the source can hide objects.
    """
    image = frame.rendered()
    room = _room(frame, options.source)
    return project_layout(room, image.camera, image.pose, image.depth, tolerance=options.tolerance)


def _room(frame: Frame, source: LayoutSource | None) -> RoomLayout:
    if source != "fitted" and (source == "scene" or frame.geometry.room is not None):
        return layout(frame.geometry)
    image = frame.rendered()
    try:
        picture = Picture(image.camera, image.pose, image.layers, frame.instances)
        return layout([picture], frame.classes)
    except ArgumentError as hidden:
        empty = _panorama_without_furniture(frame)
        if empty is None:
            raise hidden from None
        return layout([empty], frame.classes)


def _panorama_without_furniture(frame: Frame) -> OmniImage | None:
    """A panorama at the image's position of the room alone; None if the source cannot hide objects."""
    if frame.renderer is None:
        return None
    source = frame.renderer.source
    furniture = [name for name in source.objects().names() if not is_room(name, frame.classes)]
    try:
        empty = source.without(furniture)
    except ArgumentError:
        return None
    with empty:
        return frame.renderer.of(empty).render(create(*_PANORAMA), frame.rendered().pose, _FIT_MODES)


def _captures(geometry: SceneGeometry, options: LayoutOptions) -> bool:
    return geometry.room is None or options.source == "fitted"


def _check(_: object, geometry: SceneGeometry, modes: Collection[str], options: LayoutOptions) -> None:
    if not _captures(geometry, options):
        return
    if missing := [mode for mode in _FIT_MODES if mode not in modes]:
        why = "because the source does not know its room, which is fitted to images"
        raise ArgumentError(f"expected modes with {', '.join(missing)}, {why}; add them to 'modes'")


register(
    Truth(
        "layout", _derive, needs=("depth",), file="layout.json", keys=("tolerance",), captures=_captures,
        options=LayoutOptions, check=_check,
    )
)  # fmt: skip
