"""A scene in the form of Structured3D: the annotation of its rooms, and panoramas of them.

scene_00000/annotation_3d.json                      junctions, lines, planes and semantics of all rooms, mm
scene_00000/2D_rendering/N/panorama/camera_xyz.txt  where panorama N is, mm
    layout.txt, full/{rgb_rawlight,semantic,instance,depth}.png  as far as the frame has these layers
README.txt                                          which frame is panorama N, and the heading

Upright equirectangular panoramas that all look the same way, because the form has no rotation. Its documents
say that their middle looks along -y; the programs that read it take +y, x to the right, and so fit panoramas
to the annotation: that is what is written here. Room k of ``semantics`` is that of panorama k; more panoramas
of the same rooms come after those. Normals are left out: their frame is documented nowhere.
Sources: bertjiazheng/Structured3D data_organization.md and visualize_3d.py,
ywyue/RoomFormer PointCloudReaderPanorama.py.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown, within
from omniscv.cameras import Camera
from omniscv.dataset.formats.horizonnet import corner_lines
from omniscv.dataset.pictures import write_color, write_pixels
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.truth.cor_id import refuses as cor_id_refuses
from omniscv.truth.layout_record import room_of

name = "structured3d"
refuses = cor_id_refuses
needs = ("layout",)


_SAME_HEADING = 1e-6  # rad
_SAME_M = 1e-3  # of two rooms' corners: they are one room, fitted twice
_MM = 1000.0
_FARTHEST_MM = 65535
_BACKGROUND = 65535  # of instances
_WALL, _FLOOR, _CEILING, _OTHER = 1, 2, 22, 40  # of NYU40


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write frames as one scene below a folder; see the module.

    Raises:
        ArgumentError: an option, a frame without a layout, a camera that is not an upright panorama within
            the room, or panoramas that look different ways.
    """
    check_options(options, {})
    R_s_w = _scene_frame(frames)
    lines = {frame.key: corner_lines(frame) for frame in frames}
    rooms = [room_of(frame.layout) for frame in frames]
    distinct, order = _distinct(rooms)
    scene = out / "scene_00000"
    scene.mkdir(parents=True, exist_ok=True)
    path = scene / "annotation_3d.json"
    path.write_text(json.dumps(annotation(distinct, R_s_w), allow_nan=False) + "\n", encoding="ascii")
    written, listed = [path], []
    for number, index in enumerate(order):
        frame = frames[index]
        folder = scene / "2D_rendering" / str(number) / "panorama"
        written += _panorama(frame, folder, rooms[index], lines[frame.key], R_s_w)
        listed.append(f"{number} {frame.key}")
    path = out / "README.txt"
    path.write_text(_README + "\n".join(listed) + "\n", encoding="utf-8")
    return [*written, path]


_README = """Structured3D form, written by omniscv.
The middle of every panorama looks along +y, right is +x, up is +z, as RoomFormer and others read it.
Panoramas and the frames that they are:
"""


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Refuse options: the format has none."""
    for key in options:
        raise ArgumentError(f"expected no options, got {shown(key)}")


def annotation(rooms: Sequence[Room], R_s_w: Array) -> dict[str, Any]:
    """Return the contents of ``annotation_3d.json``: ``normal . p + offset = 0`` on a plane, mm.

    Args:
        rooms: in the order of their numbers.
        R_s_w: (3, 3) from the world to the scene's axes.
    """
    parts = [_room_parts(room, R_s_w) for room in rooms]
    found: dict[str, Any] = {"junctions": [], "lines": [], "planes": [], "semantics": []}
    sizes = [(len(part["planes"]), len(part["lines"]), len(part["junctions"])) for part in parts]
    on_plane, on_line = (np.zeros(np.sum(sizes, axis=0)[axes], int) for axes in ([0, 1], [1, 2]))
    at = np.zeros(3, int)
    for number, (part, size) in enumerate(zip(parts, sizes, strict=True)):
        for kind in ("junctions", "lines", "planes"):
            start = len(found[kind])
            found[kind] += [{"ID": start + i, **entry} for i, entry in enumerate(part[kind])]
        p, l, j = (slice(start, start + count) for start, count in zip(at, size, strict=True))  # noqa: E741
        on_plane[p, l], on_line[l, j] = part["on_plane"], part["on_line"]
        planes = list(range(int(at[0]), int(at[0]) + size[0]))
        found["semantics"].append({"ID": number, "type": "undefined", "planeID": planes})
        at = at + size
    matrices = {"planeLineMatrix": on_plane.tolist(), "lineJunctionMatrix": on_line.tolist()}
    return {**found, **matrices, "cuboids": [], "manhattan": []}


def _room_parts(room: Room, R_s_w: Array) -> dict[str, Any]:
    """Junctions, lines and planes of a room, and which of them meet: floor, ceiling, then walls."""
    count = len(room.corners_w)
    heights = np.repeat([room.floor_z, room.ceiling_z], count)
    junctions = _MM * np.column_stack([np.tile(room.corners_w, (2, 1)), heights]) @ R_s_w.T
    here, then = np.arange(count), np.roll(np.arange(count), -1)
    ends = np.concatenate([np.c_[here, then], np.c_[here, then] + count, np.c_[here, here + count]])
    planes = np.concatenate([np.c_[np.full(count, 0), here + 2], np.c_[np.full(count, 1), here + 2],
                             np.c_[np.roll(here, 1) + 2, here + 2]])  # fmt: skip
    on_line, on_plane = np.zeros((3 * count, 2 * count), int), np.zeros((count + 2, 3 * count), int)
    np.put_along_axis(on_line, ends, 1, axis=1)
    np.put_along_axis(on_plane.T, planes, 1, axis=1)
    along = junctions[ends[:, 1]] - junctions[ends[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    inward = np.cross([0.0, 0.0, 1.0], along[:count])
    normals = np.concatenate([[[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], inward])
    on = junctions[np.concatenate([[0, count], here])]
    kinds = ["floor", "ceiling", *["wall"] * count]
    return {
        "junctions": [{"coordinate": xyz} for xyz in junctions.tolist()],
        "lines": [
            {"point": point, "direction": direction}
            for point, direction in zip(junctions[ends[:, 0]].tolist(), along.tolist(), strict=True)
        ],
        "planes": [
            {"type": kind, "normal": normal.tolist(), "offset": float(-normal @ point)}
            for kind, normal, point in zip(kinds, normals, on, strict=True)
        ],
        "on_line": on_line,
        "on_plane": on_plane,
    }


def _scene_frame(frames: Sequence[Frame]) -> Array:
    """(3, 3) from the world to the scene's axes: x to the right of the panoramas, y ahead, z up."""
    if not frames:
        return np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    first = frames[0].pose.R_w_c
    for frame in frames:
        if np.abs(frame.pose.R_w_c - first).max() > _SAME_HEADING:
            wanted = "panoramas that all look the same way, which the form does not keep"
            angles = ", ".join(f"{yaw:.6g}" for yaw in (frames[0].pose.angles()[0], frame.pose.angles()[0]))
            raise ArgumentError(f"{frame.key}: expected {wanted}; got yaws {angles} degrees")
    return np.stack([first[:, 0], first[:, 2], -first[:, 1]])


def _distinct(rooms: Sequence[Room]) -> tuple[list[Room], list[int]]:
    """The rooms that differ, and all rooms' indices, the first of each distinct one before the others."""
    first: list[int] = []
    for index, room in enumerate(rooms):
        if not any(_same(room, rooms[each]) for each in first):
            first.append(index)
    return [rooms[index] for index in first], first + [i for i in range(len(rooms)) if i not in first]


def _same(room: Room, other: Room) -> bool:
    if room.corners_w.shape != other.corners_w.shape:
        return False
    heights = abs(room.floor_z - other.floor_z), abs(room.ceiling_z - other.ceiling_z)
    turned = (np.roll(room.corners_w, k, axis=0) for k in range(len(room.walls)))
    off = min(np.abs(corners_w - other.corners_w).max() for corners_w in turned)
    return bool(max(*heights, off) <= _SAME_M)


def _panorama(frame: Frame, folder: Path, room: Room, lines: str, R_s_w: Array) -> list[Path]:
    full = folder / "full"
    full.mkdir(parents=True, exist_ok=True)
    position = " ".join(f"{each:.4f}" for each in _MM * R_s_w @ frame.pose.position)
    texts = {"camera_xyz.txt": position + "\n", "layout.txt": lines}
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="ascii")
    with within(frame.key):
        pictures: dict[str, NDArray[Any]] = {}
        if "labels" in frame.files:
            pictures["semantic"], pictures["instance"] = _semantic(frame, room), _instances(frame, room)
        if "depth" in frame.files:
            pictures["depth"] = _millimetres(frame.layer("depth"))
        saved = [write_pixels(full / f"{kind}.png", pixels) for kind, pixels in pictures.items()]
        if "lit" in frame.files:
            saved.append(write_color(full / "rgb_rawlight.png", frame))
    return [*(folder / file for file in texts), *saved]


def _millimetres(depth: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Whole mm, 0 of what is outside the image, endless or too far: never another distance."""
    rounded = np.round(_MM * depth.astype(np.float64))
    return np.where(rounded <= _FARTHEST_MM, rounded, 0).astype(np.uint16)


def _semantic(frame: Frame, room: Room) -> NDArray[np.uint8]:
    """Ids of NYU40: the dataset's own if that is its taxonomy, else of the room and all other objects."""
    labels = frame.layer("labels")
    ids = np.zeros(int(max(labels.max(), *frame.instances.values(), 0)) + 1, np.uint8)
    of_room = {**dict.fromkeys(room.walls, _WALL), room.floor: _FLOOR, room.ceiling: _CEILING}
    for object_name, instance in frame.instances.items():
        known = frame.classes.of(object_name) if frame.classes else None
        nyu40 = known is not None and frame.classes is not None and frame.classes.taxonomy == "nyu40"
        ids[instance] = known.id if known and nyu40 else of_room.get(object_name, _OTHER)
    return np.asarray(ids[labels])


def _instances(frame: Frame, room: Room) -> NDArray[np.uint16]:
    labels = frame.layer("labels")
    of_room = [each for each in (*room.walls, room.floor, room.ceiling) if each in frame.instances]
    background = [frame.instances[each] for each in of_room]
    return np.where(np.isin(labels, [0, *background]), np.uint16(_BACKGROUND), labels)
