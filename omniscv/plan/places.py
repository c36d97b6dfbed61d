"""Where in a set of views each ray is seen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from omniscv.captures.view import View
from omniscv.geometry import Array


class Places(NamedTuple):
    """For each ray: the view that sees it most centrally, -1 for none, and the continuous pixel there."""

    view: NDArray[np.int16]
    x: NDArray[np.float32]
    y: NDArray[np.float32]


def locate(directions_w: Array, views: Sequence[View]) -> Places:
    """The view and place that serve each ray from the views' common centre.

    Args:
        directions_w: (N, 3) world frame, any length; NaN rays get view -1.
        views: at least one; they share their centre and size.

    Returns:
        Places of shape (N,); pixel centres lie at .5.
    """
    count = len(directions_w)
    view, x, y = np.empty(count, np.int16), np.empty(count, np.float32), np.empty(count, np.float32)
    R_c_w = np.ascontiguousarray([v.pose.R_w_c.T for v in views])
    focal = np.array([v.focal_px for v in views])
    _locate(
        np.ascontiguousarray(directions_w), R_c_w, focal, views[0].width / 2, views[0].height / 2, view, x, y
    )
    return Places(view, x, y)


@njit(cache=True, nogil=True)
def _locate(
    directions: Array,
    R_c_w: Array,
    focal: Array,
    half_width: float,
    half_height: float,
    view: NDArray[np.int16],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
) -> None:
    for i in range(directions.shape[0]):
        a, b, c = directions[i, 0], directions[i, 1], directions[i, 2]
        best, which, best_u, best_v = 1.0 + 1e-9, -1, 0.0, 0.0
        for k in range(R_c_w.shape[0]):
            R = R_c_w[k]
            z = R[2, 0] * a + R[2, 1] * b + R[2, 2] * c
            if not z > 0.0:
                continue
            u = focal[k] * (R[0, 0] * a + R[0, 1] * b + R[0, 2] * c) / z
            v = focal[k] * (R[1, 0] * a + R[1, 1] * b + R[1, 2] * c) / z
            off = max(abs(u) / half_width, abs(v) / half_height)
            if off < best:
                best, which, best_u, best_v = off, k, u, v
        view[i], x[i], y[i] = which, best_u + half_width, best_v + half_height
