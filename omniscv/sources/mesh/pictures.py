"""Pictures on faces: decoded in memory, within bounds."""

import io
import warnings

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from omniscv.errors import ArgumentError

MOST_PIXELS = 1 << 28
"""Of all pictures of a file: a gibibyte of memory."""
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF")


class Pictures:
    """Decoder of the pictures of one file, which have :data:`MOST_PIXELS` together."""

    def __init__(self) -> None:
        self._remaining = MOST_PIXELS

    def read(self, data: bytes, where: str) -> NDArray[np.uint8]:
        """Return (H, W, 4) uint8, sRGB and alpha; ArgumentError for bytes that are no whole picture."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # bounded here
                with Image.open(io.BytesIO(data), formats=_FORMATS) as picture:
                    width, height = picture.size
                    self._take(width * height, where)
                    return np.array(picture.convert("RGBA"))
        except (
            UnidentifiedImageError,
            OSError,
            ValueError,
            SyntaxError,
            Image.DecompressionBombError,
        ) as cause:
            raise ArgumentError(f"{where}: expected a picture, got: {str(cause)[:80]}") from cause

    def _take(self, pixels: int, where: str) -> None:
        """Count the pixels of a picture before it is decoded."""
        if pixels > self._remaining:
            raise ArgumentError(
                f"{where}: expected pictures of at most {MOST_PIXELS} pixels in all, got more"
            )
        self._remaining -= pixels
