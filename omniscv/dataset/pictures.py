"""Pictures as other programs read them: colours and masks in folders of their own."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.compose.files import whole_file, write_picture
from omniscv.dataset.frames import Frame
from omniscv.errors import ArgumentError
from omniscv.modalities import Modality

_READABLE = (".png", ".jpg", ".jpeg")
_MASK = Modality("mask", ("bool",))


def copy_lit(frame: Frame, folder: Path) -> Path:
    """Copy a frame's colours into a folder as ``KEY.SUFFIX``, and return the file.

    Raises:
        ArgumentError: the frame has no colours, or not as PNG or JPEG.
    """
    if "lit" not in frame.files:
        raise ArgumentError(f"{frame.key}: expected a frame with lit, it has none; make it with mode lit")
    source = frame.files["lit"]
    if source.suffix not in _READABLE:
        raise ArgumentError(f"{frame.key}: expected colours as PNG or JPEG, got {source.name}")
    return write_color(folder / f"{frame.key}{source.suffix}", frame)


def write_color(path: Path, frame: Frame) -> Path:
    """Write the colours of a frame as the file's suffix has it, and return the path.

    The frame's own file is copied where it is of that kind; of floating point, 0 to 1 becomes 0 to 255.

    Raises:
        ArgumentError: the frame has no colours.
    """
    own = frame.files.get("lit")
    if own is None or own.suffix != path.suffix:
        lit = frame.layer("lit")
        return write_pixels(
            path, lit if lit.dtype == np.uint8 else np.round(255 * np.clip(lit, 0, 1)).astype(np.uint8)
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        shutil.copyfile(own, part)
    return path


def write_mask(camera: Camera, path: Path) -> Path | None:
    """Write a mask, black outside the field of view; return None where every pixel is inside."""
    valid = camera.valid()
    if valid.all():
        return None
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_picture(path, np.asarray(valid), _MASK)


def write_pixels(path: Path, pixels: NDArray[Any]) -> Path:
    """Write uint8 (H, W) or (H, W, 3), or uint16 (H, W), as the file's suffix has it; return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_picture(path, np.ascontiguousarray(pixels), Modality("pixels", (pixels.dtype.name,)))
