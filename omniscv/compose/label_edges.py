"""Where a label may be another one than the nearest pixel's: beside what masks show as a boundary."""

from collections.abc import Sequence

import cv2
import numpy as np

from omniscv.compiled import njit
from omniscv.compose import kernels
from omniscv.compose.kernels import Faces, Floats, Ints, Mask
from omniscv.compose.nearest import beside_another, boundaries
from omniscv.compose.ray_lookup import RayLookup
from omniscv.geometry import Array
from omniscv.parallel import side_by_side
from omniscv.sources.base import View


def label_edges(
    faces: Faces, lookup: RayLookup, views: Sequence[View], parallax: Floats | None = None
) -> Mask:
    """Return (N,) whether rays lie within a pixel of a label boundary.

    Args:
        faces: (h, w) or (h, w, C) masks of each view.
        lookup: of N rays.
        views: those of the faces.
        parallax: (N,) radians, how far from the ray its surface may show; None: nowhere else.
    """
    if parallax is None:
        return beside_another(faces, lookup)
    out = np.empty(len(lookup.x), np.bool_)
    edge_px = np.stack(side_by_side(_px_to_boundary, boundaries(faces)))
    focal = np.array([view.focal_px for view in views])
    kernels.run(_near, (lookup.view, lookup.x, lookup.y, parallax, out), edge_px, focal)
    return out


def _px_to_boundary(boundary: Mask) -> Floats:
    """(h, w) px, along the farther axis, from each pixel to the next that has a neighbour of another kind."""
    if not boundary.any():
        return np.full(boundary.shape, np.inf, np.float32)
    return np.asarray(cv2.distanceTransform((~boundary).view(np.uint8), cv2.DIST_C, 3))


@njit(cache=True, nogil=True)
def _near(
    view: Ints, x: Floats, y: Floats, parallax: Floats, out: Mask, edge_px: Floats, focal: Array
) -> None:
    height, width = edge_px.shape[1], edge_px.shape[2]
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            out[i] = False
            continue
        c = min(max(int(np.floor(x[i])), 0), width - 1)
        r = min(max(int(np.floor(y[i])), 0), height - 1)
        u, v = (x[i] - width / 2) / focal[k], (y[i] - height / 2) / focal[k]
        border = min(min(c, r), min(width - 1 - c, height - 1 - r)) + 1.0  # what is beyond it may differ
        out[i] = min(edge_px[k, r, c], border) <= parallax[i] * focal[k] * (1.0 + u * u + v * v)
