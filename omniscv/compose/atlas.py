"""The views of one optical centre as tiles of one large picture, so that one remap serves them all.

For averaging, the picture also holds the views' mip levels: level 0 at their own resolution, 1 at half, ...
Around each tile can lie a gutter, resampled from the neighbouring views, for the filter support.
Reduction is Burt and Adelson's (The Laplacian pyramid as a compact image code, 1983): the centre of a
level's first pixel is that of the level before. Where no point is sampled at level 0, level 1 is made of
means of 2 x 2, which is three times as fast.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numba import njit

from omniscv.compose import kernels
from omniscv.compose.folding import LARGEST_PX
from omniscv.compose.gutter import FILTER_SUPPORT_PX, Gutter
from omniscv.compose.kernels import Floats, Ints, Pixels
from omniscv.compose.ray_lookup import RayLookup
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.parallel import side_by_side
from omniscv.sources.base import View

OUTSIDE = -16.0
"""An out-of-atlas coordinate, where remap gives its constant border, 0."""


@dataclass(frozen=True, eq=False)
class Level:
    """The tiles of an atlas at one mip level.

    Attributes:
        width, height: px of a view.
        corners: (V, 2) int, x and y of each view's own first pixel in the atlas.
        gutter: what is written around each tile; None if nothing.
    """

    width: int
    height: int
    corners: Ints
    gutter: Gutter | None

    def tile(self, picture: Pixels, view: int, beyond: int = 0) -> Pixels:
        """A view's own pixels in the atlas, and so many beyond its edges."""
        x, y = self.corners[view] - beyond
        return picture[y : y + self.height + 2 * beyond, x : x + self.width + 2 * beyond]


class Atlas:
    """A layout of tiles.

    Args:
        views: all of one size.
        levels: which mip levels it holds: ``range(1)`` for the views alone; the first is 0 or 1.
        guttered: whether tiles of level 0 get a gutter; other levels always do.
        bicubic: whether it is for that filter, which needs a finer gutter.

    Attributes:
        shape: rows and columns of the picture.
        levels: the tiles of each mip level.

    Raises:
        ArgumentError: more or larger views than fit.
    """

    def __init__(self, views: Sequence[View], levels: range, guttered: bool, bicubic: bool) -> None:
        self._view, self._count, self._first = views[0], len(views), levels.start
        self._origin = 0.5 if levels.start == 0 else 1.0
        pad = FILTER_SUPPORT_PX if guttered or levels != range(1) else 0
        self.levels: list[Level] = []
        top = right = 0
        width, height = (n // 2**levels.start for n in (views[0].width, views[0].height))
        for level in levels:
            if level > levels.start:
                width, height = (width + 1) // 2, (height + 1) // 2
            slot = np.array([width + 2 * pad, height + 2 * pad])
            columns = max(1, min(int(np.ceil(np.sqrt(len(views)))), LARGEST_PX // int(slot[0])))
            at = np.array([divmod(i, columns)[::-1] for i in range(len(views))])
            gutter = Gutter(views, width, height, 0.5**level, self._origin, bicubic) if pad else None
            self.levels.append(Level(width, height, at * slot + (pad, pad + top), gutter))
            top += int(slot[1]) * -(-len(views) // columns)
            right = max(right, int(slot[0]) * min(columns, len(views)))
        if max(top, right) > LARGEST_PX:
            raise ArgumentError(
                f"faces: expected {len(views)} views that fit into {LARGEST_PX} x {LARGEST_PX} px, got "
                f"{views[0].width} x {views[0].height} each"
            )
        self.shape = top, right
        self._spare: deque[Pixels] = deque()  # pictures that no sampling uses now

    @contextmanager
    def picture(self, faces: Sequence[Pixels]) -> Iterator[Pixels]:
        """Lay out (h, w) or (h, w, C) faces, one per view, in a picture of the caller's own."""
        shape, dtype = (*self.shape, *faces[0].shape[2:]), faces[0].dtype
        try:
            picture = self._spare.pop()
        except IndexError:
            picture = np.zeros(0)
        if picture.shape != shape or picture.dtype != dtype:
            picture = np.zeros(shape, dtype)
        self._lay_out(picture, faces)
        yield picture
        self._spare.append(picture)

    def _lay_out(self, picture: Pixels, faces: Sequence[Pixels]) -> None:
        first = self.levels[0]

        def place(k: int) -> None:
            own = first.tile(picture, k)
            own[...] = faces[k] if self._first == 0 else _halved(faces[k], first)

        side_by_side(place, range(self._count))
        if first.gutter is not None:
            first.gutter.fill(picture, first.corners)
        for larger, smaller in pairwise(self.levels):
            _reduce(picture, larger, smaller)

    @property
    def nbytes(self) -> int:
        """What is held in memory: pictures that are kept to be written again."""
        return sum(picture.nbytes for picture in list(self._spare))

    def coordinates(self, lookup: RayLookup, steps: Floats | None) -> tuple[Floats, Floats]:
        """Return where rays lie in the picture, as cv2.remap wants them: pixel centres at whole numbers.

        Args:
            lookup: of N rays.
            steps: (N,) angle between an output pixel's ray and the next; chooses the level. None: level 0.
        """
        x, y, view = np.empty_like(lookup.x), np.empty_like(lookup.y), self._view
        corners = np.array([level.corners for level in self.levels], dtype=np.float64)
        rows = lookup.view, lookup.x, lookup.y, np.zeros_like(x) if steps is None else steps, x, y
        half = view.width / 2, view.height / 2
        kernels.run(_to_atlas, rows, view.focal_px, *half, corners, self._first, self._origin)
        return x, y


def _reduce(picture: Pixels, larger: Level, smaller: Level) -> None:
    """Fill a level from the one before: with the gutter, the filter never meets an edge."""

    def place(k: int) -> None:
        reduced = cv2.pyrDown(larger.tile(picture, k, beyond=FILTER_SUPPORT_PX))
        first = FILTER_SUPPORT_PX // 2
        smaller.tile(picture, k)[...] = reduced[first : first + smaller.height, first : first + smaller.width]

    side_by_side(place, range(len(smaller.corners)))
    assert smaller.gutter is not None
    smaller.gutter.fill(picture, smaller.corners)


def _halved(face: Pixels, level: Level) -> Pixels:
    whole = face[: 2 * level.height, : 2 * level.width]
    return np.asarray(cv2.resize(whole, (level.width, level.height), interpolation=cv2.INTER_AREA))


@njit(cache=True, nogil=True)
def minification(x: Any, y: Any, half_width: float, half_height: float, focal: float, step: Any) -> Any:
    """Return how many pixels of a view, at a point in it, an angle spans: ``f / cos^1.5`` a radian, the mean
    of a plane's scale along (``1/cos^2``) and across (``1/cos``) the way to its centre. Numbers or arrays."""
    u, v = (x - half_width) / focal, (y - half_height) / focal
    return step * focal * (1.0 + u * u + v * v) ** 0.75


@njit(cache=True, nogil=True)
def _to_atlas(
    view: Ints, x: Floats, y: Floats, step: Floats, out_x: Floats, out_y: Floats,
    focal: float, half_width: float, half_height: float, corners: Array, first: int, origin: float,
) -> None:  # fmt: skip
    last = corners.shape[0] - 1
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            out_x[i] = out_y[i] = OUTSIDE
            continue
        level = 0
        if last > 0:
            spanned = minification(x[i], y[i], half_width, half_height, focal, step[i])
            if spanned > 1.0:
                level = min(max(int(np.log2(spanned)) - first, 0), last)
        scale = 0.5 ** (first + level)
        out_x[i] = (x[i] - origin) * scale + corners[level, k, 0]
        out_y[i] = (y[i] - origin) * scale + corners[level, k, 1]
