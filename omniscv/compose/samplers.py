"""Values along rays from the views of one optical centre.

A sampler works in blocks of rays. Rays that are kept are one block; its lookup and coordinates are made when
first used and kept for every modality and image. A larger image comes in blocks of rows: their lookups,
footprints and coordinates are made again for every modality. Only layers, captures and the atlas are held
whole; a pass over the blocks finds the gutter and mip levels of the atlas.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.compose.area import AreaSampling
from omniscv.compose.atlas import FILTER_SUPPORT_PX, Atlas
from omniscv.depth.depth_pictures import DepthPictures, sample_depth
from omniscv.depth.hits import KnownDepth
from omniscv.depth.interpolation import sample_bicubic, sample_bilinear
from omniscv.depth.nearest import label_edges, normals_from_depth, sample_directions, sample_nearest
from omniscv.depth.ray_lookup import RayLookup, look_up
from omniscv.geometry import Array
from omniscv.geometry.arrays import Faces, Floats, Ints, Mask, Pixels, reads_few, stacked
from omniscv.modalities import Interpolation
from omniscv.planning.rays import RayBlock
from omniscv.sources.base import View

Blocks = Callable[[], Iterator[RayBlock]]
"""Yields rays block by block; :meth:`omniscv.planning.ImageRays.blocks` with its arguments."""

_MINIFIED_PX = 2.0
_MINIFIED_SHARE = 0.9
"""An image is minified if this share of its pixels span so many px of a view or more."""
_TEST_STRIDE = 7
_TESTED = 1 << 16
"""Every seventh ray is tested; of more rays, about so many."""


class _Coverage(NamedTuple):
    """How views see rays."""

    rays: int
    unseen: int  # valid rays that no view sees
    margin: float  # the least distance of a ray's pixel from its view's edges, px
    used: Mask  # (V,) the views that see rays


Keep = Callable[[Hashable, Callable[[], Pixels]], Pixels]
"""Returns what a function makes, or what it made earlier under this name of the same pictures."""


class Sampler:
    """Samples with OpenCV and numba. A subclass may sample on another device.

    Args:
        rays: in a frame d.
        R_w_d: (3, 3) from that frame to the world.
        views: captured from the centre, all of one size.
    """

    def __init__(self, rays: Blocks, R_w_d: Array, views: Sequence[View]) -> None:
        self._rays = rays
        self._R_w_d = R_w_d
        self._views = tuple(views)
        self._kept: _Block | None = None
        self._atlases: dict[str, Atlas] = {}

    @property
    def unseen(self) -> int:
        """How many valid rays no view sees."""
        return self._coverage.unseen

    @cached_property
    def minifies(self) -> bool:
        """Whether most rays' pixels span two pixels of a view or more."""
        stride = max(_TEST_STRIDE, self._coverage.rays // _TESTED)
        parts = []
        for block in self._blocks():
            parts.append(_spanned_px(block, self._views[0], stride))
        spans = np.concatenate(parts)
        return len(spans) > 0 and bool(np.quantile(spans, 1 - _MINIFIED_SHARE) > _MINIFIED_PX)

    def sample(self, filter: str, faces: Faces, keep: Keep = lambda _, make: make()) -> Pixels:
        """Return (N, ...) blended values by a ``filter``; ``keep`` what the faces are laid out in."""
        few = reads_few(faces, self._coverage.rays)
        if filter == "nearest":
            pictures = faces if few else stacked(faces)
            return self._values(lambda block: sample_nearest(pictures, block.lookup))
        atlas = self._atlas(filter)
        if few and filter == "bilinear" and atlas.levels[0].gutter is None:
            return self._values(lambda block: block.sample_apart(atlas, faces))
        used = None if filter == "area" else self._coverage.used
        name = "atlas", filter, atlas.shape, None if used is None else used.tobytes()
        picture = keep(name, lambda: atlas.picture(faces, used))
        return self._values(lambda block: block.sample(filter, atlas, picture))

    def sample_depth(self, filter: str, pictures: DepthPictures, offsets_w: Array | None) -> KnownDepth:
        """Return depth along the rays; see :func:`omniscv.depth.depth_pictures.sample_depth`.

        Args:
            filter: ``nearest`` takes the nearest pixel's depth, every other one interpolates.
            pictures: of planar depth, one per view.
            offsets_w: (N, 3) from the views' centre to the rays' own origins, metres; None: they are one.
        """

        def sample(block: _Block) -> Sequence[Any]:
            offsets = None if offsets_w is None else offsets_w[block.rays.part]
            return sample_depth(pictures, block.lookup, self._views, filter == "nearest", offsets)

        return KnownDepth(*self._sampled(sample))

    def label_edges(self, boundaries: Pixels, parallax: Floats | None, relief: Mask | None = None) -> Mask:
        """Return (N,) marks of label boundaries; see :func:`omniscv.depth.nearest.label_edges`.

        Args:
            boundaries: (V, h, w) uint8 of masks.
            parallax: (N,) radians; None: rays start at the views' centre.
            relief: (N,) where lone labels are doubtful, too; None: nowhere.
        """

        def sample(block: _Block) -> Mask:
            part = block.rays.part
            near = None if parallax is None else parallax[part]
            rough = None if relief is None else relief[part]
            return label_edges(boundaries, block.lookup, self._views, near, rough)

        return self._values(sample)

    def sample_directions(self, filter: str, faces: Faces) -> Pixels:
        """Return (N, 3) unit vectors from ``faces``, by a ``filter``; see
        :func:`omniscv.depth.nearest.sample_directions`."""
        stack = stacked(faces)
        nearest = filter == "nearest"
        return self._values(lambda block: sample_directions(stack, block.lookup, nearest))

    def normals_from_depth(self, faces: Faces) -> Pixels:
        """Return (N, 3) normals; see :func:`omniscv.depth.nearest.normals_from_depth`."""
        stack = stacked(faces)
        return self._values(lambda block: normals_from_depth(stack, block.lookup, self._views))

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        return 0 if self._kept is None else self._kept.nbytes

    def _blocks(self) -> Iterator["_Block"]:
        """Yield the rays' blocks, looked up; the only one is kept."""
        if self._kept is not None:
            yield self._kept
            return
        for rays in self._rays():
            block = _Block(rays, self._R_w_d, self._views)
            if rays.kept:
                self._kept = block
            yield block

    @cached_property
    def _coverage(self) -> _Coverage:
        count = 0
        unseen = 0
        margin = np.inf
        used = np.zeros(len(self._views), np.bool_)
        for block in self._blocks():
            view = block.lookup.view
            count += len(view)
            unseen += int(np.count_nonzero(view < 0)) - block.rays.invalid_count
            margin = min(margin, block.lookup.margin)
            used = used | block.lookup.used
        return _Coverage(count, unseen, float(margin), used)

    def _values(self, sample: Callable[["_Block"], Pixels]) -> Pixels:
        """Return (N, ...) values that a function returns for a block, for all rays."""
        return np.asarray(self._sampled(lambda block: (sample(block),))[0])

    def _sampled(self, sample: Callable[["_Block"], Sequence[Any]]) -> list[Any]:
        """Return what a function returns for a block, arrays of its rays or None, for all rays."""
        whole: list[Any] = []
        for block in self._blocks():
            values = sample(block)
            if block.rays.kept:
                return list(values)
            if not whole:
                whole = [self._empty_like(array) for array in values]
            for out, array in zip(whole, values, strict=True):
                if out is not None:
                    out[block.rays.part] = array
        return whole

    def _empty_like(self, array: NDArray[Any] | None) -> NDArray[Any] | None:
        """Return an array for all rays, of what ``array`` has for a block; None for None."""
        if array is None:
            return None
        return np.empty((self._coverage.rays, *array.shape[1:]), array.dtype)

    def _atlas(self, filter: str) -> Atlas:
        """Return the atlas of a filter."""
        if filter in self._atlases:
            return self._atlases[filter]
        if filter == "area":
            areas = [block.area for block in self._blocks()]
            levels = [area.levels for area in areas if area.levels]
            first = min((mips.start for mips in levels), default=0)
            last = max((mips.stop for mips in levels), default=1)
            atlas = Atlas(self._views, range(first, last), max(area.support for area in areas))
        else:
            support = FILTER_SUPPORT_PX if self._coverage.margin < FILTER_SUPPORT_PX else 0
            atlas = Atlas(self._views, range(1), support, filter == "bicubic")
        self._atlases[filter] = atlas
        return atlas


SAMPLE: dict[Interpolation, Callable[[Sampler, str, Faces], Pixels]] = {
    "blended": lambda sampler, filter, faces: sampler.sample(filter, faces),
    "nearest": lambda sampler, filter, faces: sampler.sample("nearest", faces),
    "plane": lambda sampler, filter, faces: sampler.normals_from_depth(faces),
    "direction": lambda sampler, filter, faces: sampler.sample_directions(filter, faces),
}
"""How modalities are sampled by their interpolation; surfaces by :meth:`Sampler.sample_depth`."""


class _Block:
    """A block of rays, looked up in views; arguments as :class:`Sampler`."""

    def __init__(self, rays: RayBlock, R_w_d: Array, views: tuple[View, ...]) -> None:
        self.rays = rays
        self._R_w_d = R_w_d
        self._views = views
        self._coordinates: dict[str, tuple[Floats, Floats]] = {}
        # By face that rays read: its number, these rays, and their coordinates in it.
        self._apart: tuple[tuple[int, Ints, Floats, Floats], ...] | None = None

    @cached_property
    def lookup(self) -> RayLookup:
        """Of the rays."""
        return look_up(self.rays.directions, self._views, self._R_w_d)

    @cached_property
    def area(self) -> AreaSampling:
        """How ``area`` samples the rays' pixels."""
        return AreaSampling(self.rays.footprints(), self.lookup, self._views, self._R_w_d)

    def sample(self, filter: str, atlas: Atlas, picture: Pixels) -> Pixels:
        """Return (N, ...) blended values of the ``picture`` of an ``atlas``, by a ``filter``."""
        x, y = self._at(filter, atlas)
        if filter == "area":
            return self.area.sample(picture, x, y)
        if filter == "bicubic":
            return sample_bicubic(picture, x, y)
        return sample_bilinear(picture, x, y, self.rays.row)

    def sample_apart(self, atlas: Atlas, faces: Faces) -> Pixels:
        """Return what :meth:`sample` does with ``bilinear``, from the faces that an atlas would hold."""
        if self._apart is None:
            x, y = self._at("bilinear", atlas)
            corners = atlas.levels[0].corners.astype(np.float32)
            apart = []
            for k, rays in self.lookup.by_view():
                # Corners are whole: differences are exact.
                apart.append((k, rays, x[rays] - corners[k, 0], y[rays] - corners[k, 1]))
            self._apart = tuple(apart)
        out = np.zeros((len(self.lookup.view), *faces[0].shape[2:]), faces[0].dtype)
        for k, rays, x, y in self._apart:
            out[rays] = sample_bilinear(faces[k], x, y)
        return out

    def _at(self, filter: str, atlas: Atlas) -> tuple[Floats, Floats]:
        """Return the rays' coordinates in an atlas."""
        if filter not in self._coordinates:
            sampled = self.area if filter == "area" else None
            if sampled is None:
                self._coordinates[filter] = atlas.coordinates(self.lookup)
            else:
                self._coordinates[filter] = sampled.coordinates(atlas)
        return self._coordinates[filter]

    @property
    def nbytes(self) -> int:
        """Bytes held in memory."""
        total = 0
        for name in ("lookup", "area"):
            if name in self.__dict__:
                total += self.__dict__[name].nbytes
        for x, y in list(self._coordinates.values()):
            total += x.nbytes + y.nbytes
        for _, rays, x, y in self._apart or ():
            total += rays.nbytes + x.nbytes + y.nbytes
        return total


def _spanned_px(block: _Block, view: View, stride: int) -> Floats:
    """Return how many px of a view the pixels of every ``stride``-th ray of an image span."""
    lookup = block.lookup
    start = -block.rays.first % stride
    seen = np.flatnonzero(lookup.view[start::stride] >= 0) * stride + start
    focal, _, cx, cy = view.projection
    u = lookup.x[seen] - cx
    v = lookup.y[seen] - cy
    # f / cos^1.5 px a radian: the mean of a plane's scale along (1 / cos^2) and across (1 / cos) the way
    # to its centre
    return np.asarray(block.rays.steps(seen) * focal * (1 + (u * u + v * v) / focal**2) ** 0.75)
