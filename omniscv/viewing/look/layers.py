"""The layers, boxes and layout of a frame in the forms that a page reads.

``picture``  the bytes of a PNG or JPEG file, or of a PNG that is made: RGB
``ids``      uint16: labels, classes
``scalar``   float32
``vectors``  int8, 127 for 1: normals
``marks``    uint8, 1 where a pixel is marked

Any layer of :mod:`omniscv.modalities` has one of these forms by its type and interpolation.

Arrays are packed: a mapping with ``type`` (``f4``, ``u4``, ``u2``, ``i2``, ``i1``, ``u1``), ``shape`` and
``data``: the base64 text of a zlib stream. Its bytes are those of the array with the channels first,
(C, H, W), each number read as an unsigned whole number less its left neighbour (modulo its range), split into
planes: the lowest byte of every number, then the next. Neighbours in images are alike, so planes are mostly
zeros. ``codec.js`` reads it.

Boxes and layouts are lines in the image, each a flat list ``[u0, v0, u1, v1, ...]``, px.
"""

import base64
import itertools
import zlib
from collections.abc import Iterable, Mapping
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.cameras import Camera
from omniscv.compose.pictures import uint8_colors
from omniscv.dataset import Frame
from omniscv.geometry import Array
from omniscv.geometry.scene_geometry import BOX_EDGES, ObjectBox
from omniscv.parallel import side_by_side

_PICTURE_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
_LEVEL = 5

_STEP = 6  # every so many samples of a curve, at most half a pixel apart, are kept
_STEPS = 48  # of a box's edge

BoxKind = Literal["boxes", "boxes3d"]


def names(frame: Frame) -> list[str]:
    """Return the layers that a frame has, in the order of the table."""
    return [modality.name for modality in modalities.layers() if modality.name in frame.files]


def form(name: str) -> str:
    """Return the form of a layer."""
    modality = modalities.get(name)
    if modality.mark:
        return "marks"
    if modality.dtypes == ("uint16",):
        return "ids"
    if modality.channels == 3:
        return "vectors" if modality.interpolation in ("direction", "plane") else "picture"
    return "scalar"


def packed_layers(frame: Frame) -> dict[str, dict[str, Any]]:
    """Return the layers of a frame by name, as plain JSON values with ``form``."""
    layers = names(frame)
    return dict(zip(layers, side_by_side(lambda name: _packed_layer(frame, name), layers), strict=True))


def _packed_layer(frame: Frame, name: str) -> dict[str, Any]:
    kind = form(name)
    path = frame.files[name]
    if kind == "picture":
        if media_type := _PICTURE_TYPES.get(path.suffix.lower()):
            return {"form": kind, "type": media_type, "data": text(path.read_bytes())}
        bgr = np.ascontiguousarray(uint8_colors(frame.layer(name))[..., ::-1])
        return {"form": kind, "type": "image/png", "data": text(cv2.imencode(".png", bgr)[1].tobytes())}
    values = frame.layer(name)
    if kind == "vectors":
        return {"form": kind, **pack(np.rint(127 * np.nan_to_num(values).clip(-1, 1)).astype(np.int8))}
    if kind == "scalar":
        exact = values.astype(np.float32)
        known = exact[np.isfinite(exact) & (exact > 0)]
        ends = np.quantile(known, (0.005, 0.995)).tolist() if known.size else None
        return {"form": kind, "range": ends, **pack(exact)}
    return {"form": kind, **pack(values)}


def pack(values: NDArray[Any]) -> dict[str, Any]:
    """Return an array (H, W) or (H, W, C) of one of the types as plain JSON values; see the module.

    Booleans become ``u1``.
    """
    exact = values.astype(np.uint8) if values.dtype == np.bool_ else values
    size = exact.dtype.itemsize
    planar = np.moveaxis(exact if exact.ndim == 3 else exact[..., None], -1, 0)
    whole = np.ascontiguousarray(planar).view(f"<u{size}")
    steps = whole.copy()
    steps[..., 1:] -= whole[..., :-1]
    planes = np.ascontiguousarray(steps.view(np.uint8).reshape(-1, size).T)
    kind = f"{exact.dtype.kind}{size}"
    return {"type": kind, "shape": list(planar.shape), "data": text(zlib.compress(planes.tobytes(), _LEVEL))}


def text(data: bytes) -> str:
    """Return bytes as base64."""
    return base64.b64encode(data).decode("ascii")


def boxes(frame: Frame) -> dict[str, list[dict[str, Any]]]:
    """Return the boxes in the image and in space, by kind: ``id``, ``name``, ``class``, ``lines``."""
    by_kind = {}
    for kind in get_args(BoxKind):
        records = frame.truth.get(kind)
        if records:
            by_kind[kind] = [_box(kind, frame.camera, record) for record in records]
    return by_kind


def _box(kind: BoxKind, camera: Camera, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a page draws of a box, by its record."""
    lines: list[list[float]] = []
    for line in box_lines(kind, camera, record):
        lines += _parts(line)
    described = {"id": record["instance_id"], "name": record["name"], "class": record.get("class")}
    return {**described, "lines": lines}


def box_lines(kind: BoxKind, camera: Camera, record: Mapping[str, Any]) -> list[Array]:
    """Return the lines of a box in an image, (N, 2) px each, as the ``camera`` bends them.

    They are NaN where the image does not show them. ``record`` is that of the truth ``kind``.
    """
    lines = []
    if kind == "boxes":  # columns beyond the right border continue at the left
        x, y, width, height = record.get("bbox_wrap", record["bbox"])
        right = x + width
        bottom = y + height
        corners = np.array([(x, y), (right, y), (right, bottom), (x, bottom), (x, y)], dtype=float)
        for start, end in itertools.pairwise(corners):
            side = np.linspace(start, end, _STEPS)
            lines.append(np.column_stack([side[:, 0] % camera.width, side[:, 1]]))
        return lines
    center = np.array(record["center_camera"])
    box = ObjectBox(center, np.array(record["R_camera_box"]), np.array(record["size"]), record["source"])
    for start, end in box.corners_w()[np.array(BOX_EDGES)]:
        pixels, _ = camera.project(np.linspace(start, end, _STEPS))
        lines.append(pixels)
    return lines


def layout(frame: Frame) -> dict[str, Any] | None:
    """Return a frame's layout; None without one.

    ``edges`` have ``kind``, ``line``, and visibility in the empty room and in the furnished one: ``room``,
    ``seen``; ``corners`` have ``pixel`` in place of ``line``. ``floor`` is (N, 2), the room from above, world
    frame, metres.
    """
    record = frame.layout
    if not record:
        return None

    edges = []
    for edge in record["edges"]:
        for piece in edge["pieces"]:
            for line in _parts(np.array(piece["pixels"], dtype=float)):
                edges.append({"kind": edge["kind"], **_visibility(piece), "line": line})
    corners = []
    floor = []
    for corner in record["corners"]:
        if corner["in_image"]:
            corners.append({"kind": corner["kind"], **_visibility(corner), "pixel": corner["pixel"]})
        if corner["kind"] == "floor":
            floor.append(corner["world"][:2])
    return {"edges": edges, "corners": corners, "floor": floor}


def _visibility(part: Mapping[str, Any]) -> dict[str, bool]:
    """Return whether a part of a layout is visible in the empty room, and in the furnished one."""
    return {"room": part["visible_room"], "seen": part["visible"] is not False}


def _parts(pixels: Array) -> Iterable[list[float]]:
    """The parts of a line (N, 2) px between points that are not in the image, of every few points."""
    line = pixels if len(pixels) < 3 else np.concatenate([pixels[:-1:_STEP], pixels[-1:]])
    gaps = np.flatnonzero(~np.isfinite(line).all(axis=1))
    for part in np.split(line, gaps):
        known = part[np.isfinite(part).all(axis=1)]
        if len(known) > 1:
            yield np.round(known, 1).ravel().tolist()
