"""Omni3D: ``omni3d.json``, boxes in space in the frame of the camera, in the form of COCO.

Coordinates are those of the camera: x right, y down, z forward, metres. ``dimensions`` are width, height and
length of the box: along z, y and x of its frame, whose axes in the camera's are the columns of ``R_cam``. In
an upright box, y is down.
The corners of ``bbox3D_cam`` are in the order of Omni3D: (-, -, -), (+, -, -), (+, +, -), (-, +, -), then the
same with z positive. Unknown values are -1.

Cameras with distortion have no matrix ``K``; every image has its ``camera``, as omniscv writes it. Readers of
Omni3D load files of pinhole cameras without distortion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.cameras import Camera
from omniscv.dataset.coco_entries import (
    category_entries,
    class_of,
    entries,
    image_entry,
    object_entries,
    write_compact,
)
from omniscv.dataset.exporting import Format, register
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.records import NoOptions

_UNKNOWN = -1
_CHECKED = 7  # rows and columns of pixels in which a camera with a matrix must be linear
_LINEAR = 1e-9  # largest deviation, on the plane z = 1
_R_B_O = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From Omni3D's frame of a box, whose y is down, to ours, whose z is up."""
_NO_BOX = [-1.0, -1.0, -1.0, -1.0]


@register
class Omni3d(Format):
    """See the module."""

    name = "omni3d"
    needs = ("labels", "truth")

    def write(self, frames: Sequence[Frame], out: Path, options: NoOptions) -> list[Path]:
        """Write the boxes of frames; ArgumentError for a frame without the truth ``boxes3d``."""
        ordered = sorted(frames, key=lambda frame: frame.key)

        def image(frame: Frame, image_id: int) -> dict[str, Any]:
            entry = image_entry(frame, image_id, out)
            entry["file_path"] = entry.pop("file_name")
            if (K := matrix_of(frame.camera)) is not None:
                entry["K"] = K.tolist()
            return entry | {"dataset_id": 0, "src_90_rotate": 0, "src_flagged": False}

        images, annotations = entries(ordered, image, _annotations)
        info = {"id": 0, "source": "omniscv", "name": "omniscv", "split": "", "version": "1", "url": ""}
        content = {"info": info, "images": images, "categories": category_entries(ordered, stuff=False)}
        return [write_compact(out / "omni3d.json", {**content, "annotations": annotations})]


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
    in_image = {entry["instance_id"]: entry for entry in object_entries(frame, split=False)}
    shares = {share["instance_id"]: share["visib_fract"] for share in frame.truth.get("amodal", ())}
    for box in frame.truth["boxes3d"]:
        entry, category = in_image.get(box["instance_id"]), class_of(frame, box["name"])
        if entry is None or category is None:
            continue
        size, center, R_c_b = (np.array(box[key]) for key in ("size", "center_camera", "R_camera_box"))
        size, R_c_o = size[[0, 2, 1]], R_c_b @ _R_B_O
        corners = ObjectBox(center, R_c_o, size, box["source"]).corners_w()  # in the camera's frame
        projected = _projected(frame.camera, corners)
        x, y, width, height = entry["bbox"]
        most = 2 * (float(frame.camera.width), float(frame.camera.height))
        inside = [min(max(0.0, value), edge) for value, edge in zip(projected, most, strict=True)]
        yield {
            "dataset_id": 0,
            "category_id": entry["category_id"],
            "category_name": category.name,
            "instance_id": box["instance_id"],
            "name": box["name"],
            "valid3D": not box.get("partial", False),
            "bbox2D_tight": [x, y, x + width, y + height],
            "bbox2D_proj": projected,
            "bbox2D_trunc": _NO_BOX if projected == _NO_BOX else inside,
            "bbox3D_cam": corners.tolist(),
            "center_cam": box["center_camera"],
            "dimensions": size[[2, 1, 0]].tolist(),
            "R_cam": R_c_o.tolist(),
            "behind_camera": bool((corners[:, 2] <= 0).all()),
            "visibility": shares.get(box["instance_id"], _UNKNOWN),
            "truncation": box["truncated"],
            "segmentation_pts": _UNKNOWN,
            "lidar_pts": _UNKNOWN,
            "depth_error": _UNKNOWN,
        }


def _projected(camera: Camera, corners_c: Array) -> list[float]:
    """The box around the projected corners, which may exceed the image if the camera has a matrix.

    It is unknown if a corner has no pixel, or if the box crosses the seam of a panorama.
    """
    if (K := matrix_of(camera)) is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = (corners_c @ K.T)[:, :2] / corners_c[:, 2:]
        valid = corners_c[:, 2] > 0
    else:
        pixels, valid = camera.project(corners_c)
    if not valid.all() or (camera.wraps and np.ptp(pixels[:, 0]) > camera.width / 2):
        return _NO_BOX
    return [*map(float, pixels.min(axis=0)), *map(float, pixels.max(axis=0))]
