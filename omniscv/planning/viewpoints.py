"""A camera's rays, unprojected once, and its pixels grouped by the optical centre that they share."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera, Rays, Viewpoints
from omniscv.geometry import Array
from omniscv.parallel import blocks
from omniscv.planning import densities
from omniscv.planning.strip_views import looking


@dataclass(frozen=True, eq=False)
class RayGroup:
    """Pixels that share an optical centre.

    Attributes:
        center_c: (3,) camera frame, metres.
        pixels: (N,) int64 flat indices of valid pixels, row-major.
        parts: gives their unit rays, camera frame, in (n, 3) parts that are all of them together.
    """

    center_c: Array
    pixels: NDArray[np.int64]
    parts: Callable[[], Iterable[Array]]

    @property
    def directions(self) -> Array:
        """(N, 3) their unit rays, camera frame."""
        first, *others = self.parts()
        return np.concatenate([first, *others]) if others else first


Groups = Sequence[RayGroup]


class Frame(NamedTuple):
    """The perspective view that holds rays with the least margin.

    Attributes:
        R_c_v: (3, 3) from the view's frame to the camera's.
        half: (2,) tangents from its axis to its sides; infinite where no view holds the rays.
        focal_px: of a view that is fine enough; see :func:`densities.focal_px`.
    """

    R_c_v: Array
    half: Array
    focal_px: float


class CameraRays:
    """The rays of a camera's pixels; what is derived from them is made when first used, and kept.

    Attributes:
        camera: whose.
        origins: (H, W, 3) metres, camera frame; None for a central camera.
        valid: (H, W) bool.
    """

    def __init__(self, camera: Camera) -> None:
        rays = unproject(camera, camera.pixels())
        self.camera, self._directions, self.valid = camera, rays.directions, rays.valid
        self.origins = None if camera.central else rays.origins

    @property
    def directions(self) -> Array:
        """(H, W, 3) unit, camera frame, NaN where not valid."""
        return self._directions

    @cached_property
    def _groups(self) -> dict[int | None, tuple[RayGroup, ...]]:
        return {}

    @cached_property
    def steps(self) -> Array:
        """(H, W) angle in radians from each ray to the next one's; see :func:`densities.steps`."""
        return densities.steps(self.directions, self.origins)

    @cached_property
    def typical_step(self) -> float:
        """The median of ``steps``, radians; 0 without any."""
        steps = self.steps[np.isfinite(self.steps)]
        return float(np.median(steps)) if steps.size else 0.0

    @cached_property
    def frame(self) -> Frame:
        """The view, upright in the image, that holds all rays of a central camera."""
        rays = self.directions[self.valid]
        R_c_v, half = looking(rays, rays.mean(axis=0), np.array([0.0, 1.0, 0.0]))
        if not np.isfinite(half).all():
            return Frame(R_c_v, half, np.inf)
        # Off its axis a view samples more finely, by 1 / cos at least.
        return Frame(R_c_v, half, densities.focal_px(self.steps[self.valid] / (rays @ R_c_v[:, 2])))

    @cached_property
    def face_size(self) -> int:
        """Edge in px of the smallest 90 degree face that loses no detail."""
        return densities.face_size(self.steps)

    @cached_property
    def own(self) -> Viewpoints:
        """The pixels' own optical centres: as many as the camera has."""
        if self.origins is None:
            return Viewpoints(np.zeros((1, 3)), np.where(self.valid, 0, -1).astype(np.int32))
        return self.camera.viewpoints()

    @cached_property
    def scattered(self) -> bool:
        """Whether there are more optical centres than rows and columns: hardly a view serves two pixels."""
        return self.origins is not None and len(self.own.centers) > sum(self.valid.shape)

    def groups(self, viewpoints: int | None = None) -> tuple[RayGroup, ...]:
        """The valid pixels by optical centre; centres that serve none are left out.

        Args:
            viewpoints: how many centres a non-central camera is given; one per column or ring if None.
        """
        found = self._groups.get(viewpoints)
        if found is None:
            found = self._grouped(viewpoints)
            self._groups = {viewpoints: found}  # one at a time: they hold copies of the rays
        return found

    def _grouped(self, viewpoints: int | None) -> tuple[RayGroup, ...]:
        shared = self.own if viewpoints is None else self.camera.viewpoints(viewpoints)
        directions = self.directions.reshape(-1, 3)
        if len(shared.centers) == 1:
            pixels = np.flatnonzero(self.valid)
            mine = directions if len(pixels) == len(directions) else directions[pixels]
            return (ray_group(shared.centers[0], pixels, mine),) if len(pixels) else ()
        order = np.argsort(shared.index, axis=None, kind="stable")
        starts = np.searchsorted(shared.index.ravel()[order], np.arange(len(shared.centers) + 1))
        return tuple(
            ray_group(center_c, order[start:end], directions[order[start:end]])
            for center_c, start, end in zip(shared.centers, starts[:-1], starts[1:], strict=True)
            if end > start
        )

    @property
    def nbytes(self) -> int:
        """What is held in memory."""
        arrays = [self.directions, self.valid, self.origins, self.__dict__.get("steps")]
        if "own" in self.__dict__:
            arrays += [self.own.centers, self.own.index]
        for groups in list(self._groups.values()):
            arrays += [each for group in groups for each in (group.pixels, group.directions)]
        return sum(array.nbytes for array in arrays if array is not None)


def ray_group(center_c: Array, pixels: NDArray[np.int64], directions: Array) -> RayGroup:
    """Return a group of pixels whose rays are held."""
    return RayGroup(center_c, pixels, lambda: (directions,))


def unproject(camera: Camera, pixels: Array) -> Rays:
    """The rays of (H, W, 2) pixels, computed in blocks of rows on all cores; row-major, because they are
    looked up by flat indices again and again. A central camera's origins are 0 where not valid, too."""
    shape = pixels.shape[:-1]
    whole = Rays(np.zeros((*shape, 3)), np.empty((*shape, 3)), np.empty(shape, np.bool_))

    def fill(rows: slice) -> None:
        part = camera.unproject(pixels[rows])
        whole.directions[rows], whole.valid[rows] = part.directions, part.valid
        if not camera.central:  # memory of zeros that nobody writes takes no time
            whole.origins[rows] = part.origins

    blocks(fill, len(pixels), pixels[..., 0].size)
    return whole
