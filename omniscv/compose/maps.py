"""Where the rays of one optical centre lie in its views: made when first asked for, kept for every mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.captures.view import View
from omniscv.compose.atlas import Atlas, minification
from omniscv.compose.bicubic import sample_bicubic
from omniscv.compose.border import REACH
from omniscv.compose.depth import sample_depth
from omniscv.compose.grid import Grid
from omniscv.compose.listed import Listed
from omniscv.geometry import Array
from omniscv.plan.places import Places, locate

_INTERPOLATION = {
    "nearest": cv2.INTER_NEAREST,
    "bilinear": cv2.INTER_LINEAR,
    "area": cv2.INTER_LINEAR,  # of views reduced to the image's own resolution
}
_SMALLEST_LEVEL = 8  # px: less of a view says nothing
_MINIFIED, _MOST = 2.0, 0.9
_EVERY = 7  # of how many pixels one is asked whether it is minified
_ROW = 1 << 12

Map = tuple[NDArray[np.float32], NDArray[np.float32]]


class Maps:
    """The maps of one optical centre.

    Args:
        grid: one ray a pixel.
        finer: gives the finer grid.
        R_w_c: the camera's orientation.
        views: what was captured from the centre, all of one size.
        pixels: flat indices of the image's pixels that the centre serves; None for a whole image.
    """

    def __init__(
        self,
        grid: Grid | Listed,
        finer: Callable[[], Grid | Listed],
        R_w_c: Array,
        views: Sequence[View],
        pixels: NDArray[np.int64] | None,
    ) -> None:
        self.views = tuple(views)
        self._grid, self._finer, self._R_w_c, self._pixels = grid, finer, R_w_c, pixels
        self._made: dict[str, tuple[Atlas, Map]] = {}

    @cached_property
    def places(self) -> Places:
        """Of the pixels' own rays."""
        return locate(self._own(self._grid, self._grid.directions), self.views, self._R_w_c)

    @cached_property
    def finer_places(self) -> Places:
        """Of the rays of the finer grid."""
        finer = self._finer()
        return locate(self._own(finer, finer.directions), self.views, self._R_w_c)

    @cached_property
    def unseen(self) -> int:
        """How many of the pixels' own valid rays no view sees."""
        valid = self._own(self._grid, self._grid.valid)
        return int(np.count_nonzero(valid & (self.places.view < 0)))

    @cached_property
    def minifies(self) -> bool:
        """Whether most pixels span two pixels of a view or more, so that bilinear would pass some over."""
        steps, places = self._own(self._grid, self._grid.steps), self.places
        some = np.flatnonzero(places.view[::_EVERY] >= 0) * _EVERY
        return bool(len(some)) and bool(
            np.quantile(self._spanned(places, steps, some), 1 - _MOST) > _MINIFIED
        )

    def sample(self, filter: str, faces: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """(N, C) values of the centre's rays: those of the finer grid for ``area``, else the pixels' own.

        Args:
            filter: nearest, bilinear, bicubic or area.
            faces: (h, w, C) pixels of each view.
        """
        if filter not in self._made:
            self._made[filter] = self._make(filter)
        atlas, (x, y) = self._made[filter]
        picture = atlas.lay_out(faces)
        if filter == "bicubic":
            out = sample_bicubic(picture, x, y)
        else:
            out = cv2.remap(
                picture, x, y, _INTERPOLATION[filter], borderMode=cv2.BORDER_CONSTANT, borderValue=0
            )
        count = len((self.finer_places if filter == "area" else self.places).view)
        return np.asarray(out.reshape(-1, *faces[0].shape[2:])[:count])

    def sample_depth(self, faces: Sequence[NDArray[np.float32]], nearest: bool) -> NDArray[np.float32]:
        """(N,) metres along the rays."""
        focal = np.array([view.focal_px for view in self.views])
        view = self.views[0]
        return sample_depth(faces, self.places, view.width / 2, view.height / 2, focal, nearest)

    def _make(self, filter: str) -> tuple[Atlas, Map]:
        steps: NDArray[np.float32] | None = None
        if filter == "area":
            places, finer = self.finer_places, self._finer()
            steps = self._own(finer, finer.steps)
            atlas = Atlas(self.views, self._levels(places, steps), bordered=True, bicubic=False)
        else:
            places = self.places
            if filter == "nearest":
                places = _whole(places, self.views[0])
            bordered = filter != "nearest" and places.margin < REACH
            atlas = Atlas(self.views, range(1), bordered, bicubic=filter == "bicubic")
        return atlas, self._folded(*atlas.places(places, steps))

    def _levels(self, places: Places, steps: NDArray[np.float32]) -> range:
        """The reductions that an averaged image takes from."""
        seen = np.flatnonzero(places.view >= 0)
        if len(seen) == 0:
            return range(1)
        spanned = self._spanned(places, steps, seen)
        least, most = (int(np.log2(max(1.0, float(limit)))) for limit in (spanned.min(), spanned.max()))
        smallest = min(self.views[0].width, self.views[0].height)
        while most > 0 and smallest >> most < _SMALLEST_LEVEL:
            most -= 1
        return range(min(least, most, 1), most + 1)

    def _spanned(self, places: Places, steps: NDArray[np.float32], some: NDArray[np.int64]) -> Array:
        view = self.views[0]
        return np.asarray(
            minification(
                places.x[some], places.y[some], view.width / 2, view.height / 2, view.focal_px, steps[some]
            )
        )

    def _own(self, grid: Grid | Listed, values: NDArray[Any]) -> NDArray[Any]:
        """The values of the centre's rays, one after another."""
        flat = values.reshape(-1, *values.shape[2:])
        return flat if self._pixels is None else flat[grid.pixels(self._pixels, self._grid.valid.shape[1])]

    def _folded(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> Map:
        """A list as rows: the image's own for a whole image, so that remap reads neighbours together."""
        if self._pixels is None:
            wide = self._grid.valid.shape[1]
            wide = wide if len(x) == self._grid.valid.size else 2 * wide - 1
            return x.reshape(-1, wide), y.reshape(-1, wide)
        rows = -(-len(x) // _ROW)
        if rows == 1:
            return x[None], y[None]
        padded = np.zeros((2, rows * _ROW), np.float32)
        padded[:, : len(x)] = x, y
        return padded[0].reshape(rows, _ROW), padded[1].reshape(rows, _ROW)


def _whole(places: Places, view: View) -> Places:
    """The centres of the pixels that places lie in; remap's own rounding ties to even."""
    x = np.clip(np.floor(places.x), 0, view.width - 1) + np.float32(0.5)
    y = np.clip(np.floor(places.y), 0, view.height - 1) + np.float32(0.5)
    return Places(places.view, x, y, places.margin)


def filter_for(mode: str, filter: str) -> str:
    """The filter that a mode gets: masks are never blended, normals never averaged over areas."""
    if mode == "object_mask":
        return "nearest"
    return "bilinear" if mode == "normal" and filter in ("auto", "area") else filter


def unit(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Directions again; 0 where unknown surroundings outweigh the known."""
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.asarray(np.divide(normals, length, out=np.zeros_like(normals), where=length > 0.5))
