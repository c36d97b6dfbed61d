"""Normals between pixels, blended on one smooth surface, never across an edge or a crease; or from depth."""

from collections.abc import Sequence

import numpy as np

from omniscv.compiled import njit
from omniscv.compose import kernels
from omniscv.compose.kernels import Faces, Floats, Ints
from omniscv.compose.ray_lookup import RayLookup
from omniscv.geometry import Array
from omniscv.geometry.surfaces import allowed_step, inverse_depth
from omniscv.sources.base import View

_ONE_SURFACE = 0.95
"""The cosine of the angle that two pixels' normals may make on one smooth surface, 18 degrees."""
_AROUND_PX = 3
"""A plane is fitted to so many pixels on every side: half floats jump by more than one pixel slopes."""


def sample_directions(faces: Faces, lookup: RayLookup, nearest: bool) -> Floats:
    """Return the unit vectors that N rays meet.

    Args:
        faces: (h, w, 3) unit vectors of each view, 0 where unknown.
        lookup: of N rays.
        nearest: take the nearest pixel's everywhere.

    Returns:
        (N, 3) float32, 0 where unknown or where no view sees the ray.
    """
    out = np.empty((len(lookup.x), 3), np.float32)
    kernels.run(_sample, (lookup.view, lookup.x, lookup.y, out), kernels.stacked(faces), nearest)
    return out


@njit(cache=True, nogil=True)
def _sample(view: Ints, x: Floats, y: Floats, out: Floats, stack: Floats, nearest: bool) -> None:
    height, width = stack.shape[1], stack.shape[2]
    for i in range(view.shape[0]):
        k = view[i]
        out[i, 0] = out[i, 1] = out[i, 2] = 0.0
        if k < 0:
            continue
        face = stack[k]
        own_c = min(max(int(np.floor(x[i])), 0), width - 1)
        own_r = min(max(int(np.floor(y[i])), 0), height - 1)
        c, r = int(np.floor(x[i] - 0.5)), int(np.floor(y[i] - 0.5))
        inside = 0 <= c < width - 1 and 0 <= r < height - 1
        if nearest or not inside or not _one_surface(face, r, c, own_r, own_c):
            for j in range(3):
                out[i, j] = face[own_r, own_c, j]
            continue
        a, b = x[i] - 0.5 - c, y[i] - 0.5 - r
        square = 0.0
        for j in range(3):
            above = (1 - a) * face[r, c, j] + a * face[r, c + 1, j]
            below = (1 - a) * face[r + 1, c, j] + a * face[r + 1, c + 1, j]
            out[i, j] = (1 - b) * above + b * below
            square += out[i, j] * out[i, j]
        for j in range(3):
            out[i, j] /= np.sqrt(square)


@njit(cache=True, nogil=True)
def _one_surface(face: Floats, r: int, c: int, own_r: int, own_c: int) -> bool:
    for j in range(r, r + 2):
        for k in range(c, c + 2):
            cosine = 0.0
            for n in range(3):
                cosine += face[j, k, n] * face[own_r, own_c, n]
            if cosine < _ONE_SURFACE:
                return False
    return True


def normals_from_depth(faces: Faces, lookup: RayLookup, views: Sequence[View]) -> Floats:
    """Return the normals of planes fitted to planar depth around the nearest pixels of N rays.

    On a plane 1 / z is linear in the pixel, and its slopes are the plane's coefficients.

    Args:
        faces: (h, w) planar metres of each view, +inf where there is no surface.
        lookup: of N rays.
        views: those of the faces.

    Returns:
        (N, 3) float32 unit vectors toward the views' centre, world frame; 0 where there is no surface, or
        where too few pixels show it.
    """
    out = np.empty((len(lookup.x), 3), np.float32)
    focal = np.array([view.focal_px for view in views])
    R_w_c = np.array([view.pose.R_w_c for view in views])
    kernels.run(_fit, (lookup.view, lookup.x, lookup.y, out), kernels.stacked(faces), focal, R_w_c)
    return out


@njit(cache=True, nogil=True)
def _fit(view: Ints, x: Floats, y: Floats, out: Floats, stack: Floats, focal: Array, R_w_c: Array) -> None:
    height, width = stack.shape[1], stack.shape[2]
    for i in range(view.shape[0]):
        k = view[i]
        out[i, 0] = out[i, 1] = out[i, 2] = 0.0
        if k < 0:
            continue
        c = min(max(int(np.floor(x[i])), 0), width - 1)
        r = min(max(int(np.floor(y[i])), 0), height - 1)
        if not stack[k, r, c] < np.inf:
            continue
        inverse, across, down, known = _plane(stack[k], r, c)
        if not known:
            continue
        a, b = across * focal[k], down * focal[k]
        e = inverse - across * (c + 0.5 - width / 2) - down * (r + 0.5 - height / 2)
        size = np.sqrt(a * a + b * b + e * e)
        for j in range(3):
            out[i, j] = -(R_w_c[k, j, 0] * a + R_w_c[k, j, 1] * b + R_w_c[k, j, 2] * e) / size


@njit(cache=True, nogil=True)
def _plane(face: Floats, r: int, c: int) -> tuple[float, float, float, bool]:
    """1 / z at a pixel and its slopes, by least squares over the pixels around that continue its surface."""
    across, down = _start(face, r, c, 0, 1), _start(face, r, c, 1, 0)
    here, allowed = inverse_depth(face[r, c]), allowed_step(face[r, c])
    normal, right = np.zeros((3, 3)), np.zeros(3)
    count = 0
    for j in range(max(r - _AROUND_PX, 0), min(r + _AROUND_PX + 1, face.shape[0])):
        for k in range(max(c - _AROUND_PX, 0), min(c + _AROUND_PX + 1, face.shape[1])):
            dx, dy, value = float(k - c), float(j - r), inverse_depth(face[j, k])
            steps = max(1.0, abs(dx), abs(dy))
            if abs(value - here - across * dx - down * dy) > allowed * steps:
                continue
            count += 1
            row = (1.0, dx, dy)
            for p in range(3):
                right[p] += row[p] * value
                for q in range(3):
                    normal[p, q] += row[p] * row[q]
    if count < 3 or abs(np.linalg.det(normal)) < 0.5:  # whole numbers: 0 where the pixels lie on a line
        return here, 0.0, 0.0, False
    fitted = np.linalg.solve(normal, right)
    return fitted[0], fitted[1], fitted[2], True


@njit(cache=True, nogil=True)
def _start(face: Floats, r: int, c: int, down: int, across: int) -> float:
    """The slope of 1 / z along an axis, of the smaller step to a neighbour: on the pixel's own surface."""
    least, slope = np.inf, 0.0
    for sign in (-1, 1):
        j, k = r + sign * down, c + sign * across
        if 0 <= j < face.shape[0] and 0 <= k < face.shape[1] and face[j, k] < np.inf:
            step = inverse_depth(face[j, k]) - inverse_depth(face[r, c])
            if abs(step) < least:
                least, slope = abs(step), sign * step
    return slope
