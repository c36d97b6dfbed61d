"""The views of one optical centre side by side in one large picture, so that one remap serves them all.

For averaging, the picture also holds the views reduced to half, a quarter, ...: level 0, 1, 2, ...
Around each view can lie a border, resampled from the neighbouring views, for filters to reach into.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
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


@dataclass(eq=False)
class Atlas:
    """A layout, and the last picture laid out in it.

    Args:
        views: all of one size.
        levels: which reductions it holds: ``range(1)`` for the views alone.
        bordered: whether level 0 gets a border too; reduced ones always do.

    Raises:
        ArgumentError: more or larger views than fit.
    """

    views: Sequence[View]
    levels: range
    bordered: bool
    _shape: tuple[int, int] = field(init=False)
    _placed: list[Level] = field(init=False)
    _picture: NDArray[Any] | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self._placed, top, right = [], 0, 0
        for level in self.levels:
            bordered = self.bordered or level > 0
            width, height = reduced_size(self.views[0], level)
            pad = REACH if bordered else 0
            slot = np.array([width + 2 * pad, height + 2 * pad])
            columns = max(1, min(int(np.ceil(np.sqrt(len(self.views)))), _LIMIT // int(slot[0])))
            at = np.array([divmod(i, columns)[::-1] for i in range(len(self.views))])
            corners = at * slot + (pad, pad + top)
            border = Border(self.views, width, height) if bordered else None
            self._placed.append(Level(width, height, corners, border))
            top += int(slot[1]) * -(-len(self.views) // columns)
            right = max(right, int(slot[0]) * min(columns, len(self.views)))
        if max(top, right) > _LIMIT:
            raise ArgumentError(
                f"faces: expected {len(self.views)} views that fit into {_LIMIT} x {_LIMIT} px, got "
                f"{self.views[0].width} x {self.views[0].height} each"
            )
        self._shape = top, right

    def lay_out(self, faces: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """The picture of (h, w, C) faces, one per view; it is overwritten by the next one of its kind."""
        shape = (*self._shape, *faces[0].shape[2:])
        if self._picture is None or self._picture.shape != shape or self._picture.dtype != faces[0].dtype:
            self._picture = np.zeros(shape, faces[0].dtype)
        picture = self._picture
        for level in self._placed:
            own = (faces[0].shape[1], faces[0].shape[0]) == (level.width, level.height)
            size = None if own else (level.width, level.height)

            def place(k: int, level: Level = level, size: tuple[int, int] | None = size) -> NDArray[Any]:
                face = faces[k] if size is None else cv2.resize(faces[k], size, interpolation=cv2.INTER_AREA)
                x, y = level.corners[k]
                slot = picture[y : y + level.height, x : x + level.width]
                slot[...] = face
                return slot

            slots = side_by_side(place, range(len(faces)))
            if level.border is not None:
                level.border.fill(picture, slots, level.corners)
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
        view = self.views[0]
        corners = np.array([level.corners for level in self._placed], dtype=np.float64)
        scale = np.array([(lv.width / view.width, lv.height / view.height) for lv in self._placed])
        steps = np.zeros(count, np.float32) if steps is None else steps
        half = view.width / 2, view.height / 2

        def part(rows: slice) -> None:
            _to_atlas(
                places.view[rows], places.x[rows], places.y[rows], steps[rows], self.levels.start,
                view.focal_px, *half, scale, corners, x[rows], y[rows],
            )  # fmt: skip

        blocks(part, count)
        return x, y


def reduced_size(view: View, level: int) -> tuple[int, int]:
    """Width and height of a view at a level, px."""
    return max(1, round(view.width / 2**level)), max(1, round(view.height / 2**level))


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
    first: int,
    focal: float,
    half_width: float,
    half_height: float,
    scale: NDArray[np.float64],
    corners: NDArray[np.float64],
    out_x: NDArray[np.float32],
    out_y: NDArray[np.float32],
) -> None:
    last = scale.shape[0] - 1
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
        out_x[i] = x[i] * scale[level, 0] + corners[level, k, 0] - 0.5
        out_y[i] = y[i] * scale[level, 1] + corners[level, k, 1] - 0.5
