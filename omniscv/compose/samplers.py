"""Values along rays from the views of one optical centre.

A sampler is made for a bundle of rays and the views that were captured; what it needs to sample (the ray
lookup, an atlas and coordinates in it) is made when first used, and kept for every modality and image.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from omniscv.compose.atlas import Atlas, minification
from omniscv.compose.bicubic import sample_bicubic
from omniscv.compose.depth import SampledDepth, sample_depth
from omniscv.compose.directions import normals_from_depth, sample_directions
from omniscv.compose.folding import remap
from omniscv.compose.gutter import FILTER_SUPPORT_PX
from omniscv.compose.kernels import Floats, Ints, Mask, Pixels
from omniscv.compose.label_edges import label_edges
from omniscv.compose.ray_bundle import RayBundle
from omniscv.compose.ray_lookup import RayLookup, look_up
from omniscv.geometry import Array
from omniscv.geometry.surfaces import Precision
from omniscv.modalities import Interpolation
from omniscv.sources.base import View

_SMALLEST_LEVEL = 8  # px: less of a view says nothing
_MINIFIED, _MOST = 2.0, 0.9
_EVERY = 7  # of how many pixels one is tested for minification


class Sampler(Protocol):
    """What composition needs of a sampler; another one may run on another device."""

    def __init__(self, rays: RayBundle, R_w_d: Array, views: Sequence[View]) -> None: ...

    @property
    def unseen(self) -> int:
        """How many valid rays no view sees."""

    @property
    def finer_seen(self) -> NDArray[np.bool_] | None:
        """Which of the finer rays that ``area`` samples a view sees; None where there are none."""

    @property
    def minifies(self) -> bool:
        """Whether most rays' pixels span two pixels of a view or more."""

    def sample(self, filter: str, faces: Sequence[Pixels]) -> Pixels:
        """Return (N, ...) blended values; of the finer rays for ``area``, where there are any."""

    def sample_depth(
        self, filter: str, faces: Sequence[Pixels], precision: Precision, offsets_w: Array | None
    ) -> SampledDepth:
        """Return depth along the rays; see :func:`omniscv.compose.depth.sample_depth`."""

    def label_edges(self, faces: Sequence[Pixels], parallax: Floats | None) -> Mask:
        """Return (N,) whether rays lie at a label boundary; see :mod:`omniscv.compose.label_edges`."""

    def sample_directions(self, filter: str, faces: Sequence[Pixels]) -> Pixels:
        """Return (N, 3) unit vectors; see :mod:`omniscv.compose.directions`."""

    def normals_from_depth(self, faces: Sequence[Pixels]) -> Pixels:
        """Return (N, 3) normals of planes that are fitted to depth; see the same module."""

    @property
    def nbytes(self) -> int:
        """What is held in memory."""


class CpuSampler:
    """Samples with OpenCV and numba.

    Args:
        rays: in a frame d.
        R_w_d: (3, 3) from that frame to the world.
        views: what was captured from the centre, all of one size.
    """

    def __init__(self, rays: RayBundle, R_w_d: Array, views: Sequence[View]) -> None:
        self._rays, self._R_w_d, self._views = rays, R_w_d, tuple(views)
        self._made: dict[str, tuple[Atlas, Floats, Floats]] = {}

    @cached_property
    def lookup(self) -> RayLookup:
        """Of the rays."""
        return look_up(self._rays.directions, self._views, self._R_w_d)

    @cached_property
    def finer_lookup(self) -> RayLookup | None:
        """Of the finer rays."""
        finer = self._rays.finer
        return None if finer is None else look_up(finer.directions, self._views, self._R_w_d)

    @cached_property
    def unseen(self) -> int:
        """How many valid rays no view sees."""
        return int(np.count_nonzero(self.lookup.view < 0)) - self._rays.invalid_count

    @cached_property
    def finer_seen(self) -> NDArray[np.bool_] | None:
        """Which finer rays a view sees."""
        return None if self.finer_lookup is None else self.finer_lookup.view >= 0

    @cached_property
    def minifies(self) -> bool:
        """Whether bilinear interpolation would pass over some of most pixels' footprints."""
        some = np.flatnonzero(self.lookup.view[::_EVERY] >= 0) * _EVERY
        return bool(len(some)) and bool(
            np.quantile(self._spanned(self.lookup, self._rays.steps, some), 1 - _MOST) > _MINIFIED
        )

    def sample(self, filter: str, faces: Sequence[Pixels]) -> Pixels:
        if filter not in self._made:
            self._made[filter] = self._make(filter)
        atlas, x, y = self._made[filter]
        finer = self._rays.finer if filter == "area" else None
        with atlas.picture(faces) as picture:
            if filter == "bicubic":
                return sample_bicubic(picture, x, y)
            return remap(
                picture, x, y, "nearest" if filter == "nearest" else "bilinear", (finer or self._rays).row
            )

    def sample_depth(
        self, filter: str, faces: Sequence[Pixels], precision: Precision, offsets_w: Array | None
    ) -> SampledDepth:
        return sample_depth(faces, self.lookup, self._views, filter == "nearest", precision, offsets_w)

    def label_edges(self, faces: Sequence[Pixels], parallax: Floats | None) -> Mask:
        return label_edges(faces, self.lookup, self._views, parallax)

    def sample_directions(self, filter: str, faces: Sequence[Pixels]) -> Pixels:
        return sample_directions(faces, self.lookup, filter == "nearest")

    def normals_from_depth(self, faces: Sequence[Pixels]) -> Pixels:
        return normals_from_depth(faces, self.lookup, self._views)

    @property
    def nbytes(self) -> int:
        lookups = [self.__dict__.get("lookup"), self.__dict__.get("finer_lookup")]
        held: int = sum(lookup.nbytes for lookup in lookups if lookup is not None)
        for atlas, x, y in list(self._made.values()):
            held += atlas.nbytes + x.nbytes + y.nbytes
        return held

    def _make(self, filter: str) -> tuple[Atlas, Floats, Floats]:
        lookup, steps = self.lookup, None
        if filter == "area":
            finer, finer_lookup = self._rays.finer, self.finer_lookup
            if finer is None or finer_lookup is None:
                steps = self._rays.steps
            else:
                lookup, steps = finer_lookup, finer.steps
            atlas = Atlas(self._views, self._levels(lookup, steps), guttered=True, bicubic=False)
        else:
            if filter == "nearest":
                lookup = _pixel_centers(lookup, self._views[0])
            guttered = filter != "nearest" and lookup.margin < FILTER_SUPPORT_PX
            atlas = Atlas(self._views, range(1), guttered, bicubic=filter == "bicubic")
        return atlas, *atlas.coordinates(lookup, steps)

    def _levels(self, lookup: RayLookup, steps: Floats) -> range:
        """The mip levels that an averaged image samples."""
        seen = np.flatnonzero(lookup.view >= 0)
        if len(seen) == 0:
            return range(1)
        spanned = self._spanned(lookup, steps, seen)
        least, most = (int(np.log2(max(1.0, float(limit)))) for limit in (spanned.min(), spanned.max()))
        smallest = min(self._views[0].width, self._views[0].height)
        while most > 0 and smallest >> most < _SMALLEST_LEVEL:
            most -= 1
        return range(min(least, most, 1), most + 1)

    def _spanned(self, lookup: RayLookup, steps: Floats, some: Ints) -> Array:
        view = self._views[0]
        return np.asarray(
            minification(
                lookup.x[some], lookup.y[some], view.width / 2, view.height / 2, view.focal_px, steps[some]
            )
        )


def _pixel_centers(lookup: RayLookup, view: View) -> RayLookup:
    """The centres of the pixels that rays lie in; remap's own rounding ties to even."""
    x = np.clip(np.floor(lookup.x), 0, view.width - 1) + np.float32(0.5)
    y = np.clip(np.floor(lookup.y), 0, view.height - 1) + np.float32(0.5)
    return RayLookup(lookup.view, x, y, lookup.margin)


SAMPLE: dict[Interpolation, Callable[[Sampler, str, Sequence[Pixels]], Pixels]] = {
    "blended": lambda sampler, filter, faces: sampler.sample(filter, faces),
    "nearest": lambda sampler, filter, faces: sampler.sample("nearest", faces),
    "plane": lambda sampler, filter, faces: sampler.normals_from_depth(faces),
    "direction": lambda sampler, filter, faces: sampler.sample_directions(filter, faces),
}
"""How kinds of modalities are sampled; surfaces by :meth:`Sampler.sample_depth`, which bounds their error."""
