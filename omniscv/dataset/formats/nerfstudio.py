"""nerfstudio's ``transforms.json``, with ``images/KEY.png``, and ``depth/KEY.png`` and ``masks/CAMERA.png``.

One file holds one camera model: a dataset of several cameras gets a folder for each, as ``CAMERA/images``.
Poses are from the camera to the world, which stays ours (metres, Z up), in OpenGL's axes: x right, y up,
z back; of the real world relative to an origin, which ``applied_transform`` has, negative. nerfstudio turns,
centres and scales them unless it runs with ``--center-method none --auto-scale-poses False``.

Depth, if all frames have it, is 16-bit PNG in millimetres, 0 for none and where it is inexact: planar for
``pinhole`` cameras, else along the ray, for which depth-nerfacto's ``is_euclidean_depth`` must be set. Masks
are black outside the field of view, and where no recorded view shows a pixel.
"""

from collections.abc import Sequence
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
        origin, frames = near_origin(frames)
        cameras = by_camera(frames)
        more = dict[str, Any]()
        if origin.any():
            more["applied_transform"] = np.column_stack([np.eye(3), -origin]).tolist()
        written = []
        for camera_name, mine in cameras.items():
            folder = out if len(cameras) == 1 else out / camera_name
            mine = sorted(mine, key=lambda frame: frame.key)
            written += _write_camera(mine, folder, camera_name, options.max_relative_error, more)
        return written


def intrinsics(camera: Camera) -> dict[str, Any]:
    """Return the fields of ``transforms.json`` of a camera; ArgumentError if nerfstudio has no such."""
    values = NERFSTUDIO.values_of(without_limit(camera))
    return {key: value for key, value in values.items() if key != "frames"}


def opengl(pose: Pose) -> list[list[float]]:
    """Return the 4x4 matrix from the camera, in OpenGL's axes, to the world."""
    matrix = np.eye(4)
    matrix[:3, :3] = pose.rotation @ _GL_FROM_CV
    matrix[:3, 3] = pose.position
    return [[value + 0.0 for value in row] for row in matrix.tolist()]


def _write_camera(
    frames: Sequence[Frame], folder: Path, camera_name: str, max_relative: float | None, more: dict[str, Any]
) -> list[Path]:
    camera = frames[0].camera
    with_depth = all("depth" in frame.files for frame in frames)
    of_camera = write_mask(camera.valid(), folder / "masks" / f"{camera_name}.png")
    written = [] if of_camera is None else [of_camera]
    entries = []
    for frame in frames:
        paths = {"file_path": copy_lit(frame, folder / "images")}
        if with_depth:
            metres = frame.layer("depth")
            if max_relative is not None:
                metres = np.where(inexact(frame, max_relative), np.float32(0), metres)
            depth, _ = encode(metres, camera, PRESETS["mm"])
            paths["depth_file_path"] = write_pixels(folder / "depth" / f"{frame.key}.png", depth)
        mask = of_camera
        if "unseen" in frame.files:
            mask = write_mask(frame.valid, folder / "masks" / f"{frame.key}.png")
            written += [] if mask is None else [mask]
        written += paths.values()
        if mask is not None:
            paths["mask_path"] = mask
        names = {key: path.relative_to(folder).as_posix() for key, path in paths.items()}
        entries.append({**names, "transform_matrix": opengl(frame.pose)})
    content: dict[str, Any] = {**intrinsics(camera), "orientation_override": "none", **more}
    if any(frame.split in _SPLITS for frame in frames):  # nerfstudio needs all three lists if there is one
        files = [(frame.split, entry["file_path"]) for frame, entry in zip(frames, entries, strict=True)]
        for split in _SPLITS:
            content[f"{split}_filenames"] = [file for mine, file in files if mine == split]
    distinct = dict.fromkeys(written)  # a camera's only frame has its name, and the mask of both is one file
    return [*distinct, write_json(folder / "transforms.json", {**content, "frames": entries})]
