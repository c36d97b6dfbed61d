"""Pictures for other programs: colours, masks, panoramas as six perspective pictures, depth as codes."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import within
from omniscv.cameras import Camera, Pinhole, from_dict
from omniscv.compose.files import write_json, write_layers, write_picture
from omniscv.compose.pictures import uint8_colors
from omniscv.compose.reading import ARRAY
from omniscv.errors import ArgumentError
from omniscv.frame import IMAGE, Frame
from omniscv.frame.files import relative
from omniscv.modalities import Modality
from omniscv.parallel import side_by_side
from omniscv.records import mapping
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json, read_bytes
from omniscv.storage.local import whole_file

_READABLE = (".png", ".jpg", ".jpeg")
_MASK = Modality("mask", ("bool",))

Kind = Literal["planar", "ray"]


def copy_lit(frame: Frame, folder: Path) -> Path:
    """Write a frame's colours into a folder as ``KEY.png``, or as the JPEG they are, and return the file.

    Raises:
        ArgumentError: the frame has no colours.
    """
    lit = frame.files.get("lit")
    suffix = lit.suffix if lit is not None and lit.suffix in _READABLE else ".png"
    return write_color(folder / f"{frame.key}{suffix}", frame)


def write_color(path: Path, frame: Frame) -> Path:
    """Write the colours of a frame as the file's suffix has it, and return the path.

    The frame's file is copied if it has that suffix; floating point 0 to 1 becomes 0 to 255.

    Raises:
        ArgumentError: the frame has no colours.
    """
    lit = frame.files.get("lit")
    if lit is None or lit.suffix != path.suffix:
        return write_pixels(path, uint8_colors(frame.layer("lit")))
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        shutil.copyfile(lit, part)
    return path


def reference(frame: Frame, kind: str, out: Path) -> str:
    """Return the name of a layer's picture as seen from a folder, or its URL.

    An array of the store ``fast`` is written as a picture into the folder's ``images``.
    """
    entry = frame.entries.get(kind)
    if entry is None or not entry.path.endswith(f".{ARRAY}"):
        return frame.reference(kind, out)
    return relative(_write_arrays(frame, [kind], out / "images")[kind], out)


def copy_files(frame: Frame, folder: Path) -> dict[str, Path]:
    """Copy the files of a frame into a folder, and return them by kind; arrays become pictures."""
    arrays = [kind for kind, path in frame.files.items() if path.suffix == f".{ARRAY}"]
    copied = _write_arrays(frame, arrays, folder)
    for kind, path in frame.files.items():
        if kind not in arrays:
            copied[kind] = Path(shutil.copyfile(path, folder / path.name))
    return copied


def _write_arrays(frame: Frame, kinds: Sequence[str], folder: Path) -> dict[str, Path]:
    """Write layers as they would be in the store ``files``."""
    with within(frame.key):
        described = mapping(IMAGE, parse_json(read_bytes(frame.files[IMAGE], MOST_JSON_BYTES)))
    transfer = described.get("transfer", "unknown")
    return write_layers(frame.layers(*kinds), folder, frame.key, transfer=transfer)


def without_limit(camera: Camera) -> Camera:
    """Return a calibrated lens without its limit ``fov_deg``, which its mask holds; others as they are."""
    parameters = camera.to_dict()
    if "fx" not in parameters or "fov_deg" not in parameters:
        return camera
    return from_dict({key: value for key, value in parameters.items() if key != "fov_deg"})


def write_mask(valid: NDArray[np.bool_], path: Path) -> Path | None:
    """Write a mask, black where pixels are not valid; return None if all are."""
    if valid.all():
        return None
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_picture(path, np.asarray(valid), _MASK)


def write_pixels(path: Path, pixels: NDArray[Any]) -> Path:
    """Write uint8 (H, W) or (H, W, 3), or uint16 (H, W), as the file's suffix has it; return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_picture(path, np.ascontiguousarray(pixels), Modality("pixels", (pixels.dtype.name,)))


def write_numbers(
    frames: Sequence[Frame],
    folder: Path,
    encode: Callable[[Frame], tuple[NDArray[Any], Any]],
    description: Mapping[str, Any],
) -> list[Path]:
    """Write a layer of frames as whole numbers: ``KEY.png``, and ``FOLDER.json``, which describes them.

    Args:
        frames: with the layer.
        folder: of the files; made if it is not there.
        encode: returns the pixels of a frame, and what of them is replaced, for the description.
        description: plain values.
    """

    def write(frame: Frame) -> tuple[Path, Any]:
        pixels, replaced = encode(frame)
        return write_pixels(folder / f"{frame.key}.png", pixels), replaced

    folder.mkdir(parents=True, exist_ok=True)
    written = side_by_side(write, frames)
    replaced = {frame.key: counts for frame, (_, counts) in zip(frames, written, strict=True)}
    content = {**description, "replaced": replaced}
    return [*(path for path, _ in written), write_json(folder / f"{folder.name}.json", content)]


@dataclass(frozen=True)
class Preset:
    """How metres become whole numbers.

    Attributes:
        per_metre: steps.
        none: the number that stands for no depth.
        kind: along the camera's axis or along the ray; None: planar for pinholes, else along the ray.
        bits: of a number; 24 are three bytes, the lowest first.
    """

    per_metre: float
    none: int
    kind: Kind | None
    bits: int = 16

    def kind_of(self, camera: Camera) -> Kind:
        """Return the kind of depth for a camera.

        Raises:
            ArgumentError: planar depth of a camera that is no pinhole.
        """
        pinhole = isinstance(camera, Pinhole)
        if self.kind == "planar" and not pinhole:
            raise ArgumentError(
                "scale: expected a preset of depth along the ray (mm, stanford2d3d, tof360) for "
                f"{camera.name}, which has no planar depth"
            )
        return self.kind or ("planar" if pinhole else "ray")


PRESETS = {
    "matterport": Preset(4000, 0, "planar"),
    "stanford2d3d": Preset(512, 65535, None),
    "mm": Preset(1000, 0, None),
    "kitti": Preset(256, 0, "planar"),
    "tum": Preset(5000, 0, "planar"),
    "tof360": Preset(512, 0, "ray"),
    "shift": Preset(2**24 / 1000, 2**24 - 1, "planar", 24),
}


def encode(depth: NDArray[np.float32], camera: Camera, preset: Preset) -> tuple[NDArray[Any], dict[str, int]]:
    """Return depth as a preset's numbers, and how many pixels became none, by reason.

    Half a step is rounded to even. Nothing is clamped: a depth that the numbers cannot hold becomes none.

    Args:
        depth: (H, W) metres along the rays.
        camera: of the image.
        preset: of the numbers.

    Returns:
        pixels, (H, W) uint16 or (H, W, 3) uint8; counts of ``beyond``, ``infinite``, ``outside``.

    Raises:
        ArgumentError: planar depth of a camera that is no pinhole.
    """
    metres = depth.astype(np.float64)
    if preset.kind_of(camera) == "planar":
        metres *= _axis_cosines(camera)
    codes = np.rint(metres * preset.per_metre)
    fits = (codes >= 0) & (codes < 1 << preset.bits) & (codes != preset.none) & (depth > 0)
    codes = np.where(fits, codes, preset.none).astype(np.uint32)
    infinite, outside = np.isposinf(depth), depth == 0
    masks = {"beyond": ~fits & ~infinite & ~outside, "infinite": infinite, "outside": outside}
    pixels = codes.astype(np.uint16)
    if preset.bits == 24:
        pixels = np.stack([codes >> shift & 255 for shift in (0, 8, 16)], axis=-1).astype(np.uint8)
    return pixels, {reason: int(np.count_nonzero(mask)) for reason, mask in masks.items()}


@lru_cache(maxsize=4)
def _axis_cosines(camera: Camera) -> NDArray[np.float64]:
    """(H, W) the cosine between rays and the camera's axis; 0 where not valid."""
    return np.nan_to_num(camera.unproject().directions[..., 2])
