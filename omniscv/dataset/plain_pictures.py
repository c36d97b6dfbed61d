"""Pictures as other programs read them: 8-bit PNG and JPEG, 16-bit grey PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.dataset.frames import Frame

_JPEG_QUALITY = 95


def color(frame: Frame) -> NDArray[np.uint8]:
    """Return (H, W, 3) the colours of a frame, RGB of 8 bits; of floating point, 0 to 1 becomes 0 to 255.

    Raises:
        ArgumentError: the frame has no colours.
    """
    lit = frame.layer("lit")
    if lit.dtype != np.uint8:
        lit = np.round(255 * np.clip(lit, 0, 1)).astype(np.uint8)
    return lit


def write_picture(path: Path, pixels: NDArray[Any]) -> Path:
    """Write uint8 (H, W) or (H, W, 3), or uint16 (H, W), as the file's suffix has it; return the path."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.ascontiguousarray(pixels)).save(path, quality=_JPEG_QUALITY)  # PNG has no quality
    return path
