"""The rays that an image is sampled along: one a pixel, or on a grid twice as fine, to average over."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.plan import sampling
from omniscv.plan.groups import rays_of, unproject

_KERNEL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
"""cv2.pyrDown's."""


class Grid:
    """Rays of a camera.

    Args:
        camera: whose.
        fine: a grid twice as fine, (2H - 1, 2W - 1): the pixels' rays, and those halfway to the next row
            and column. Else one ray a pixel, (H, W).

    Attributes:
        directions: (h, w, 3) camera frame, NaN where not valid.
        valid: (h, w) bool.
    """

    def __init__(self, camera: Camera, fine: bool = False) -> None:
        self._camera, self.fine = camera, fine
        if fine:
            u, v = (0.5 + np.arange(2 * n - 1) / 2 for n in (camera.width, camera.height))
            rays = unproject(camera, np.stack(np.meshgrid(u, v), axis=-1))
        else:
            rays = rays_of(camera)
        self.directions, self.valid = rays.directions, rays.valid

    @cached_property
    def steps(self) -> NDArray[np.float32]:
        """(h, w) angle from a pixel's ray to the next pixel's, radians; 0 where unknown."""
        steps = np.nan_to_num(sampling.steps(rays_of(self._camera))).astype(np.float32)
        return np.repeat(np.repeat(steps, 2, axis=0), 2, axis=1)[:-1, :-1] if self.fine else steps

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
