"""Pictures as other programs read them: 8-bit PNG and JPEG, 16-bit grey PNG."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.dataset.frames import Frame

_JPEG_QUALITY = 95
_PNG_COMPRESSION = 2


def write_color(path: Path, frame: Frame) -> Path:
    """Write the colours of a frame as the file's suffix has it, and return the path.

    The frame's own file is copied where it is of that kind; of floating point, 0 to 1 becomes 0 to 255.

    Raises:
        ArgumentError: the frame has no colours.
    """
    own = frame.files.get("lit")
    if own is not None and own.suffix == path.suffix:
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(own, path)
        return path
    lit = frame.layer("lit")
    if lit.dtype != np.uint8:
        lit = np.round(255 * np.clip(lit, 0, 1)).astype(np.uint8)
    return write_picture(path, lit)


def write_picture(path: Path, pixels: NDArray[Any]) -> Path:
    """Write uint8 (H, W) or (H, W, 3), or uint16 (H, W), as the file's suffix has it; return the path."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    # Each of both options is for one of the suffixes.
    image = Image.fromarray(np.ascontiguousarray(pixels))
    image.save(path, quality=_JPEG_QUALITY, compress_level=_PNG_COMPRESSION)
    return path
