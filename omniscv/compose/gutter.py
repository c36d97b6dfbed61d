"""The gutter around each tile of an atlas, resampled from the views that see what lies there.

A filter at the edge of a view needs pixels beyond it. Where views are not captured wider than their rays
need, the neighbours have what is missing, though on another plane: the ray of each pixel of the gutter is
looked up in them. Where no neighbour sees it, the view's own edge is continued.
"""

from collections.abc import Sequence

import numpy as np

from omniscv.compose.bicubic import sample_bicubic
from omniscv.compose.folding import remap
from omniscv.compose.kernels import Ints, Pixels
from omniscv.compose.ray_lookup import look_up
from omniscv.geometry import pinhole
from omniscv.sources.base import View

FILTER_SUPPORT_PX = 2
"""Pixels beyond a point that bicubic, the widest interpolation, needs."""


class Gutter:
    """The gutters of views, at their own resolution or at a mip level.

    Args:
        views: all of one size, from one centre.
        level: the mip level.
        support: px of the gutter.
        bicubic: whether neighbours are resampled by the better and slower filter.
    """

    def __init__(self, views: Sequence[View], level: int, support: int, bicubic: bool) -> None:
        width, height, scale = views[0].width >> level, views[0].height >> level, 0.5**level
        ring = _ring(width, height, support)
        self._ring, self._bicubic = ring, bicubic
        in_view, pixels = [], []
        for k, view in enumerate(views):
            at = (ring + 0.5) / scale
            rays_w = pinhole.rays(at, view.focal_px, view.width, view.height) @ view.pose.R_w_c.T
            others = [i for i in range(len(views)) if i != k]
            source = np.full(len(ring), k)
            pixel = ring.astype(np.float64)
            if others:
                found = look_up(rays_w, [views[i] for i in others])
                seen = found.view >= 0
                source[seen] = np.array(others)[found.view[seen]]
                pixel[seen] = np.stack([found.x, found.y], axis=1)[seen] * scale - 0.5
            in_view.append(source)
            pixels.append(np.clip(pixel, 0, (width - 1, height - 1)))
        self._source, self._pixel = np.array(in_view), np.array(pixels)

    def fill(self, picture: Pixels, corners: Ints) -> None:
        """Write the gutter of every view into a picture that holds the views.

        Args:
            picture: the atlas.
            corners: (V, 2) x and y of each view's first pixel.
        """
        at = self._pixel + corners[self._source]
        x, y = np.ascontiguousarray(at.reshape(-1, 2).T, dtype=np.float32)
        column, row = np.moveaxis(self._ring[None] + corners[:, None], -1, 0)
        picture[row.ravel(), column.ravel()] = remap(picture, x, y)
        if self._bicubic:  # again: at the very edge of a neighbour it needs that one's gutter
            picture[row.ravel(), column.ravel()] = sample_bicubic(picture, x, y)


def _ring(width: int, height: int, support: int) -> Ints:
    """Return (N, 2) the pixels (x, y) within so many of a view, outside it."""
    across, down = np.arange(-support, width + support), np.arange(height)
    above, below = np.arange(-support, 0), np.arange(height, height + support)
    left, right = np.arange(-support, 0), np.arange(width, width + support)
    bands = [(across, above), (across, below), (left, down), (right, down)]
    return np.concatenate([np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) for x, y in bands])
