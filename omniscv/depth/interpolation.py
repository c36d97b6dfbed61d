"""Values between the pixels of a picture, for any number of points: bilinear and bicubic.

Bicubic is Catmull and Rom's cubic, which shows straight ramps as they are. cv2.remap's own (a = -0.75,
tables of 1/32 px) bends them by up to a tenth of a pixel. Source: Keys, Cubic convolution interpolation for
digital image processing, 1981, with a = -0.5.
"""

import cv2
import numpy as np

from omniscv.compiled import njit
from omniscv.geometry.arrays import Floats, Pixels, run

LARGEST_PX = 32766
"""Rows and columns that cv2.remap takes."""
_ROW = 1 << 12


def sample_bilinear(picture: Pixels, x: Floats, y: Floats, row: int = 0) -> Pixels:
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
        x, y = (np.pad(points, (0, rows * row - count)) for points in (x, y))
    out = cv2.remap(
        picture, x.reshape(rows, row), y.reshape(rows, row), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=0,
    )  # fmt: skip
    return np.asarray(out.reshape(-1, *picture.shape[2:])[:count])


def sample_bicubic(picture: Pixels, x: Floats, y: Floats) -> Pixels:
    """Return values at points; 0 where the 4 x 4 pixels around a point are not all in the picture.

    Args:
        picture: (H, W, C).
        x, y: of one shape (...); pixel centres at whole numbers.

    Returns:
        (..., C) of the picture's dtype, rounded and clipped to its range where that is of integers.
    """
    out = np.zeros((*x.shape, picture.shape[2]), picture.dtype)
    whole = picture.dtype.kind == "u"
    top = float(np.iinfo(picture.dtype).max) if whole else 0.0
    rows = x.ravel(), y.ravel(), out.reshape(x.size, -1)
    run(_bicubic, rows, picture, whole, top)
    return out


@njit(nogil=True)
def _weights(t: float, w: Floats) -> None:
    w[0] = t * (-0.5 + t * (1.0 - 0.5 * t))
    w[1] = 1.0 + t * t * (-2.5 + 1.5 * t)
    w[2] = t * (0.5 + t * (2.0 - 1.5 * t))
    w[3] = t * t * (-0.5 + 0.5 * t)


@njit(
    "float32[::1], float32[::1], out uint8[:, ::1], uint8[:, :, ::1], bool, float64",
    "float32[::1], float32[::1], out float32[:, ::1], float32[:, :, ::1], bool, float64",
    nogil=True,
)
def _bicubic(x: Floats, y: Floats, out: Pixels, picture: Pixels, whole: bool, top: float) -> None:
    height, width, channels = picture.shape
    across, down = np.empty(4, np.float32), np.empty(4, np.float32)
    for i in range(x.shape[0]):
        c, r = int(np.floor(x[i])), int(np.floor(y[i]))
        if c < 1 or r < 1 or c >= width - 2 or r >= height - 2:
            continue
        _weights(x[i] - c, across)
        _weights(y[i] - r, down)
        for k in range(channels):
            total = np.float32(0.0)
            for j in range(4):
                row = r + j - 1
                total += down[j] * (
                    across[0] * np.float32(picture[row, c - 1, k])
                    + across[1] * np.float32(picture[row, c, k])
                    + across[2] * np.float32(picture[row, c + 1, k])
                    + across[3] * np.float32(picture[row, c + 2, k])
                )
            if whole:
                out[i, k] = min(max(np.rint(total), 0.0), top)
            else:
                out[i, k] = total
