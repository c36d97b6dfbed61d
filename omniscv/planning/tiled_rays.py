"""The rays of an image that is too large to hold them all: unprojected again a block of rows at a time."""

from collections.abc import Iterator
from functools import cached_property
from itertools import product

import numpy as np

from omniscv.cameras import Camera
from omniscv.geometry import Array
from omniscv.planning import densities
from omniscv.planning.viewpoints import CameraRays, Frame, RayGroup, unproject

BYTES_PER_RAY = 128
"""What a pixel takes, by measurement, while its ray is unprojected, looked up and sampled."""
_SAMPLED = 64  # pixels along each axis that are tested for rays all around


class TiledRays(CameraRays):
    """The rays of a central camera, of which a block of rows is held at a time.

    What needs all of them at once makes them anew, and does not keep them.

    Args:
        camera: whose.
        tile_bytes: what a block's rays, lookups and footprints may take, all together.
    """

    def __init__(self, camera: Camera, tile_bytes: int) -> None:
        self.camera, self.origins = camera, None
        self._rows = max(1, tile_bytes // (BYTES_PER_RAY * camera.width))
        self.valid = np.empty((camera.height, camera.width), np.bool_)
        for rows in self.blocks():
            self.valid[rows] = np.isfinite(self._unprojected(rows.start, rows.stop)[..., 0])

    def blocks(self) -> Iterator[slice]:
        """Yield blocks of rows that cover the image."""
        for first in range(0, len(self.valid), self._rows):
            yield slice(first, min(first + self._rows, len(self.valid)))

    def around(self, rows: slice) -> tuple[int, Array]:
        """Return the (h, W, 3) rays of a block and of the rows beside it, and the number of the first row."""
        first = max(rows.start - 1, 0)
        return first, self._unprojected(first, min(rows.stop + 1, len(self.valid)))

    def steps_of(self, rows: slice, first: int, around: Array) -> Array:
        """Return the ``steps`` of a block from what :meth:`around` returns."""
        return densities.steps(around)[rows.start - first : rows.stop - first]

    @property
    def directions(self) -> Array:
        """(H, W, 3) unit, camera frame, NaN where not valid; made anew."""
        made = np.empty((*self.valid.shape, 3))
        for rows in self.blocks():
            made[rows] = self._unprojected(rows.start, rows.stop)
        return made

    @property
    def steps(self) -> Array:
        """(H, W) angle in radians from each ray to the next one's; made anew."""
        made = np.empty(self.valid.shape)
        for rows in self.blocks():
            made[rows] = self.steps_of(rows, *self.around(rows))
        return made

    @cached_property
    def frame(self) -> Frame:
        """The view that holds all rays; none does where some lie in each octant."""
        across, down = (
            (np.unique(np.linspace(0, n - 1, _SAMPLED).astype(int)) + 0.5)
            for n in (self.camera.width, self.camera.height)
        )
        found = unproject(self.camera, np.array(list(product(across, down)))[None])
        octants = (found.directions[found.valid] > 0) @ (1, 2, 4)
        if len(np.unique(octants)) == 8:
            return Frame(np.eye(3), np.full(2, np.inf), np.inf)
        return super().frame

    def _unprojected(self, first: int, last: int) -> Array:
        """The (h, W, 3) rays of rows."""
        pixels = np.empty((last - first, self.camera.width, 2))
        pixels[..., 0] = np.arange(self.camera.width) + 0.5
        pixels[..., 1] = np.arange(first, last)[:, None] + 0.5
        return unproject(self.camera, pixels).directions

    def _grouped(self, viewpoints: int | None = None) -> tuple[RayGroup, ...]:
        def parts() -> Iterator[Array]:
            for rows in self.blocks():
                yield self._unprojected(rows.start, rows.stop)[self.valid[rows]]

        pixels = np.flatnonzero(self.valid)
        return (RayGroup(np.zeros(3), pixels, parts),) if len(pixels) else ()

    @property
    def nbytes(self) -> int:
        """What is held in memory."""
        groups = [each for found in list(self._groups.values()) for each in found]
        return self.valid.nbytes + sum(group.pixels.nbytes for group in groups)
