"""The views of one optical centre as tiles of one large picture, which is sampled at once.

For averaging, the picture also holds the views' mip levels: level 0 at their own resolution, level 1 of the
means of 2 x 2 of its pixels, ... Around each tile can lie a gutter, resampled from the neighbouring views,
for the filter support: a filter at the edge of a view needs pixels beyond it. Where views are not captured
wider than their rays need, the ray of each pixel of the gutter is looked up in the neighbours. Where none
sees it, the view's own edge is continued.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from omniscv.compiled import njit
from omniscv.depth.interpolation import LARGEST_PX, sample_bicubic, sample_bilinear
from omniscv.depth.ray_lookup import RayLookup, look_up
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, pinhole
from omniscv.geometry.arrays import Faces, Floats, Ints, Mask, Pixels, Rows, run
from omniscv.parallel import side_by_side
from omniscv.sources.base import View

OUTSIDE = -16.0
"""A coordinate outside every atlas, where cv2.remap gives its constant border, 0."""
FILTER_SUPPORT_PX = 2
"""Pixels beyond a point that bicubic, the widest interpolation, needs."""


class Gutter:
    """The gutters of views, at their own resolution or at a mip level.

    Args:
        views: all of one size, from one centre.
        level: the mip level.
        support: px of the gutter.
        bicubic: resample neighbours by the better and slower filter.
    """

    def __init__(self, views: Sequence[View], level: int, support: int, bicubic: bool) -> None:
        width = views[0].width >> level
        height = views[0].height >> level
        scale = 0.5**level
        ring = _ring(width, height, support)
        self._ring = ring
        self._bicubic = bicubic
        in_view = []
        pixels = []
        for k, view in enumerate(views):
            at = (ring + 0.5) / scale
            rays_w = pinhole.rays(at, view.projection) @ view.pose.R_w_c.T
            others = [i for i in range(len(views)) if i != k]
            neighbour = np.full(len(ring), k)
            pixel = ring.astype(np.float64)
            if others:
                lookup = look_up(rays_w, [views[i] for i in others])
                seen = lookup.view >= 0
                neighbour[seen] = np.array(others)[lookup.view[seen]]
                pixel[seen] = np.stack([lookup.x, lookup.y], axis=1)[seen] * scale - 0.5
            in_view.append(neighbour)
            pixels.append(np.clip(pixel, 0, (width - 1, height - 1)))
        self._neighbour = np.array(in_view)
        self._pixel = np.array(pixels)

    def fill(self, picture: Pixels, corners: Ints) -> None:
        """Write the gutter of every view into a picture that holds the views.

        Args:
            picture: the atlas.
            corners: (V, 2) x and y of each view's first pixel.
        """
        at = self._pixel + corners[self._neighbour]
        x, y = np.ascontiguousarray(at.reshape(-1, 2).T, dtype=np.float32)
        column, row = np.moveaxis(self._ring[None] + corners[:, None], -1, 0)
        picture[row.ravel(), column.ravel()] = 0  # read with a weight of 0, which NaN would spoil
        picture[row.ravel(), column.ravel()] = sample_bilinear(picture, x, y)
        if self._bicubic:  # again: at the edge of a neighbour it needs the neighbour's gutter
            picture[row.ravel(), column.ravel()] = sample_bicubic(picture, x, y)


def _ring(width: int, height: int, support: int) -> Ints:
    """Return (N, 2) the pixels (x, y) outside a view within ``support`` px."""
    across = np.arange(-support, width + support)
    down = np.arange(height)
    above = np.arange(-support, 0)
    below = np.arange(height, height + support)
    left = np.arange(-support, 0)
    right = np.arange(width, width + support)
    bands = []
    for x, y in ((across, above), (across, below), (left, down), (right, down)):
        bands.append(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    return np.concatenate(bands)


@dataclass(frozen=True, eq=False)
class Level:
    """The tiles of an atlas at one mip level.

    Attributes:
        width, height: px of a view.
        corners: (V, 2) int, x and y of each view's own first pixel in the atlas.
        gutter: around each tile; None if there is none.
    """

    width: int
    height: int
    corners: Ints
    gutter: Gutter | None

    def tile(self, picture: Pixels, view: int) -> Pixels:
        """A view's own pixels in the atlas."""
        x, y = self.corners[view]
        return picture[y : y + self.height, x : x + self.width]


class Atlas:
    """A layout of tiles.

    Args:
        views: all of one size.
        levels: the mip levels that it holds: ``range(1)`` for the views alone.
        support: px of the gutter around each tile; 0: none.
        bicubic: resample the gutter by the better and slower filter.

    Attributes:
        shape: rows and columns of the picture.
        levels: the tiles of each mip level.

    Raises:
        ArgumentError: more or larger views than fit.
    """

    def __init__(self, views: Sequence[View], levels: range, support: int, bicubic: bool = False) -> None:
        self._count = len(views)
        self._first = levels.start
        self.levels: list[Level] = []
        top = right = 0
        for level in levels:
            width = views[0].width >> level
            height = views[0].height >> level
            slot = np.array([width + 2 * support, height + 2 * support])
            columns = max(1, min(int(np.ceil(np.sqrt(len(views)))), LARGEST_PX // int(slot[0])))
            at = np.array([divmod(i, columns)[::-1] for i in range(len(views))])
            gutter = Gutter(views, level, support, bicubic) if support else None
            self.levels.append(Level(width, height, at * slot + (support, support + top), gutter))
            top += int(slot[1]) * -(-len(views) // columns)
            right = max(right, int(slot[0]) * min(columns, len(views)))
        if max(top, right) > LARGEST_PX:
            wanted = f"expected {len(views)} views that fit into {LARGEST_PX} x {LARGEST_PX} px"
            raise ArgumentError(f"faces: {wanted}, got {views[0].width} x {views[0].height} each")
        self.shape = top, right
        self._is_full = len(levels) == 1 and len(views) % columns == 0

    def picture(self, faces: Faces, used: Mask | None = None) -> Pixels:
        """Return the picture of faces (h, w) or (h, w, C); those not ``used`` (V,) may be left out."""
        if faces[0].shape[:2] == self.shape and len(self.levels) == 1:
            return faces[0]
        guttered = any(level.gutter for level in self.levels)  # from every neighbour
        laid_out = range(self._count) if used is None or guttered else np.flatnonzero(used).tolist()
        # Kernels read beside tiles, too.
        make = np.empty if self._is_full and len(laid_out) == self._count else np.zeros
        picture = make((*self.shape, *faces[0].shape[2:]), faces[0].dtype)

        def lay_out(k: int) -> None:
            pixels = faces[k]
            for _ in range(self._first):
                pixels = _halved(pixels)
            self.levels[0].tile(picture, k)[...] = pixels
            for level in self.levels[1:]:
                pixels = _halved(pixels)
                level.tile(picture, k)[...] = pixels

        side_by_side(lay_out, laid_out)
        for level in self.levels:
            if level.gutter is not None:
                level.gutter.fill(picture, level.corners)
        picture.flags.writeable = False  # as captures are: kernels are compiled for these alone
        return picture

    def coordinates(self, lookup: RayLookup, level: Ints | None = None) -> tuple[Floats, Floats]:
        """Return where rays lie in the picture, as cv2.remap wants them: pixel centres at whole numbers.

        Args:
            lookup: of N rays.
            level: (N,) uint8 mip level at which each is sampled; 0 if not given.
        """
        x = np.empty_like(lookup.x)
        y = np.empty_like(lookup.y)
        level = np.zeros(len(x), np.uint8) if level is None else level
        corners = np.array([level.corners for level in self.levels], dtype=np.float64)
        scales = 0.5 ** np.arange(self._first + len(self.levels))
        rays = lookup.view, lookup.x, lookup.y, level, x, y
        run(_to_atlas, rays, corners, scales, self._first, as_one=True)
        return x, y


def _halved(face: Pixels) -> Pixels:
    """Return means of 2 x 2 pixels; an odd last row or column is left out."""
    height, width = face.shape[0] // 2, face.shape[1] // 2
    whole = face[: 2 * height, : 2 * width]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


@njit(
    "(int16[::1], float32[::1], float32[::1], uint8[::1], out float32[::1], out float32[::1]), "
    "float64[:, :, ::1], float64[::1], int64",
    nogil=True,
)
def _to_atlas(rays: Rows, corners: Array, scales: Array, first: int) -> None:
    view, x, y, level, out_x, out_y = rays
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            out_x[i] = out_y[i] = OUTSIDE
            continue
        scale = scales[level[i]]
        out_x[i] = x[i] * scale - 0.5 + corners[level[i] - first, k, 0]
        out_y[i] = y[i] * scale - 0.5 + corners[level[i] - first, k, 1]
