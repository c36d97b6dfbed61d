"""Omni3D: ``omni3d.json``, boxes in space in the frame of the camera, in the form of COCO.

Coordinates are those of the camera: x right, y down, z forward, metres. ``dimensions`` are width, height and
length of the box: along z, y and x of its frame, whose axes in the camera's are the columns of ``R_cam``. Of
an upright box, y is down.
The corners of ``bbox3D_cam`` are in the order of Omni3D: (-, -, -), (+, -, -), (+, +, -), (-, +, -), then the
same with z positive. What is not known is -1.

Cameras that bend lines have no matrix ``K``; every image has its ``camera``, as omniscv writes it. A file
that readers of Omni3D load as it is comes of pinhole cameras without distortion alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import fields
from omniscv.cameras import Camera
from omniscv.dataset.coco_entries import (
    category_entries,
    class_of,
    image_entry,
    object_entries,
    write_compact,
)
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array
from omniscv.geometry.scene_geometry import ObjectBox

name = "omni3d"
needs = ("labels", "truth")

_UNKNOWN = -1
_CHECKED = 7  # pixels each way in which a camera must be linear to have a matrix
_LINEAR = 1e-9
_R_B_O = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From Omni3D's frame of a box, whose y is down, to ours, whose z is up."""
_NO_BOX = [-1.0, -1.0, -1.0, -1.0]


def refuses(camera: Camera) -> str | None:
    """Return None: every camera has a frame that boxes are in."""
    return None


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Raise ArgumentError: there are no options."""
    fields("", options, {})


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the boxes of frames.

    Raises:
        ArgumentError: a frame without the truth ``boxes3d``, or an option.
    """
    fields("", options, {})
    ordered = sorted(frames, key=lambda frame: frame.key)
    out.mkdir(parents=True, exist_ok=True)
    images: list[dict[str, Any]] = []
    found: list[dict[str, Any]] = []
    for number, frame in enumerate(ordered, start=1):
        images.append(_image(frame, number, out))
        for each in _annotations(frame):
            found.append({"id": len(found) + 1, "image_id": number, "dataset_id": 0, **each})
    info = {"id": 0, "source": "omniscv", "name": "omniscv", "split": "", "version": "1", "url": ""}
    content = {"info": info, "images": images, "categories": category_entries(ordered, stuff=False)}
    content["annotations"] = found
    return [write_compact(out / "omni3d.json", content)]


def _image(frame: Frame, number: int, out: Path) -> dict[str, Any]:
    found = image_entry(frame, number, out)
    found["file_path"] = found.pop("file_name")
    if (K := matrix_of(frame.camera)) is not None:
        found["K"] = K.tolist()
    return found | {"dataset_id": 0, "src_90_rotate": 0, "src_flagged": False}


@lru_cache(maxsize=16)
def matrix_of(camera: Camera) -> Array | None:
    """Return ``K`` (3, 3), read-only, of a camera that projects as ``K (x, y, z)``; None for any other."""
    u, v = (np.linspace(0, edge, _CHECKED) for edge in (camera.width, camera.height))
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = camera.unproject(pixels)
    if not rays.valid.all() or rays.origins.any() or (rays.directions[:, 2] <= 0).any():
        return None
    xy = rays.directions[:, :2] / rays.directions[:, 2:]
    homogeneous = np.column_stack([pixels, np.ones(len(pixels))])
    inverse = np.linalg.lstsq(homogeneous, xy, rcond=None)[0].T
    if np.abs(homogeneous @ inverse.T - xy).max() > _LINEAR:
        return None
    K = np.round(np.linalg.inv(np.vstack([inverse, [0, 0, 1]])), 9).astype(np.float64) + 0.0
    K.flags.writeable = False
    return K


def _annotations(frame: Frame) -> Iterator[dict[str, Any]]:
    if "boxes3d" not in frame.truth:
        raise ArgumentError(f"{frame.key}: expected the truth boxes3d, got none; make the dataset with it")
    tight = {each["instance_id"]: each for each in object_entries(frame, split=False)}
    seen = {each["instance_id"]: each.get("visib_fract", _UNKNOWN) for each in frame.truth.get("amodal", ())}
    for record in frame.truth["boxes3d"]:
        found = tight.get(record["instance_id"])
        of = class_of(frame, record["name"])
        if found is None or of is None:
            continue
        size, center, R_c_b = (np.array(record[key]) for key in ("size", "center_camera", "R_camera_box"))
        size, R_c_o = size[[0, 2, 1]], R_c_b @ _R_B_O
        corners = ObjectBox(center, R_c_o, size, record["source"]).corners_w()  # here in the camera's frame
        projected = _projected(frame.camera, corners)
        yield {
            "category_id": found["category_id"],
            "category_name": of.name,
            "instance_id": record["instance_id"],
            "name": record["name"],
            "valid3D": not record.get("partial", False),
            "bbox2D_tight": _corners(found["bbox"]),
            "bbox2D_proj": projected,
            "bbox2D_trunc": _NO_BOX if projected == _NO_BOX else _within(projected, frame.camera),
            "bbox3D_cam": corners.tolist(),
            "center_cam": record["center_camera"],
            "dimensions": [float(each) for each in size[[2, 1, 0]]],
            "R_cam": R_c_o.tolist(),
            "behind_camera": bool((corners[:, 2] <= 0).all()),
            "visibility": seen.get(record["instance_id"], _UNKNOWN),
            "truncation": record["truncated"],
            "segmentation_pts": _UNKNOWN,
            "lidar_pts": _UNKNOWN,
            "depth_error": _UNKNOWN,
        }


def _corners(box: Sequence[float]) -> list[float]:
    x, y, width, height = box
    return [x, y, x + width, y + height]


def _projected(camera: Camera, corners_c: Array) -> list[float]:
    """Around the projected corners, which may lie beyond the image where the camera has a matrix; unknown
    where one has no pixel, or where they lie around a seam."""
    if (K := matrix_of(camera)) is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = (corners_c @ K.T)[:, :2] / corners_c[:, 2:]
        valid = corners_c[:, 2] > 0
    else:
        pixels, valid = camera.project(corners_c)
    if not valid.all() or (camera.wraps and np.ptp(pixels[:, 0]) > camera.width / 2):
        return _NO_BOX
    return [*map(float, pixels.min(axis=0)), *map(float, pixels.max(axis=0))]


def _within(box: Sequence[float], camera: Camera) -> list[float]:
    most = (camera.width, camera.height, camera.width, camera.height)
    return [min(max(0.0, each), float(edge)) for each, edge in zip(box, most, strict=True)]
