"""Values along rays from the views of one optical centre.

A sampler is made for a bundle of rays and the views that were captured; what it needs to sample (the ray
lookup, an atlas and coordinates in it) is made when first used, and kept for every modality and image.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from omniscv.compose.area import AreaSampling
from omniscv.compose.atlas import Atlas
from omniscv.compose.bicubic import sample_bicubic
from omniscv.compose.depth import SampledDepth, sample_depth
from omniscv.compose.directions import normals_from_depth, sample_directions
from omniscv.compose.folding import remap
from omniscv.compose.gutter import FILTER_SUPPORT_PX
from omniscv.compose.kernels import Floats, Mask, Pixels
from omniscv.compose.label_edges import label_edges
from omniscv.compose.nearest import sample_nearest
from omniscv.compose.ray_bundle import RayBundle
from omniscv.compose.ray_lookup import RayLookup, look_up
from omniscv.geometry import Array
from omniscv.geometry.surfaces import Precision
from omniscv.modalities import Interpolation
from omniscv.sources.base import View

_MINIFIED, _MOST = 2.0, 0.9
_EVERY = 7  # of how many pixels one is tested for minification


class Sampler(Protocol):
    """What composition needs of a sampler; another one may run on another device."""

    def __init__(self, rays: RayBundle, R_w_d: Array, views: Sequence[View]) -> None: ...

    @property
    def unseen(self) -> int:
        """How many valid rays no view sees."""

    @property
    def minifies(self) -> bool:
        """Whether most rays' pixels span two pixels of a view or more."""

    def sample(self, filter: str, faces: Sequence[Pixels]) -> Pixels:
        """Return (N, ...) blended values."""

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


class PointSampling:
    """Samples an atlas at one point a ray.

    Args:
        filter: ``bilinear`` or ``bicubic``.
        lookup: of N rays.
        views: all of one size.
        row: rays in a row of the image; 0 where they are in none.
        atlas: of the views; made for the rays if not given.
    """

    def __init__(
        self, filter: str, lookup: RayLookup, views: Sequence[View], row: int, atlas: Atlas | None = None
    ) -> None:
        self._filter, self._row = filter, row
        self._atlas = atlas or point_atlas(filter, lookup.margin, views)
        self._x, self._y = self._atlas.coordinates(lookup)

    def sample(self, faces: Sequence[Pixels]) -> Pixels:
        """Return (N, ...) values of the views' pixels."""
        with self._atlas.picture(faces) as picture:
            return self.read(picture)

    def read(self, picture: Pixels) -> Pixels:
        """Return (N, ...) values of the picture of an atlas."""
        if self._filter == "bicubic":
            return sample_bicubic(picture, self._x, self._y)
        return remap(picture, self._x, self._y, self._row)

    @property
    def nbytes(self) -> int:
        """What is held in memory."""
        return self._atlas.nbytes + self._x.nbytes + self._y.nbytes


class CpuSampler:
    """Samples with OpenCV and numba.

    Args:
        rays: in a frame d.
        R_w_d: (3, 3) from that frame to the world.
        views: what was captured from the centre, all of one size.
    """

    def __init__(self, rays: RayBundle, R_w_d: Array, views: Sequence[View]) -> None:
        self._rays, self._R_w_d, self._views = rays, R_w_d, tuple(views)
        self._made: dict[str, PointSampling | AreaSampling] = {}

    @cached_property
    def lookup(self) -> RayLookup:
        """Of the rays."""
        return look_up(self._rays.directions, self._views, self._R_w_d)

    @cached_property
    def unseen(self) -> int:
        """How many valid rays no view sees."""
        return int(np.count_nonzero(self.lookup.view < 0)) - self._rays.invalid_count

    @cached_property
    def minifies(self) -> bool:
        """Whether bilinear interpolation would pass over some of most pixels' footprints."""
        return few_pixels_each(spanned_px(self.lookup, self._rays.steps, self._views[0]))

    def sample(self, filter: str, faces: Sequence[Pixels]) -> Pixels:
        if filter == "nearest":
            return sample_nearest(faces, self.lookup)
        if filter not in self._made:
            rays, views = self._rays, self._views
            self._made[filter] = (
                AreaSampling(rays.footprints(), self.lookup, views, self._R_w_d)
                if filter == "area"
                else PointSampling(filter, self.lookup, views, rays.row)
            )
        return self._made[filter].sample(faces)

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
        held: int = self.lookup.nbytes if "lookup" in self.__dict__ else 0
        return held + sum(sampling.nbytes for sampling in list(self._made.values()))


def point_atlas(filter: str, margin: float, views: Sequence[View]) -> Atlas:
    """Return the atlas of ``bilinear`` or ``bicubic``, for rays whose pixels lie so far, px, from the edges
    of their views."""
    guttered = margin < FILTER_SUPPORT_PX
    return Atlas(views, range(1), FILTER_SUPPORT_PX if guttered else 0, filter == "bicubic")


def spanned_px(lookup: RayLookup, steps: Floats, view: View, first: int = 0) -> Floats:
    """Return how many px of a view rays' pixels span: of some, the same ones however an image is divided.

    Args:
        lookup: of N rays.
        steps: (N,) their angles to the next ones, radians.
        view: the size and field of view of all views.
        first: the number of the first ray in its image.
    """
    start = -first % _EVERY
    some = np.flatnonzero(lookup.view[start::_EVERY] >= 0) * _EVERY + start
    u, v = lookup.x[some] - view.width / 2, lookup.y[some] - view.height / 2
    # f / cos^1.5 px a radian: the mean of a plane's scale along (1 / cos^2) and across (1 / cos) the way
    # to its centre
    return np.asarray(steps[some] * view.focal_px * (1 + (u * u + v * v) / view.focal_px**2) ** 0.75)


def few_pixels_each(spanned: Floats) -> bool:
    """Return whether most pixels of an image span more of a view's than bilinear interpolation reads."""
    return len(spanned) > 0 and bool(np.quantile(spanned, 1 - _MOST) > _MINIFIED)


SAMPLE: dict[Interpolation, Callable[[Sampler, str, Sequence[Pixels]], Pixels]] = {
    "blended": lambda sampler, filter, faces: sampler.sample(filter, faces),
    "nearest": lambda sampler, filter, faces: sampler.sample("nearest", faces),
    "plane": lambda sampler, filter, faces: sampler.normals_from_depth(faces),
    "direction": lambda sampler, filter, faces: sampler.sample_directions(filter, faces),
}
"""How kinds of modalities are sampled; surfaces by :meth:`Sampler.sample_depth`, which bounds their error."""
