"""A scene in the form of Structured3D: the annotation of its rooms, and panoramas of them.

scene_00000/annotation_3d.json                      junctions, lines, planes and semantics of all rooms, mm
scene_00000/2D_rendering/N/panorama/camera_xyz.txt  where panorama N is, mm
    layout.txt, full/{rgb_rawlight,semantic,instance,depth}.png  as far as the frame has these layers
README.txt                                          which frame is panorama N, and the heading

Panoramas are upright equirectangular and all have one heading, because the form has no rotation. Its
documents say that their middle looks along -y. Programs that read it take +y, x to the right, which fits
panoramas to the annotation; that is written here. Room k of ``semantics`` is that of panorama k; further
panoramas of the same rooms follow. Normals are left out, because no document states their frame. Sources:
bertjiazheng/Structured3D data_organization.md and visualize_3d.py, ywyue/RoomFormer
PointCloudReaderPanorama.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import within
from omniscv.cameras import Camera
from omniscv.compose.files import write_json
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.formats.numbers import PRESETS, encode
from omniscv.dataset.pictures import write_color, write_pixels
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.records import NoOptions
from omniscv.storage.local import write_text
from omniscv.truth import layout_labels
from omniscv.truth.layout_record import corners_of, edges_of, room_of

_SAME_HEADING = 1e-6  # rad
_SAME_M = 1e-3  # between the corners of one room, fitted twice
_MM = 1000.0
_BACKGROUND = 65535  # of instances
_WALL, _FLOOR, _CEILING, _OTHER = 1, 2, 22, 40  # of NYU40


@register
class Structured3d(Format):
    """See the module."""

    name = "structured3d"
    needs = ("layout",)

    def refuses(self, camera: Camera) -> str | None:
        return layout_labels.refuses(camera)

    def write(self, frames: Sequence[Frame], out: Path, options: NoOptions) -> list[Path]:
        """Write frames as one scene.

        Raises:
            ArgumentError: a camera that is not upright or not in the room, or different headings.
        """
        R_s_w = _scene_frame(frames)
        lines = {}
        for frame in frames:
            with within(frame.key):
                lines[frame.key] = layout_labels.corner_lines(frame.layout, frame.camera, frame.pose)
        rooms = [room_of(frame.layout) for frame in frames]
        first: list[int] = []  # of each distinct room
        for index, room in enumerate(rooms):
            if not any(_same(room, rooms[i]) for i in first):
                first.append(index)
        order = first + [i for i in range(len(rooms)) if i not in first]
        scene = out / "scene_00000"
        content, rows = annotation([rooms[index] for index in first], R_s_w), []
        written = [write_json(scene / "annotation_3d.json", content, indent=None)]
        for number, index in enumerate(order):
            frame = frames[index]
            folder = scene / "2D_rendering" / str(number) / "panorama"
            written += _panorama(frame, folder, rooms[index], lines[frame.key], R_s_w)
            rows.append(f"{number} {frame.key}")
        return [*written, write_text(out / "README.txt", _README + "\n".join(rows) + "\n")]


_README = """Structured3D form, written by omniscv.
The middle of every panorama looks along +y, right is +x, up is +z, as RoomFormer and others read it.
Panoramas and the frames that they are:
"""


def annotation(rooms: Sequence[Room], R_s_w: Array) -> dict[str, Any]:
    """Return the contents of ``annotation_3d.json``: ``normal . p + offset = 0`` on a plane, mm.

    Args:
        rooms: in the order of their numbers.
        R_s_w: (3, 3) from the world to the scene's axes.
    """
    from scipy.linalg import block_diag

    content: dict[str, Any] = {"junctions": [], "lines": [], "planes": [], "semantics": []}
    elements = [_elements(room, R_s_w) for room in rooms]
    for number, of_room in enumerate(elements):
        planes = range(len(content["planes"]), len(content["planes"]) + len(of_room["planes"]))
        for kind in ("junctions", "lines", "planes"):
            start = len(content[kind])
            content[kind] += [{"ID": start + i, **entry} for i, entry in enumerate(of_room[kind])]
        content["semantics"].append({"ID": number, "type": "undefined", "planeID": list(planes)})
    for name, key in (("planeLineMatrix", "on_plane"), ("lineJunctionMatrix", "on_line")):
        content[name] = block_diag(*(of_room[key] for of_room in elements)).tolist() if elements else []
    return {**content, "cuboids": [], "manhattan": []}


def _elements(room: Room, R_s_w: Array) -> dict[str, Any]:
    """Junctions, lines and planes (floor, ceiling, then walls) of a room, and which of them meet."""
    count = len(room.corners_w)
    junctions = _MM * corners_of(room) @ R_s_w.T
    corner, (ends, _, _) = np.arange(count), edges_of(room)
    wall = corner + 2
    planes = np.concatenate(
        [np.c_[np.full(count, 0), wall], np.c_[np.full(count, 1), wall], np.c_[np.roll(wall, 1), wall]]
    )
    on_line, on_plane = np.zeros((3 * count, 2 * count), int), np.zeros((count + 2, 3 * count), int)
    np.put_along_axis(on_line, ends, 1, axis=1)
    np.put_along_axis(on_plane.T, planes, 1, axis=1)
    along = junctions[ends[:, 1]] - junctions[ends[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    inward = np.cross([0.0, 0.0, 1.0], along[:count])
    normals = np.concatenate([[[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], inward])
    on = junctions[np.concatenate([[0, count], corner])]
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
    """(3, 3) from the world to the scene's axes: x right of the panoramas, y forward, z up."""
    if not frames:
        return np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    first = frames[0].pose.R_w_c
    for frame in frames:
        if np.abs(frame.pose.R_w_c - first).max() > _SAME_HEADING:
            yaws = ", ".join(f"{pose.angles()[0]:.6g}" for pose in (frames[0].pose, frame.pose))
            raise ArgumentError(
                f"{frame.key}: expected panoramas of one heading, because the form has no rotation; got yaws "
                f"{yaws} degrees"
            )
    return np.stack([first[:, 0], first[:, 2], -first[:, 1]])


def _same(room: Room, other: Room) -> bool:
    if room.corners_w.shape != other.corners_w.shape:
        return False
    heights = abs(room.floor_z - other.floor_z), abs(room.ceiling_z - other.ceiling_z)
    turned = (np.roll(room.corners_w, k, axis=0) for k in range(len(room.walls)))
    off = min(np.abs(corners_w - other.corners_w).max() for corners_w in turned)
    return bool(max(*heights, off) <= _SAME_M)


def _panorama(frame: Frame, folder: Path, room: Room, lines: str, R_s_w: Array) -> list[Path]:
    full = folder / "full"
    position = " ".join(f"{value:.4f}" for value in _MM * R_s_w @ frame.pose.position)
    texts = {"camera_xyz.txt": f"{position}\n", "layout.txt": lines}
    written = [write_text(folder / name, text) for name, text in texts.items()]
    with within(frame.key):
        pictures: dict[str, NDArray[Any]] = {}
        if "labels" in frame.files:
            labels, surfaces = frame.layer("labels"), {*room.walls, room.floor, room.ceiling}
            background = [0, *(number for name, number in frame.instances.items() if name in surfaces)]
            pictures["semantic"] = _semantic(frame, room)
            pictures["instance"] = np.where(np.isin(labels, background), np.uint16(_BACKGROUND), labels)
        if "depth" in frame.files:
            pictures["depth"], _ = encode(frame.layer("depth"), frame.camera, PRESETS["mm"])
        written += [write_pixels(full / f"{kind}.png", pixels) for kind, pixels in pictures.items()]
        if "lit" in frame.files:
            written.append(write_color(full / "rgb_rawlight.png", frame))
    return written


def _semantic(frame: Frame, room: Room) -> NDArray[np.uint8]:
    """Ids of NYU40: of the dataset's classes if those are NYU40's, else wall, floor, ceiling, other."""
    labels = frame.layer("labels")
    ids = np.zeros(int(max(labels.max(), *frame.instances.values(), 0)) + 1, np.uint8)
    of_room = {**dict.fromkeys(room.walls, _WALL), room.floor: _FLOOR, room.ceiling: _CEILING}
    for object_name, instance in frame.instances.items():
        nyu40 = frame.classes if frame.classes and frame.classes.taxonomy == "nyu40" else None
        known = nyu40.of(object_name) if nyu40 else None
        ids[instance] = known.id if known else of_room.get(object_name, _OTHER)
    return np.asarray(ids[labels])
