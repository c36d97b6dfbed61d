"""The views of one optical centre side by side in one large picture, so that one remap serves them all.

For averaging, the picture also holds the views reduced to half, a quarter, ...: level 0, 1, 2, ...
Around each view can lie a border, resampled from the neighbouring views, for filters to reach into.
Reduction is Burt and Adelson's (The Laplacian pyramid as a compact image code, 1983): the centre of a
level's first pixel is that of the level before. Where no pixel takes from level 0, level 1 is made of
means of 2 x 2, which is three times as fast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from omniscv.captures.view import View
from omniscv.compose.border import REACH, Border
from omniscv.errors import ArgumentError
from omniscv.parallel import blocks, side_by_side
from omniscv.plan.places import Places

_LIMIT = 32766
"""cv2.remap takes no picture with a side of 32767 px or more."""

OUTSIDE = -16.0
"""A place off every picture: remap's constant border, 0, is what it gets."""


@dataclass(frozen=True, eq=False)
class Level:
    """The views of an atlas at one reduction.

    Attributes:
        width, height: px of a view.
        corners: (V, 2) int, x and y of each view's own first pixel in the atlas.
        border: what is laid around each view; None if nothing.
    """

    width: int
    height: int
    corners: NDArray[np.int64]
    border: Border | None

    def slot(self, picture: NDArray[Any], view: int, beyond: int = 0) -> NDArray[Any]:
        """A view's own pixels in the atlas, and so many beyond its edges."""
        x, y = self.corners[view] - beyond
        return picture[y : y + self.height + 2 * beyond, x : x + self.width + 2 * beyond]


class Atlas:
    """A layout, and the last picture laid out in it.

    Args:
        views: all of one size.
        levels: which reductions it holds: ``range(1)`` for the views alone; the first is 0 or 1.
        bordered: whether views get a border; reduced ones always do.
        bicubic: whether it is for that filter, which asks more of a border.

    Raises:
        ArgumentError: more or larger views than fit.
    """

    def __init__(self, views: Sequence[View], levels: range, bordered: bool, bicubic: bool) -> None:
        self._view, self._count, self._first = views[0], len(views), levels.start
        self._origin = 0.5 if levels.start == 0 else 1.0
        pad = REACH if bordered or levels != range(1) else 0
        self._levels: list[Level] = []
        top = right = 0
        width, height = (n // 2**levels.start for n in (views[0].width, views[0].height))
        for level in levels:
            if level > levels.start:
                width, height = (width + 1) // 2, (height + 1) // 2
            slot = np.array([width + 2 * pad, height + 2 * pad])
            columns = max(1, min(int(np.ceil(np.sqrt(len(views)))), _LIMIT // int(slot[0])))
            at = np.array([divmod(i, columns)[::-1] for i in range(len(views))])
            border = Border(views, width, height, 0.5**level, self._origin, bicubic) if pad else None
            self._levels.append(Level(width, height, at * slot + (pad, pad + top), border))
            top += int(slot[1]) * -(-len(views) // columns)
            right = max(right, int(slot[0]) * min(columns, len(views)))
        if max(top, right) > _LIMIT:
            raise ArgumentError(
                f"faces: expected {len(views)} views that fit into {_LIMIT} x {_LIMIT} px, got "
                f"{views[0].width} x {views[0].height} each"
            )
        self._shape = top, right
        self._picture: NDArray[Any] | None = None

    def lay_out(self, faces: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """The picture of (h, w, C) faces, one per view; it is overwritten by the next one of its kind."""
        shape = (*self._shape, *faces[0].shape[2:])
        if self._picture is None or self._picture.shape != shape or self._picture.dtype != faces[0].dtype:
            self._picture = np.zeros(shape, faces[0].dtype)
        picture, first = self._picture, self._levels[0]

        def place(k: int) -> None:
            own = first.slot(picture, k)
            own[...] = faces[k] if self._first == 0 else _halved(faces[k], first)

        side_by_side(place, range(self._count))
        if first.border is not None:
            first.border.fill(picture, first.corners)
        for larger, smaller in pairwise(self._levels):
            _reduce(picture, larger, smaller)
        return picture

    def places(
        self, places: Places, steps: NDArray[np.float32] | None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Where places lie in the picture, as cv2.remap wants them: pixel centres at whole numbers.

        Args:
            places: (N,) places in the views.
            steps: (N,) angle between an output pixel's ray and the next; chooses the level. None: level 0.
        """
        count = len(places.view)
        x, y = np.empty(count, np.float32), np.empty(count, np.float32)
        view = self._view
        corners = np.array([level.corners for level in self._levels], dtype=np.float64)
        steps = np.zeros(count, np.float32) if steps is None else steps

        def part(rows: slice) -> None:
            _to_atlas(
                places.view[rows], places.x[rows], places.y[rows], steps[rows], view.focal_px,
                view.width / 2, view.height / 2, corners, self._first, self._origin, x[rows], y[rows],
            )  # fmt: skip

        blocks(part, count)
        return x, y


def _reduce(picture: NDArray[Any], larger: Level, smaller: Level) -> None:
    """Fills a level from the one before: with the border, filters never see an edge."""

    def place(k: int) -> None:
        reduced = cv2.pyrDown(larger.slot(picture, k, beyond=REACH))
        first = REACH // 2
        smaller.slot(picture, k)[...] = reduced[first : first + smaller.height, first : first + smaller.width]

    side_by_side(place, range(len(smaller.corners)))
    assert smaller.border is not None
    smaller.border.fill(picture, smaller.corners)


def _halved(face: NDArray[Any], level: Level) -> NDArray[Any]:
    whole = face[: 2 * level.height, : 2 * level.width]
    return np.asarray(cv2.resize(whole, (level.width, level.height), interpolation=cv2.INTER_AREA))


@njit(cache=True, nogil=True)
def minification(x: Any, y: Any, half_width: float, half_height: float, focal: float, step: Any) -> Any:
    """How many pixels of a view, at a place in it, an angle spans: ``f / cos^1.5`` px per radian, the mean
    of a plane's scale along (``1/cos^2``) and across (``1/cos``) the way to its centre. Numbers or arrays."""
    u, v = (x - half_width) / focal, (y - half_height) / focal
    return step * focal * (1.0 + u * u + v * v) ** 0.75


@njit(cache=True, nogil=True)
def _to_atlas(
    view: NDArray[np.int16],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    step: NDArray[np.float32],
    focal: float,
    half_width: float,
    half_height: float,
    corners: NDArray[np.float64],
    first: int,
    origin: float,
    out_x: NDArray[np.float32],
    out_y: NDArray[np.float32],
) -> None:
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
