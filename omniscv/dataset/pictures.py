"""Pictures for other programs: colours, masks, and panoramas as six perspective pictures."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera, from_dict
from omniscv.compose.files import write_json, write_picture
from omniscv.compose.pictures import uint8_colors
from omniscv.frame import Frame
from omniscv.modalities import Modality
from omniscv.parallel import side_by_side
from omniscv.storage.local import whole_file

_READABLE = (".png", ".jpg", ".jpeg")
_MASK = Modality("mask", ("bool",))


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


def without_limit(camera: Camera) -> Camera:
    """Return a calibrated lens without its limit ``fov_deg``, which its mask holds; others as they are."""
    parameters = camera.to_dict()
    if "fx" not in parameters or "fov_deg" not in parameters:
        return camera
    return from_dict({key: value for key, value in parameters.items() if key != "fov_deg"})


def write_mask(camera: Camera, path: Path) -> Path | None:
    """Write a mask, black outside the field of view; return None if every pixel is inside."""
    valid = camera.valid()
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
