"""What lies just beyond a view's edges, resampled from the views that see it.

A filter at the edge of a view needs pixels beyond it. Where views are not captured wider than their rays
need, the neighbours have what is missing, though on another plane: each border pixel's ray is looked up in
them. Where no neighbour sees it, the view's own edge is continued.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.captures.view import View
from omniscv.compose.bicubic import sample_bicubic
from omniscv.plan.places import locate

REACH = 2
"""Pixels that the widest filter, bicubic, reaches beyond a place."""

_ROW = 1 << 12


class Border:
    """The border of views, as they are or reduced.

    Args:
        views: all of one size, from one centre.
        width, height: px of a view as reduced.
        scale: its pixels per pixel of the view.
        origin: where in the view the centre of its first pixel lies.
        bicubic: whether neighbours are resampled by the better and slower filter.
    """

    def __init__(
        self, views: Sequence[View], width: int, height: int, scale: float, origin: float, bicubic: bool
    ) -> None:
        rim = _rim(width, height)
        self._rim, self._bicubic = rim, bicubic
        from_view, places = [], []
        for k, view in enumerate(views):
            px = rim / scale + origin - (view.width / 2, view.height / 2)
            rays_w = np.concatenate([px / view.focal_px, np.ones((len(px), 1))], axis=1) @ view.pose.R_w_c.T
            others = [i for i in range(len(views)) if i != k]
            source = np.full(len(rim), k)
            place = rim.astype(np.float64)
            if others:
                found = locate(rays_w, [views[i] for i in others])
                seen = found.view >= 0
                source[seen] = np.array(others)[found.view[seen]]
                place[seen] = (np.stack([found.x, found.y], axis=1)[seen] - origin) * scale
            from_view.append(source)
            places.append(np.clip(place, 0, (width - 1, height - 1)))
        self._source, self._place = np.array(from_view), np.array(places)

    def fill(self, picture: NDArray[Any], corners: NDArray[np.int64]) -> None:
        """Writes the border of every view into a picture that holds the views.

        Args:
            picture: the atlas.
            corners: (V, 2) x and y of each view's first pixel.
        """
        at = self._place + corners[self._source]
        count = at.shape[0] * at.shape[1]
        rows = -(-count // _ROW)
        x, y = np.zeros((2, rows * _ROW), np.float32)
        x[:count], y[:count] = at.reshape(-1, 2).T
        x, y = x.reshape(rows, _ROW), y.reshape(rows, _ROW)
        column, row = np.moveaxis(self._rim[None] + corners[:, None], -1, 0)
        values = cv2.remap(picture, x, y, cv2.INTER_LINEAR)
        picture[row.ravel(), column.ravel()] = values.reshape(-1, *picture.shape[2:])[:count]
        if self._bicubic:  # again: at the very edge of a neighbour it reaches into that one's border
            values = sample_bicubic(picture, x, y)
            picture[row.ravel(), column.ravel()] = values.reshape(-1, *picture.shape[2:])[:count]


def _rim(width: int, height: int) -> NDArray[np.int64]:
    """(N, 2) the pixels (x, y) within REACH of a view, outside it."""
    across, down = np.arange(-REACH, width + REACH), np.arange(height)
    above, below = np.arange(-REACH, 0), np.arange(height, height + REACH)
    left, right = np.arange(-REACH, 0), np.arange(width, width + REACH)
    bands = [(across, above), (across, below), (left, down), (right, down)]
    return np.concatenate([np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) for x, y in bands])
