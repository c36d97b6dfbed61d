"""Arrays of pixels and vectors: grids, parts, and rows that do not count."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def grid_axes(pixels: Array) -> tuple[Array, Array]:
    """u and v of pixels (..., 2); of a grid (H, W, 2), one row (1, W) of u and one column (H, 1) of v."""
    u, v = pixels[..., 0], pixels[..., 1]
    if pixels.ndim == 3 and (u == u[:1]).all() and (v == v[:, :1]).all():
        return u[:1], v[:, :1]
    return u, v


def vectors(x: Array, y: Array, z: Array) -> Array:
    """(..., 3) the vectors of these parts, which may be the rows and columns of a grid."""
    parts = np.empty((*np.broadcast_shapes(x.shape, y.shape, z.shape), 3))
    parts[..., 0], parts[..., 1], parts[..., 2] = x, y, z
    return parts


def replaced(keep: Mask, rows: Array, instead: ArrayLike) -> Array:
    """``rows`` (..., n), and ``instead`` where ``keep`` (...) is False; no copy where all are kept."""
    return rows if keep.all() else np.where(keep[..., None], rows, instead)


def blanked(rows: Array, keep: Mask) -> Array:
    """``rows`` (..., 3), an array that nothing else uses, with NaN where ``keep`` (...) is False."""
    if not keep.all():
        from omniscv.cameras import kernels  # slow to load

        rows = np.require(rows, requirements=("C", "W"))
        kernels.blank(rows.reshape(-1, 3), keep.reshape(-1))
    return rows
