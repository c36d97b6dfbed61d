"""cv2.remap for any number of points: it takes no row, nor picture, of 32767 px or more."""

import cv2
import numpy as np

from omniscv.compose.kernels import Floats, Pixels

LARGEST_PX = 32766
_ROW = 1 << 12


def remap(picture: Pixels, x: Floats, y: Floats, row: int = 0) -> Pixels:
    """Return values at points, bilinear between pixels; 0 outside the picture.

    Args:
        picture: (H, W) or (H, W, C).
        x, y: (N,) pixel centres at whole numbers.
        row: how many points lie in a row of the image, so that neighbours are read together; 0: any.

    Returns:
        (N,) or (N, C) of the picture's dtype.
    """
    count = len(x)
    if not 0 < row <= LARGEST_PX:
        row = min(_ROW, max(1, count))
    rows = -(-count // row)
    if rows * row != count:
        x, y = (np.pad(each, (0, rows * row - count)) for each in (x, y))
    out = cv2.remap(
        picture, x.reshape(rows, row), y.reshape(rows, row), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=0,
    )  # fmt: skip
    return np.asarray(out.reshape(-1, *picture.shape[2:])[:count])
