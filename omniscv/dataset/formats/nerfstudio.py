"""nerfstudio's ``transforms.json``, with ``images/KEY.png``, and ``depth/KEY.png`` and ``masks/CAMERA.png``.

One file holds one camera model: a dataset of several cameras gets a folder for each, as ``CAMERA/images``.
Poses are from the camera to the world, which stays ours (metres, Z up), in OpenGL's axes: x right, y up,
z back; of the real world relative to an origin, which ``applied_transform`` has, negative. nerfstudio turns,
centres and scales them unless it runs with ``--center-method none --auto-scale-poses False``.

Depth, if all frames have it, is 16-bit PNG in millimetres, 0 for none and where it is inexact: planar for
``pinhole`` cameras, else along the ray, for which depth-nerfacto's ``is_euclidean_depth`` must be set. Masks
are black outside the field of view, and where no recorded view shows a pixel.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.calibration.table import NERFSTUDIO
from omniscv.cameras import Camera
from omniscv.compose.files import write_json
from omniscv.dataset.exporting import Format, PointOptions, register
from omniscv.dataset.formats.numbers import PRESETS, encode
from omniscv.dataset.pictures import copy_lit, without_limit, write_mask, write_pixels
from omniscv.dataset.sequences import by_camera, near_origin
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.truth.point_cloud import inexact

_GL_FROM_CV = np.diag([1.0, -1.0, -1.0])
_SPLITS = ("train", "val", "test")


@register
class Nerfstudio(Format):
    """See the module."""

    name = "nerfstudio"
    needs = ("lit",)
    options = PointOptions

    def refuses(self, camera: Camera) -> str | None:
        try:
            intrinsics(camera)
        except ArgumentError as cause:
            return str(cause)
        return None

    def write(self, frames: Sequence[Frame], out: Path, options: PointOptions) -> list[Path]:
        """Write ``frames`` into ``out``, or of several cameras into a folder there for each.

        ``options`` say from which error on depth is left out.
        """
        origin, frames = near_origin(frames)
        cameras = by_camera(frames)
        transform: dict[str, Any] = {}
        if origin.any():
            transform["applied_transform"] = np.column_stack([np.eye(3), -origin]).tolist()
        written = []
        for camera_name, sequence in cameras.items():
            folder = out if len(cameras) == 1 else out / camera_name
            ordered = sorted(sequence, key=lambda frame: frame.key)
            content = {**intrinsics(ordered[0].camera), "orientation_override": "none", **transform}
            written += _write_camera(ordered, folder, options.max_relative_error, content)
        return written


def intrinsics(camera: Camera) -> dict[str, Any]:
    """Return the fields of ``transforms.json`` of a camera; ArgumentError if nerfstudio has no such."""
    values = dict(NERFSTUDIO.values_of(without_limit(camera)))
    values.pop("frames", None)
    return values


def opengl(pose: Pose) -> list[list[float]]:
    """Return the 4x4 matrix from the camera, in OpenGL's axes, to the world."""
    matrix = np.eye(4)
    matrix[:3, :3] = pose.rotation @ _GL_FROM_CV
    matrix[:3, 3] = pose.position
    matrix += 0.0  # -0.0 becomes 0.0
    values: list[list[float]] = matrix.tolist()
    return values


def _write_camera(
    frames: Sequence[Frame], folder: Path, max_relative: float | None, content: Mapping[str, Any]
) -> list[Path]:
    """Write the files of one camera.

    Args:
        frames: of the camera, at least one, in the order of the file.
        folder: into which they are written.
        max_relative: error of depth, as a part of it, from which on it is left out; None for no limit.
        content: of ``transforms.json``, but for frames and splits.
    """
    camera_mask = write_mask(frames[0].camera.valid(), folder / "masks" / f"{frames[0].camera_name}.png")
    written = [] if camera_mask is None else [camera_mask]
    with_depth = all("depth" in frame.files for frame in frames)
    entries = []
    splits: dict[str, list[str]] = {split: [] for split in _SPLITS}
    for frame in frames:
        paths = {"file_path": copy_lit(frame, folder / "images")}
        if with_depth:
            paths["depth_file_path"] = _write_depth(frame, folder, max_relative)
        mask = camera_mask
        if "unseen" in frame.files:
            mask = write_mask(frame.valid, folder / "masks" / f"{frame.key}.png")
            if mask is not None:
                written.append(mask)
        written += paths.values()
        if mask is not None:
            paths["mask_path"] = mask
        entry: dict[str, Any] = {}
        for key, path in paths.items():
            entry[key] = path.relative_to(folder).as_posix()
        if frame.split in splits:
            splits[frame.split].append(entry["file_path"])
        entries.append({**entry, "transform_matrix": opengl(frame.pose)})
    content = dict(content)
    if any(splits.values()):  # nerfstudio needs all three lists if there is one
        for split, names in splits.items():
            content[f"{split}_filenames"] = names
    distinct = dict.fromkeys(written)  # a camera's only frame has its name, and the mask of both is one file
    return [*distinct, write_json(folder / "transforms.json", {**content, "frames": entries})]


def _write_depth(frame: Frame, folder: Path, max_relative: float | None) -> Path:
    """Write the depth of a frame in millimetres, 0 where it is inexact, and return the path."""
    metres = frame.layer("depth")
    if max_relative is not None:
        metres = np.where(inexact(frame, max_relative), np.float32(0), metres)
    depth, _ = encode(metres, frame.camera, PRESETS["mm"])
    return write_pixels(folder / "depth" / f"{frame.key}.png", depth)
