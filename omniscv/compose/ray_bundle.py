"""Rays that are sampled together: an image's, those of some of its pixels, or directions to points."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array
from omniscv.planning.viewpoints import CameraRays, unproject

_KERNEL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
"""cv2.pyrDown's."""


class RayBundle:
    """Unstructured rays, or those of an image's rows.

    Args:
        directions: (N, 3), any length; NaN where not valid.
        steps: gives (N,) float32, the angle from each ray to the next pixel's, radians; 0 where unknown.
        row: rays in a row of the image; 0 where they are in none.
        finer: gives the rays of a grid twice as fine, to average over; None where there is no such grid.
    """

    def __init__(
        self,
        directions: Array,
        steps: Callable[[], NDArray[np.float32]],
        row: int = 0,
        finer: Callable[[], RayBundle] | None = None,
    ) -> None:
        self.directions, self.row = directions, row
        self._steps, self._finer = steps, finer

    @cached_property
    def steps(self) -> NDArray[np.float32]:
        """(N,) angle from each ray to the next pixel's, radians; 0 where unknown."""
        return self._steps()

    @cached_property
    def invalid_count(self) -> int:
        """How many rays are not valid."""
        return int(np.count_nonzero(np.isnan(self.directions[:, 0])))

    @cached_property
    def finer(self) -> RayBundle | None:
        """The rays of a grid twice as fine."""
        return None if self._finer is None else self._finer()


class ImageRays:
    """An image's rays, and those of a grid twice as fine: the pixels' own, and those halfway to the next row
    and column.

    Args:
        rays: of the camera.
    """

    def __init__(self, rays: CameraRays) -> None:
        self.camera_rays = self._rays = rays
        self.valid = rays.valid

    @cached_property
    def whole(self) -> RayBundle:
        """All of the image's rays."""
        return RayBundle(
            self._rays.directions.reshape(-1, 3),
            lambda: self._steps.ravel(),
            self.valid.shape[1],
            lambda: self._finer,
        )

    def of(self, pixels: NDArray[np.int64]) -> RayBundle:
        """Return the rays of (N,) flat pixel indices, and of the finer grid those that belong to them."""

        def finer() -> RayBundle:
            mine = self.finer_pixels(pixels)
            return RayBundle(self._finer.directions[mine], lambda: self._finer.steps[mine])

        return RayBundle(self.whole.directions[pixels], lambda: self.whole.steps[pixels], finer=finer)

    def toward(self, directions: Array, pixels: NDArray[np.int64]) -> RayBundle:
        """Return rays (N, 3) in which pixels are looked up instead of their own."""
        return RayBundle(directions, lambda: self.whole.steps[pixels])

    def finer_pixels(self, pixels: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return flat indices in the finer grid of the rays that belong to (N,) pixels of the image."""
        row, column = np.divmod(pixels, self.valid.shape[1])
        height, width = self.finer_shape
        rows, columns = (
            np.add.outer(2 * at, (0, 0, 1, 1) if axis == 0 else (0, 1, 0, 1)).ravel()
            for axis, at in enumerate((row, column))
        )
        inside = (rows < height) & (columns < width)
        return np.asarray(rows[inside] * width + columns[inside])

    @property
    def finer_shape(self) -> tuple[int, int]:
        """Rows and columns of the finer grid."""
        height, width = self.valid.shape
        return 2 * height - 1, 2 * width - 1

    @property
    def nbytes(self) -> int:
        """What is held in memory beside the camera's rays."""
        finer = self.__dict__.get("_finer")
        return self._rays.nbytes + (0 if finer is None else finer.directions.nbytes)

    @cached_property
    def _steps(self) -> NDArray[np.float32]:
        return np.nan_to_num(self._rays.steps).astype(np.float32)

    @cached_property
    def _finer(self) -> RayBundle:
        u, v = (0.5 + np.arange(n) / 2 for n in self.finer_shape[::-1])
        rays = unproject(self._rays.camera, np.stack(np.meshgrid(u, v), axis=-1))
        steps = np.repeat(np.repeat(self._steps, 2, axis=0), 2, axis=1)[:-1, :-1]
        return RayBundle(rays.directions.reshape(-1, 3), steps.ravel, self.finer_shape[1])


def average(values: NDArray[Any], seen: NDArray[np.bool_]) -> NDArray[Any]:
    """Return values on a finer grid averaged to one a pixel, with binomial weights over two pixels each way.

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
