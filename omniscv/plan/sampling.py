"""How finely a camera samples the sphere, and the face that keeps up with it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from omniscv.cameras import Camera, Rays
from omniscv.geometry import Array
from omniscv.plan.groups import rays_of

_QUANTILE = 0.98
_MULTIPLE = 8
_OVERSAMPLING = 1.2
"""By measurement: with less, faces of twice the size gain a tenth and more (test_face_size.py)."""
SMALLEST, LARGEST = 16, 8192


def steps(rays: Rays) -> Array:
    """(H, W) angle in radians from each pixel's ray to the next one's, along the coarser of the two axes.

    NaN where a pixel has no valid neighbour. Near the poles of a panorama columns crowd, but rows, and so
    detail, do not: hence the coarser.
    """
    found = []
    for axis in (0, 1):
        lines = np.moveaxis(rays.directions, axis, 0)
        angle = np.full(lines.shape[:-1], np.nan)
        if len(lines) > 1:
            angle[:-1] = 2 * np.arcsin(np.clip(np.linalg.norm(lines[1:] - lines[:-1], axis=-1) / 2, 0, 1))
            angle[-1] = angle[-2]
        found.append(np.moveaxis(angle, 0, axis))
    return np.asarray(np.fmax(*found))


def density(camera: Camera) -> float:
    """Pixels per radian where the camera samples finely: the 98th percentile over its valid pixels."""
    coarser = steps(rays_of(camera))
    coarser = coarser[np.isfinite(coarser) & (coarser > 0)]
    if coarser.size == 0:
        return SMALLEST / 2
    return float(1 / np.quantile(coarser, 1 - _QUANTILE))


@lru_cache(maxsize=8)
def face_size(camera: Camera) -> int:
    """Edge in px of the smallest 90 degree face that loses no detail against the camera's own sampling.

    A face samples most coarsely at its centre, with its focal length, half its edge, in px per radian;
    interpolating between pixels that lie just as densely as the image's takes a little more.
    """
    edge = 2 * _OVERSAMPLING * density(camera)
    return int(np.clip(_MULTIPLE * np.ceil(edge / _MULTIPLE), SMALLEST, LARGEST))
