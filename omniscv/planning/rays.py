"""The rays of an image: unprojected once, or, of an image that is too large for that, in blocks of rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera, Viewpoints
from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints
from omniscv.planning import densities
from omniscv.planning.densities import Footprints

BYTES_PER_RAY = 128
"""Memory of a pixel, by measurement, while its ray is unprojected, looked up and sampled."""
_CENTERING_STEPS = 4
_GRAZING = 0.05  # z of a unit ray: nearer to 0 it is as good as behind the view
_SAMPLED = 64  # pixels along each axis that are tested for rays in all octants


@dataclass(frozen=True, eq=False)
class RayGroup:
    """Pixels that share an optical centre.

    Attributes:
        center_c: (3,) camera frame, metres.
        pixels: (N,) int64 flat indices of valid pixels, row-major.
        rays: of the image.
    """

    center_c: Array
    pixels: Ints
    rays: ImageRays

    @property
    def directions(self) -> Array:
        """(N, 3) unit rays of the pixels, camera frame."""
        return np.concatenate([block.directions for block in self.rays.blocks(self.pixels)])

    def blocks(self) -> Iterator[Array]:
        """Yield the rays, (n, 3) each; for a whole image also those of invalid pixels, which are NaN."""
        whole = len(self.pixels) == self.rays.valid_count
        for block in self.rays.blocks(None if whole else self.pixels):
            yield block.directions


Groups = Sequence[RayGroup]


class HoldingView(NamedTuple):
    """The perspective view that holds rays with the least margin.

    Attributes:
        R_c_v: (3, 3) from the view's frame to the camera's.
        half: (2,) tangents from its axis to its sides; infinite where no view holds the rays.
        focal_px: of a view that is fine enough; see :func:`densities.focal_px`.
    """

    R_c_v: Array
    half: Array
    focal_px: float


class ImageRays:
    """The rays of an image's pixels; what is derived from them is made when first used.

    Args:
        camera: the model and its size; a central one where ``block_bytes`` is given.
        block_bytes: memory for rays, lookups and footprints of a block of rows. If the image needs more, rays
            are unprojected block by block whenever they are used. None: the rays are kept.

    Attributes:
        camera: the model and its size.
        origins: (H, W, 3) metres, camera frame; None for a central camera.
        valid: (H, W) bool.
        kept: whether rays are kept, so that there is one block.
    """

    def __init__(self, camera: Camera, block_bytes: int | None = None) -> None:
        self.camera = camera
        height = camera.height
        rows = height if block_bytes is None else max(1, block_bytes // (BYTES_PER_RAY * camera.width))
        self._rows = rows
        self.kept = rows >= height
        self.origins: Array | None = None
        self._groups: dict[int | None, tuple[RayGroup, ...]] = {}
        if self.kept:
            unprojected = densities.unproject(camera, camera.pixels())
            self._directions = unprojected.directions
            self.valid = unprojected.valid
            self.origins = None if camera.central else unprojected.origins
        else:
            self.valid = np.empty((height, camera.width), np.bool_)
            for block in self._row_blocks():
                self.valid[block] = np.isfinite(self._unprojected(block.start, block.stop)[..., 0])

    @property
    def directions(self) -> Array:
        """(H, W, 3) unit, camera frame, NaN where not valid."""
        return self._directions if self.kept else self._unprojected(0, len(self.valid))

    @property
    def steps(self) -> Array:
        """(H, W) angle in radians from each ray to the next one's; see :func:`densities.steps`."""
        if self.kept:
            return self._steps
        steps = np.empty(self.valid.shape)
        for rows in self._row_blocks():
            first, around = self.around(rows)
            steps[rows] = densities.steps(around)[rows.start - first : rows.stop - first]
        return steps

    @cached_property
    def valid_count(self) -> int:
        """How many pixels are valid."""
        return int(np.count_nonzero(self.valid))

    @cached_property
    def _steps(self) -> Array:
        return densities.steps(self._directions, self.origins)

    @cached_property
    def typical_step(self) -> float:
        """The median of ``steps``, radians; 0 without any."""
        steps = self.steps[np.isfinite(self.steps)]
        return float(np.median(steps)) if steps.size else 0.0

    @cached_property
    def face_size(self) -> int:
        """Edge in px of the smallest 90 degree face that loses no detail."""
        return densities.face_size(self.steps)

    @cached_property
    def rim(self) -> densities.Rim:
        """The pixels that the end of the field of view cuts."""
        return densities.rim_of(self.camera, self.valid)

    @cached_property
    def holding_view(self) -> HoldingView:
        """The view, upright in the image, that holds all rays of a central camera."""
        everywhere = HoldingView(np.eye(3), np.full(2, np.inf), np.inf)
        across = _sampled_pixels(self.camera.width)
        down = _sampled_pixels(self.camera.height)
        sample = densities.unproject(self.camera, np.array(list(product(across, down)))[None])
        octants = (sample.directions[sample.valid] > 0) @ (1, 2, 4)
        if len(np.unique(octants)) == 8:  # rays in all of them
            return everywhere
        rays = self.directions[self.valid]
        R_c_v, half = looking(rays, rays.mean(axis=0), np.array([0.0, 1.0, 0.0]))
        if not np.isfinite(half).all():
            return everywhere
        # Off its axis a view samples more finely, by 1 / cos at least.
        return HoldingView(R_c_v, half, densities.focal_px(self.steps[self.valid] / (rays @ R_c_v[:, 2])))

    @cached_property
    def own_viewpoints(self) -> Viewpoints:
        """The pixels' own optical centres: as many as the camera has."""
        if self.origins is None:
            return Viewpoints(np.zeros((1, 3)), np.where(self.valid, 0, -1).astype(np.int32))
        return self.camera.viewpoints()

    @cached_property
    def one_center(self) -> bool:
        """Whether all rays start at one optical centre."""
        return self.origins is None or len(self.own_viewpoints.centers) < 2

    @cached_property
    def scattered(self) -> bool:
        """Whether there are more optical centres than rows and columns: hardly a view serves two pixels."""
        return self.origins is not None and len(self.own_viewpoints.centers) > sum(self.valid.shape)

    def groups(self, viewpoints: int | None = None) -> tuple[RayGroup, ...]:
        """Return the valid pixels by optical centre; centres that serve none are left out.

        Args:
            viewpoints: how many centres a non-central camera is given; one per column or ring if None.
        """
        if viewpoints not in self._groups:
            self._groups[viewpoints] = self._grouped(viewpoints)
        return self._groups[viewpoints]

    def _grouped(self, viewpoints: int | None) -> tuple[RayGroup, ...]:
        if self.origins is None:
            pixels = np.flatnonzero(self.valid)
            return (RayGroup(np.zeros(3), pixels, self),) if len(pixels) else ()
        shared = self.own_viewpoints if viewpoints is None else self.camera.viewpoints(viewpoints)
        order = np.argsort(shared.index, axis=None, kind="stable")
        starts = np.searchsorted(shared.index.ravel()[order], np.arange(len(shared.centers) + 1))
        groups = []
        for number, center_c in enumerate(shared.centers):
            pixels = order[starts[number] : starts[number + 1]]
            if len(pixels):
                groups.append(RayGroup(center_c, pixels, self))
        return tuple(groups)

    def blocks(self, pixels: Ints | None = None, toward: Array | None = None) -> Iterator[RayBlock]:
        """Yield rays in blocks of rows of the image; in one block if rays are kept.

        Args:
            pixels: (N,) flat indices of the pixels; None: all, valid or not.
            toward: (N, 3) directions, of any length, in which the pixels are looked up instead of their own.
        """
        if self.kept:
            yield RayBlock(self, slice(0, len(self.valid)), slice(None), pixels, toward)
            return
        width = self.camera.width
        for rows in self._row_blocks():
            start = rows.start * width
            stop = rows.stop * width
            if pixels is None:
                yield RayBlock(self, rows, slice(start, stop))
            else:
                part = np.flatnonzero((pixels >= start) & (pixels < stop))
                if len(part):
                    yield RayBlock(self, rows, part, pixels[part], None if toward is None else toward[part])

    def around(self, rows: slice) -> tuple[int, Array]:
        """Return a row's number, and the rays (h, W, 3) from there on: of some rows and those beside them."""
        if self.kept:
            return 0, self._directions
        first = max(rows.start - 1, 0)
        return first, self._unprojected(first, min(rows.stop + 1, len(self.valid)))

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        arrays = [self.valid, self.origins, self.__dict__.get("_steps")]
        arrays += [self._directions] if self.kept else []
        if "own_viewpoints" in self.__dict__:
            arrays += [self.own_viewpoints.centers, self.own_viewpoints.index]
        for groups in list(self._groups.values()):
            arrays += [group.pixels for group in groups]
        return sum(array.nbytes for array in arrays if array is not None)

    def _row_blocks(self) -> Iterator[slice]:
        height = self.camera.height
        for first in range(0, height, self._rows):
            yield slice(first, min(first + self._rows, height))

    def _unprojected(self, first: int, last: int) -> Array:
        """Return the (h, W, 3) rays of rows."""
        pixels = np.empty((last - first, self.camera.width, 2))
        pixels[..., 0] = np.arange(self.camera.width) + 0.5
        pixels[..., 1] = np.arange(first, last)[:, None] + 0.5
        return densities.unproject(self.camera, pixels).directions


class RayBlock:
    """Rays that are looked up together: those of rows of an image, or of some pixels there.

    Args:
        image: the image's rays.
        rows: of the image.
        part: where the block's rays lie among all that are looked up.
        pixels: (N,) flat indices, all in ``rows``; None: all pixels there.
        toward: (N, 3) directions in which the pixels are looked up; None: their own rays.

    Attributes:
        kept: whether it holds all rays that are looked up.
        row: rays in a row of the image; 0 where they are in none.
    """

    def __init__(
        self,
        image: ImageRays,
        rows: slice,
        part: slice | Ints,
        pixels: Ints | None = None,
        toward: Array | None = None,
    ) -> None:
        self._image = image
        self._rows = rows
        self.part = part
        self._pixels = pixels
        self._toward = toward
        self.kept = image.kept
        self.row = image.camera.width if pixels is None else 0

    @cached_property
    def _around(self) -> tuple[int, Array]:
        return self._image.around(self._rows)

    @cached_property
    def directions(self) -> Array:
        """(N, 3), of any length; NaN where not valid."""
        if self._toward is not None:
            return self._toward
        first, around = self._around
        return self._of_rows(around[self._rows.start - first : self._rows.stop - first].reshape(-1, 3))

    def steps(self, chosen: Ints | slice) -> Floats:
        """Return the angle from the ``chosen`` rays to the next pixel's, radians; 0 where unknown."""
        first, around = self._around
        steps = self._image.steps if self.kept else densities.steps(around)
        steps = self._of_rows(steps[self._rows.start - first : self._rows.stop - first].reshape(-1))
        return np.nan_to_num(steps[chosen]).astype(np.float32)

    @property
    def first(self) -> int:
        """The number of the first ray among all that are looked up."""
        return int(self.part.start or 0) if isinstance(self.part, slice) else int(self.part[0])

    @property
    def invalid_count(self) -> int:
        """How many rays are not valid."""
        if self._toward is not None:
            return int(np.count_nonzero(np.isnan(self._toward[:, 0])))
        return int(np.count_nonzero(~self._of_rows(self._image.valid[self._rows].reshape(-1))))

    def footprints(self) -> Footprints:
        """Return what the rays' pixels span; a square where rays are not the pixels' own."""
        if self._toward is not None:
            return densities.squares(self._toward, self.steps(slice(None)))
        first, around = self._around
        pixels = self._pixels
        width = around.shape[1]
        if pixels is None:
            pixels = np.arange(self._rows.start * width, self._rows.stop * width)
        return densities.footprints_of(pixels, around, first * width, self._image.rim)

    def _of_rows(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the block's pixels, of those of all pixels in its rows."""
        if self._pixels is None:
            return values
        return np.asarray(values[self._pixels - self._rows.start * self._image.camera.width])


def _sampled_pixels(count: int) -> Array:
    """Return the middles of pixels along an axis of an image, at most ``_SAMPLED`` of them."""
    return np.unique(np.linspace(0, count - 1, _SAMPLED).astype(int)) + 0.5


def looking(rays: Array, toward: Array, axis: Array, steps: int = _CENTERING_STEPS) -> tuple[Array, Array]:
    """Return R_w_c of a view with rays in its middle, and the tangents that hold them; infinite if none does.

    Args:
        rays: (N, 3) unit.
        toward: (3,) about their middle.
        axis: (3,) the view's y axis, as near as its middle allows.
        steps: how often the middle is found again.
    """
    half = np.full(2, np.inf)
    R_w_c = np.eye(3)
    for _ in range(steps):
        if np.linalg.norm(toward) < 1e-9:  # rays all around: no direction is their middle
            break
        z = toward / np.linalg.norm(toward)
        x = cross(axis, z)
        if np.linalg.norm(x) < 1e-9:  # looking along the axis: any row will do
            x = cross(np.eye(3)[np.argmin(np.abs(z))], z)
        x /= np.linalg.norm(x)
        R_w_c = np.stack([x, cross(z, x), z], axis=1)
        seen = rays @ R_w_c
        if (seen[:, 2] <= _GRAZING).any():
            return R_w_c, np.full(2, np.inf)
        xy = seen[:, :2] / seen[:, 2:]
        low = xy.min(axis=0)
        high = xy.max(axis=0)
        half = np.maximum(-low, high)
        toward = R_w_c @ np.append((low + high) / 2, 1.0)
    return R_w_c, half


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of two vectors a and b, (3,) each; numpy.cross takes ten times as long."""
    (ax, ay, az) = a.tolist()
    (bx, by, bz) = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
