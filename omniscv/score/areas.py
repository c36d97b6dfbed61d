"""How much of the sphere each pixel of a central camera sees."""

from functools import lru_cache

import numpy as np

from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Ints, Mask

_TO_A_CORNER = 0.5 - 1e-4
"""px from a pixel's middle: at the very corner the ray may be that of another face of a cube."""
_KEPT = 4  # cameras whose solid angles are kept in memory
_PARTS = 16  # of a pixel along each axis, where the end of the field of view cuts it


@lru_cache(_KEPT)
def solid_angles(camera: Camera) -> Array:
    """Return (H, W) the solid angles of pixels, steradians, read-only; 0 where a pixel sees nothing.

    A pixel is the spherical quadrilateral between the rays of its corners, two triangles. Source: Van
    Oosterom and Strackee, The solid angle of a plane triangle, 1983. Pixels that the end of the field of
    view cuts are measured in parts; their middle may see nothing. The sum over an image circle is exact to
    1e-4, but to 1e-3 of an orthographic fisheye of 180 degrees, whose rim sees without bound.

    Args:
        camera: with one optical centre.

    Raises:
        ArgumentError: the camera has several.
    """
    if not camera.central:
        raise ArgumentError(f"camera: expected one with one optical centre, got {camera.name!r}")
    corners = []
    whole = np.ones((camera.height, camera.width), np.bool_)
    touched = camera.valid()
    for down, across in ((-1, -1), (-1, 1), (1, 1), (1, -1)):
        rays = camera.unproject(camera.pixels() + _TO_A_CORNER * np.array([across, down]))
        corners.append(np.where(rays.valid[..., None], rays.directions, 0.0))
        whole &= rays.valid
        touched = touched | rays.valid
    a, b, c, d = corners
    areas = (_triangle(a, b, c) + _triangle(a, c, d)) / (2 * _TO_A_CORNER) ** 2
    areas[~whole] = 0
    rows, columns = np.nonzero(touched & ~whole)
    if len(rows):
        areas[rows, columns] = _areas_of_parts(camera, rows, columns)
    areas.flags.writeable = False
    return areas


@lru_cache(_KEPT)
def seen_pixels(camera: Camera) -> Mask:
    """Return (H, W) bool which pixels of a camera see something, read-only; kept for a few cameras."""
    valid = camera.valid()
    valid.flags.writeable = False
    return valid


def _triangle(a: Array, b: Array, c: Array) -> Array:
    """Return the solid angles of spherical triangles of unit vectors (..., 3)."""
    volume = np.abs((a * np.cross(b, c)).sum(axis=-1))
    cosines = 1 + (a * b).sum(axis=-1) + (b * c).sum(axis=-1) + (c * a).sum(axis=-1)
    return np.asarray(2 * np.arctan2(volume, cosines))


def _areas_of_parts(camera: Camera, rows: Ints, columns: Ints) -> Array:
    """Return the solid angles of pixels, by the parts of them that have a ray."""
    step = 1 / _PARTS
    total = np.zeros(len(rows))
    for i in range(_PARTS):
        for j in range(_PARTS):
            u = columns + (j + 0.5) * step
            v = rows + (i + 0.5) * step
            middle = camera.unproject(np.stack([u, v], axis=-1))
            beside = camera.unproject(np.stack([u + 1e-4, v], axis=-1))
            below = camera.unproject(np.stack([u, v + 1e-4], axis=-1))
            known = middle.valid & beside.valid & below.valid
            across = np.where(known[:, None], beside.directions - middle.directions, 0) / 1e-4
            down = np.where(known[:, None], below.directions - middle.directions, 0) / 1e-4
            total += np.linalg.norm(np.cross(across, down), axis=-1) * step * step
    return total
