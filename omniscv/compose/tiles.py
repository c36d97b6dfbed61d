"""Images that are too large for their maps: sampled a block of rows at a time, to the same bytes.

Rays, lookups, footprints and coordinates are those of a block, and go with it; whole are only the layers,
the captures, and the atlas of the modality that is sampled. What all of the image decides, the gutter of the
atlas and its mip levels, is found in a pass over the blocks before.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from omniscv.cameras import Camera
from omniscv.compose.area import AreaSampling
from omniscv.compose.atlas import Atlas
from omniscv.compose.depth import SampledDepth, sample_depth
from omniscv.compose.directions import normals_from_depth, sample_directions
from omniscv.compose.footprints import Footprints, ImageFootprints
from omniscv.compose.kernels import Floats, Mask, Pixels
from omniscv.compose.label_edges import label_edges
from omniscv.compose.nearest import sample_nearest
from omniscv.compose.ray_bundle import ImageRays, RayBundle
from omniscv.compose.ray_lookup import RayLookup, look_up
from omniscv.compose.samplers import PointSampling, few_pixels_each, point_atlas, spanned_px
from omniscv.geometry import Array
from omniscv.geometry.surfaces import Precision
from omniscv.planning.tiled_rays import BYTES_PER_RAY, TiledRays
from omniscv.planning.viewpoints import CameraRays
from omniscv.sources.base import View


class Tiles(RayBundle):
    """All rays of an image; iterated, it gives bundles of a block of rows each. All at once are made anew.

    Args:
        rays: of the camera.
        footprints: of its pixels.
    """

    def __init__(self, rays: TiledRays, footprints: ImageFootprints) -> None:
        self._rays, self._footprints, self.count = rays, footprints, rays.valid.size
        every, width = np.arange, rays.valid.shape[1]
        super().__init__(np.empty((0, 3)), self._all_steps, lambda: footprints.of(every(self.count)), width)

    @property
    def directions(self) -> Array:
        return self._rays.directions.reshape(-1, 3)

    @property
    def steps(self) -> Floats:
        return self._all_steps()

    @cached_property
    def invalid_count(self) -> int:
        return self.count - int(np.count_nonzero(self._rays.valid))

    def __iter__(self) -> Iterator[tuple[slice, RayBundle]]:
        """Yield each block's flat pixel indices and its rays."""
        width = self._rays.valid.shape[1]
        for rows in self._rays.blocks():
            yield slice(rows.start * width, rows.stop * width), self._bundle(rows, width)

    def _all_steps(self) -> Floats:
        return np.nan_to_num(self._rays.steps).astype(np.float32).ravel()

    def _bundle(self, rows: slice, width: int) -> RayBundle:
        first, around = self._rays.around(rows)

        def steps() -> Floats:
            return np.nan_to_num(self._rays.steps_of(rows, first, around)).astype(np.float32).ravel()

        def footprints() -> Footprints:
            return self._footprints.of(np.arange(rows.start * width, rows.stop * width), first, around)

        mine = around[rows.start - first : rows.stop - first].reshape(-1, 3)
        return RayBundle(mine, steps, footprints, width)


class TiledImageRays(ImageRays):
    """The rays of a central image, of which a block of rows is held at a time.

    Args:
        rays: of the camera.
    """

    def __init__(self, rays: TiledRays) -> None:
        super().__init__(rays)
        self._tiled = rays

    @cached_property
    def whole(self) -> Tiles:
        return Tiles(self._tiled, self._footprints)


def image_rays(camera: Camera, whole_bytes: int, tile_bytes: int) -> ImageRays:
    """Return a camera's rays: in tiles where it is central and its map would take more than both bounds.

    Args:
        camera: whose.
        whole_bytes: up to which the map of an image is made whole.
        tile_bytes: of what is held of a larger one at a time.
    """
    needed = BYTES_PER_RAY * camera.width * camera.height
    if camera.central and needed > max(whole_bytes, tile_bytes):
        return TiledImageRays(TiledRays(camera, tile_bytes))
    return ImageRays(CameraRays(camera))


class TiledSampler:
    """Samples tile by tile, as :class:`omniscv.compose.samplers.CpuSampler` samples all rays at once.

    Args:
        tiles: the rays, in a frame d.
        R_w_d: (3, 3) from that frame to the world.
        views: what was captured from the centre, all of one size.
    """

    nbytes = 0

    def __init__(self, tiles: Tiles, R_w_d: Array, views: Sequence[View]) -> None:
        self._tiles, self._R_w_d, self._views = tiles, R_w_d, tuple(views)

    @cached_property
    def _seen(self) -> tuple[int, float]:
        """How many rays views see, and the least distance of one from its view's edges, px."""
        seen, margin = 0, np.inf
        for _, _, lookup in self._looked_up():
            seen, margin = seen + int(np.count_nonzero(lookup.view >= 0)), min(margin, lookup.margin)
        return seen, float(margin)

    @property
    def unseen(self) -> int:
        """How many valid rays no view sees."""
        return self._tiles.count - self._tiles.invalid_count - self._seen[0]

    @cached_property
    def minifies(self) -> bool:
        """Whether bilinear interpolation would pass over some of most pixels' footprints."""
        return few_pixels_each(
            np.concatenate(
                [
                    spanned_px(lookup, rays.steps, self._views[0], part.start)
                    for part, rays, lookup in self._looked_up()
                ]
            )
        )

    def sample(self, filter: str, faces: Sequence[Pixels]) -> Pixels:
        """Return (N, ...) blended values."""
        if filter == "nearest":
            return self._nearest(faces)
        out: Pixels | None = None
        atlas = self._area_atlas() if filter == "area" else point_atlas(filter, self._seen[1], self._views)
        with atlas.picture(faces) as picture:
            for part, rays, lookup in self._looked_up():
                values = self._sampling(filter, rays, lookup, atlas).read(picture)
                out = self._whole(values) if out is None else out
                out[part] = values
        assert out is not None
        return out

    def sample_depth(
        self, filter: str, faces: Sequence[Pixels], precision: Precision, offsets_w: Array | None
    ) -> SampledDepth:
        """Return depth along the rays; see :func:`omniscv.compose.depth.sample_depth`."""
        assert offsets_w is None, "the rays of a central camera start at its centre"
        distance, error = np.empty((2, self._tiles.count), np.float32)
        stack = np.stack(faces)
        for part, _, lookup in self._looked_up():
            found = sample_depth(stack, lookup, self._views, filter == "nearest", precision)
            distance[part], error[part] = found.distance, found.error
        return SampledDepth(distance, error)

    def label_edges(self, faces: Sequence[Pixels], parallax: Floats | None) -> Mask:
        """Return (N,) whether rays lie at a label boundary; see :mod:`omniscv.compose.label_edges`."""
        out, stack = np.empty(self._tiles.count, np.bool_), np.stack(faces)
        for part, _, lookup in self._looked_up():
            near = None if parallax is None else parallax[part]
            out[part] = label_edges(stack, lookup, self._views, near)
        return out

    def sample_directions(self, filter: str, faces: Sequence[Pixels]) -> Pixels:
        """Return (N, 3) unit vectors; see :mod:`omniscv.compose.directions`."""
        out, stack = np.empty((self._tiles.count, 3), np.float32), np.stack(faces)
        for part, _, lookup in self._looked_up():
            out[part] = sample_directions(stack, lookup, filter == "nearest")
        return out

    def normals_from_depth(self, faces: Sequence[Pixels]) -> Pixels:
        """Return (N, 3) normals of planes that are fitted to depth; see the same module."""
        out, stack = np.empty((self._tiles.count, 3), np.float32), np.stack(faces)
        for part, _, lookup in self._looked_up():
            out[part] = normals_from_depth(stack, lookup, self._views)
        return out

    def _nearest(self, faces: Sequence[Pixels]) -> Pixels:
        stack = np.stack(faces)
        out = np.empty((self._tiles.count, *stack.shape[3:]), stack.dtype)
        for part, _, lookup in self._looked_up():
            out[part] = sample_nearest(stack, lookup)
        return out

    def _looked_up(self) -> Iterator[tuple[slice, RayBundle, RayLookup]]:
        for part, rays in self._tiles:
            yield part, rays, look_up(rays.directions, self._views, self._R_w_d)

    def _sampling(
        self, filter: str, rays: RayBundle, lookup: RayLookup, atlas: Atlas | None
    ) -> PointSampling | AreaSampling:
        if filter == "area":
            return AreaSampling(rays.footprints(), lookup, self._views, self._R_w_d, atlas)
        return PointSampling(filter, lookup, self._views, rays.row, atlas)

    def _area_atlas(self) -> Atlas:
        wanted = [
            AreaSampling(rays.footprints(), lookup, self._views, self._R_w_d).wanted
            for _, rays, lookup in self._looked_up()
        ]
        levels = [levels for levels, _ in wanted if levels]
        first = min((each.start for each in levels), default=0)
        last = max((each.stop for each in levels), default=1)
        return Atlas(self._views, range(first, last), max(support for _, support in wanted))

    def _whole(self, values: Pixels) -> Pixels:
        return np.empty((self._tiles.count, *values.shape[1:]), values.dtype)
