"""The rays that an image is sampled along: one a pixel, or on a grid twice as fine, to average over."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.geometry import Array
from omniscv.plan import sampling
from omniscv.plan.groups import rays_of

_KERNEL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
"""cv2.pyrDown's."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Rays of a camera.

    Attributes:
        directions: (H, W, 3) camera frame, NaN where not valid.
        valid: (H, W) bool.
        steps: (H, W) float32, angle from a pixel's ray to the next, radians; 0 where unknown.
        fine: whether this is the finer grid: (2H - 1, 2W - 1), every other ray a pixel's own.
    """

    directions: Array
    valid: NDArray[np.bool_]
    steps: NDArray[np.float32]
    fine: bool

    @classmethod
    def of(cls, camera: Camera) -> Grid:
        """One ray a pixel."""
        rays = rays_of(camera)
        steps = np.nan_to_num(sampling.steps(rays)).astype(np.float32)
        return cls(rays.directions, rays.valid, steps, fine=False)

    @classmethod
    def finer(cls, camera: Camera, coarse: Grid) -> Grid:
        """The rays of a camera's pixels, and those halfway to the next row and column."""
        u, v = (0.5 + np.arange(2 * n - 1) / 2 for n in (camera.width, camera.height))
        rays = camera.unproject(np.stack(np.meshgrid(u, v), axis=-1))
        return cls(rays.directions, rays.valid, _doubled(coarse.steps), fine=True)

    def pixels(self, own: NDArray[np.int64], width: int) -> NDArray[np.int64]:
        """Flat indices in this grid of the rays that belong to pixels of the image.

        Args:
            own: (N,) flat indices of pixels.
            width: of the image.
        """
        if not self.fine:
            return own
        row, column = np.divmod(own, width)
        height, wide = self.valid.shape
        all_rows, all_columns = (
            np.add.outer(2 * at, (0, 0, 1, 1) if axis == 0 else (0, 1, 0, 1)).ravel()
            for axis, at in enumerate((row, column))
        )
        inside = (all_rows < height) & (all_columns < wide)
        return np.asarray(all_rows[inside] * wide + all_columns[inside])


def averaged(values: NDArray, seen: NDArray[np.bool_]) -> NDArray:  # type: ignore[type-arg]
    """Values on a finer grid, averaged to one a pixel with binomial weights over two pixels each way.

    Args:
        values: (2H - 1, 2W - 1, C), 0 where not seen.
        seen: (2H - 1, 2W - 1); what is not seen has no weight.

    Returns:
        (H, W, C) of the same dtype; pixels whose own ray is not seen are 0.
    """
    height, width = (seen.shape[0] + 1) // 2, (seen.shape[1] + 1) // 2
    out = np.asarray(cv2.pyrDown(values, dstsize=(width, height)))
    own = seen[::2, ::2]
    if seen.all():
        return out
    weight = cv2.pyrDown(seen.astype(np.float32), dstsize=(width, height))
    row, column = np.nonzero(own & (weight < 1 - 1e-6))
    total, share = np.zeros((len(row), values.shape[2])), np.zeros((len(row), 1))
    for i, down in enumerate(_KERNEL):
        for j, across in enumerate(_KERNEL):
            r, c = 2 * row + i - 2, 2 * column + j - 2
            inside = (r >= 0) & (c >= 0) & (r < seen.shape[0]) & (c < seen.shape[1])
            r, c = np.where(inside, r, 0), np.where(inside, c, 0)
            part = (down * across * (inside & seen[r, c]))[:, None]
            total += part * values[r, c]
            share += part
    mean = total / share
    out[row, column] = np.rint(mean) if out.dtype.kind == "u" else mean
    out[~own] = 0
    return out


def _doubled(coarse: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)[:-1, :-1]
