"""Depth between pixels: exact on planes, and never a point between two surfaces.

On a plane 1 / (planar depth) is linear in the pixel, so bilinear interpolation of it is exact. Across the
edge of an object it would put points in the air: there the nearest pixel's own surface is taken.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit

from omniscv.compose import kernels
from omniscv.compose.kernels import Floats, Ints
from omniscv.compose.ray_lookup import RayLookup
from omniscv.geometry import Array
from omniscv.geometry.surfaces import interpolated, one_surface
from omniscv.sources.base import View


def sample_depth(faces: Sequence[Floats], lookup: RayLookup, views: Sequence[View], nearest: bool) -> Floats:
    """Return the distance along N rays.

    Args:
        faces: (h, w) planar metres of each view, +inf where there is no surface.
        lookup: of N rays.
        views: those of the faces.
        nearest: take the nearest pixel's plane everywhere.

    Returns:
        (N,) float32 metres along the ray; 0 where no view sees it.
    """
    out, focal = np.empty_like(lookup.x), np.array([view.focal_px for view in views])
    kernels.run(_sample, (lookup.view, lookup.x, lookup.y, out), np.stack(faces), focal, nearest)
    return out


@njit(cache=True, nogil=True)
def _sample(
    view: Ints, x: Floats, y: Floats, out: Floats, stack: Floats, focal: Array, nearest: bool
) -> None:
    height, width = stack.shape[1], stack.shape[2]
    for i in range(view.shape[0]):
        k = view[i]
        if k < 0:
            out[i] = 0.0
            continue
        face = stack[k]
        px, py = x[i] - 0.5, y[i] - 0.5
        z = 0.0
        c, r = int(np.floor(px)), int(np.floor(py))
        if not nearest and 1 <= c < width - 2 and 1 <= r < height - 2 and one_surface(face, r, c):
            z = interpolated(face, r, c, px - c, py - r)
        else:
            c = min(max(int(np.floor(x[i])), 0), width - 1)
            r = min(max(int(np.floor(y[i])), 0), height - 1)
            z = face[r, c]
        u, v = (x[i] - width / 2) / focal[k], (y[i] - height / 2) / focal[k]
        out[i] = z * np.sqrt(1.0 + u * u + v * v)
