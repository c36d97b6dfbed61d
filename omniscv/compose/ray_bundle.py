"""Rays that are sampled together: an image's, those of some of its pixels, or directions to points."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from omniscv.compose.footprints import Footprints, ImageFootprints, squares
from omniscv.compose.kernels import Floats
from omniscv.geometry import Array
from omniscv.planning.viewpoints import CameraRays


class RayBundle:
    """Unstructured rays, or those of an image's rows.

    Args:
        directions: (N, 3), any length; NaN where not valid.
        steps: gives (N,) float32, the angle from each ray to the next pixel's, radians; 0 where unknown.
        footprints: gives what the rays' pixels span.
        row: rays in a row of the image; 0 where they are in none.
    """

    def __init__(
        self,
        directions: Array,
        steps: Callable[[], Floats],
        footprints: Callable[[], Footprints],
        row: int = 0,
    ) -> None:
        self._directions, self.footprints, self.row = directions, footprints, row
        self._steps = steps

    @property
    def directions(self) -> Array:
        """(N, 3), any length; NaN where not valid."""
        return self._directions

    @cached_property
    def steps(self) -> Floats:
        """(N,) angle from each ray to the next pixel's, radians; 0 where unknown."""
        return self._steps()

    @cached_property
    def invalid_count(self) -> int:
        """How many rays are not valid."""
        return int(np.count_nonzero(np.isnan(self.directions[:, 0])))


class ImageRays:
    """An image's rays, and what its pixels span.

    Args:
        rays: of the camera.
    """

    def __init__(self, rays: CameraRays) -> None:
        self.camera_rays, self.valid = rays, rays.valid
        self._footprints = ImageFootprints(rays)

    @cached_property
    def whole(self) -> RayBundle:
        """All of the image's rays."""
        directions = self.camera_rays.directions.reshape(-1, 3)
        every = np.arange(self.valid.size)
        return RayBundle(directions, self._steps, lambda: self._footprints.of(every), self.valid.shape[1])

    def of(self, pixels: NDArray[np.int64]) -> RayBundle:
        """Return the rays of (N,) flat pixel indices."""
        directions = self.whole.directions[pixels]
        return RayBundle(directions, lambda: self.whole.steps[pixels], lambda: self._footprints.of(pixels))

    def toward(self, directions: Array, pixels: NDArray[np.int64]) -> RayBundle:
        """Return rays (N, 3) in which pixels are looked up instead of their own; each spans a square."""

        def steps() -> Floats:
            return self.whole.steps[pixels]

        return RayBundle(directions, steps, lambda: squares(directions, steps()))

    @property
    def nbytes(self) -> int:
        """What is held in memory."""
        return self.camera_rays.nbytes

    def _steps(self) -> Floats:
        return np.nan_to_num(self.camera_rays.steps).astype(np.float32).ravel()
