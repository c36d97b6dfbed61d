"""Omni3D: ``omni3d.json``, boxes in space in the frame of the camera, in the form of COCO.

Coordinates are those of the camera: x right, y down, z forward, metres. ``dimensions`` are width, height and
length of the box: along z, y and x of its frame, whose axes in the camera's are the columns of ``R_cam``.
The corners of ``bbox3D_cam`` are in the order of Omni3D: (-, -, -), (+, -, -), (+, +, -), (-, +, -), then the
same with z positive. What is not known is -1.

Cameras other than ``pinhole`` have no matrix ``K``; every image has its ``camera``, as omniscv writes it.
A file that readers of Omni3D load as it is comes of pinhole cameras alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import fields
from omniscv.cameras import Camera
from omniscv.cameras.pinhole import Pinhole
from omniscv.dataset.coco_entries import (
    category_entries,
    class_of,
    image_entry,
    object_entries,
    write_compact,
)
from omniscv.dataset.frames import Frame
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.scene_geometry import ObjectBox

name = "omni3d"
needs = ("labels", "truth")

_UNKNOWN = -1
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
    if isinstance(camera := frame.camera, Pinhole):
        (u, v), f = camera.center.tolist(), camera.focal
        found["K"] = [[f, 0.0, u], [0.0, f, v], [0.0, 0.0, 1.0]]
    return found | {"dataset_id": 0, "src_90_rotate": 0, "src_flagged": False}


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
        corners = ObjectBox(center, R_c_b, size, record["source"]).corners_w()  # here in the camera's frame
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
            "R_cam": record["R_camera_box"],
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
    """Around the projected corners, which may lie beyond the image of a pinhole camera; unknown where one has
    no pixel, or where they lie around a seam."""
    if isinstance(camera, Pinhole) and camera.focal and not (camera.skew or camera.distortion.any()):
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = camera.center + camera.focal * corners_c[:, :2] / corners_c[:, 2:]
        valid = corners_c[:, 2] > 0
    else:
        pixels, valid = camera.project(corners_c)
    if not valid.all() or (camera.wraps and np.ptp(pixels[:, 0]) > camera.width / 2):
        return _NO_BOX
    return [*map(float, pixels.min(axis=0)), *map(float, pixels.max(axis=0))]


def _within(box: Sequence[float], camera: Camera) -> list[float]:
    most = (camera.width, camera.height, camera.width, camera.height)
    return [min(max(0.0, each), float(edge)) for each, edge in zip(box, most, strict=True)]
