"""The views of one optical centre as tiles of one large picture, so that one remap serves them all.

For averaging, the picture also holds the views' mip levels: level 0 at their own resolution, level 1 of the
means of 2 x 2 of its pixels, ... Around each tile can lie a gutter, resampled from the neighbouring views,
for the filter support.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np

from omniscv.compiled import njit
from omniscv.compose import kernels
from omniscv.compose.folding import LARGEST_PX
from omniscv.compose.gutter import Gutter
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

    def tile(self, picture: Pixels, view: int) -> Pixels:
        """A view's own pixels in the atlas."""
        x, y = self.corners[view]
        return picture[y : y + self.height, x : x + self.width]


class Atlas:
    """A layout of tiles.

    Args:
        views: all of one size.
        levels: which mip levels it holds: ``range(1)`` for the views alone.
        support: px of the gutter around each tile; 0: none.
        bicubic: whether it is for that filter, which needs a finer gutter.

    Attributes:
        shape: rows and columns of the picture.
        levels: the tiles of each mip level.

    Raises:
        ArgumentError: more or larger views than fit.
    """

    def __init__(self, views: Sequence[View], levels: range, support: int, bicubic: bool = False) -> None:
        self._count, self._first = len(views), levels.start
        self.levels: list[Level] = []
        top = right = 0
        for level in levels:
            width, height = (n >> level for n in (views[0].width, views[0].height))
            slot = np.array([width + 2 * support, height + 2 * support])
            columns = max(1, min(int(np.ceil(np.sqrt(len(views)))), LARGEST_PX // int(slot[0])))
            at = np.array([divmod(i, columns)[::-1] for i in range(len(views))])
            gutter = Gutter(views, level, support, bicubic) if support else None
            self.levels.append(Level(width, height, at * slot + (support, support + top), gutter))
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
        def place(k: int) -> None:
            pixels = faces[k]
            for _ in range(self._first):
                pixels = _halved(pixels)
            self.levels[0].tile(picture, k)[...] = pixels
            for level in self.levels[1:]:
                pixels = _halved(pixels)
                level.tile(picture, k)[...] = pixels

        side_by_side(place, range(self._count))
        for level in self.levels:
            if level.gutter is not None:
                level.gutter.fill(picture, level.corners)

    @property
    def nbytes(self) -> int:
        """What is held in memory: pictures that are kept to be written again."""
        return sum(picture.nbytes for picture in list(self._spare))

    def coordinates(self, lookup: RayLookup, level: Ints | None = None) -> tuple[Floats, Floats]:
        """Return where rays lie in the picture, as cv2.remap wants them: pixel centres at whole numbers.

        Args:
            lookup: of N rays.
            level: (N,) uint8 mip level at which each is sampled; 0 if not given.
        """
        x, y = np.empty_like(lookup.x), np.empty_like(lookup.y)
        level = np.zeros(len(x), np.uint8) if level is None else level
        corners = np.array([level.corners for level in self.levels], dtype=np.float64)
        scales = 0.5 ** np.arange(self._first + len(self.levels))
        kernels.run(_to_atlas, (lookup.view, lookup.x, lookup.y, level, x, y), corners, scales, self._first)
        return x, y


def _halved(face: Pixels) -> Pixels:
    """Return means of 2 x 2 pixels; an odd last row or column is left out."""
    height, width = face.shape[0] // 2, face.shape[1] // 2
    whole = face[: 2 * height, : 2 * width]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


@njit(cache=True, nogil=True)
def _to_atlas(
    view: Ints, x: Floats, y: Floats, level: Ints, out_x: Floats, out_y: Floats,
    corners: Array, scales: Array, first: int,
) -> None:  # fmt: skip
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            out_x[i] = out_y[i] = OUTSIDE
            continue
        scale = scales[level[i]]
        out_x[i] = x[i] * scale - 0.5 + corners[level[i] - first, k, 0]
        out_y[i] = y[i] * scale - 0.5 + corners[level[i] - first, k, 1]
