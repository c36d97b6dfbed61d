"""Pictures as other programs read them: colours and masks in folders of their own."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera, from_dict
from omniscv.compose.files import write_picture
from omniscv.compose.pictures import uint8_colors
from omniscv.frame import Frame
from omniscv.modalities import Modality
from omniscv.storage.local import whole_file

_READABLE = (".png", ".jpg", ".jpeg")
_MASK = Modality("mask", ("bool",))


def copy_lit(frame: Frame, folder: Path) -> Path:
    """Write a frame's colours into a folder as ``KEY.png``, or as the JPEG they are, and return the file.

    Raises:
        ArgumentError: the frame has no colours.
    """
    own = frame.files.get("lit")
    suffix = own.suffix if own is not None and own.suffix in _READABLE else ".png"
    return write_color(folder / f"{frame.key}{suffix}", frame)


def write_color(path: Path, frame: Frame) -> Path:
    """Write the colours of a frame as the file's suffix has it, and return the path.

    The frame's own file is copied where it is of that kind; of floating point, 0 to 1 becomes 0 to 255.

    Raises:
        ArgumentError: the frame has no colours.
    """
    own = frame.files.get("lit")
    if own is None or own.suffix != path.suffix:
        return write_pixels(path, uint8_colors(frame.layer("lit")))
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        shutil.copyfile(own, part)
    return path


def without_limit(camera: Camera) -> Camera:
    """Return a calibrated lens without its limit ``fov_deg``, which its mask holds; others as they are."""
    given = camera.to_dict()
    if "fx" not in given or "fov_deg" not in given:
        return camera
    return from_dict({key: value for key, value in given.items() if key != "fov_deg"})


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
