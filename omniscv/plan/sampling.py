"""How finely a camera samples the sphere, and the face that keeps up with it."""

from __future__ import annotations

import numpy as np

from omniscv.cameras import Camera

_QUANTILE = 0.98
_MULTIPLE = 8
SMALLEST, LARGEST = 16, 8192


def density(camera: Camera) -> float:
    """Pixels per radian where the camera samples finely: the 98th percentile over its valid pixels.

    A pixel counts with the coarser of its two axes: near the poles of a panorama columns crowd, but
    rows, and so detail, do not.
    """
    rays = camera.unproject()
    steps = []
    for axis in (0, 1):
        a, b = np.moveaxis(rays.directions, axis, 0)[:-1], np.moveaxis(rays.directions, axis, 0)[1:]
        angle = 2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1))
        full = np.full(rays.valid.shape, np.nan)
        np.moveaxis(full, axis, 0)[:-1] = angle
        steps.append(full)
    coarser = np.fmax(*steps)
    coarser = coarser[np.isfinite(coarser) & (coarser > 0)]
    if coarser.size == 0:
        return SMALLEST / 2
    return float(1 / np.quantile(coarser, 1 - _QUANTILE))


def face_size(camera: Camera) -> int:
    """Edge in px of the smallest 90 degree face that loses no detail against the camera's own sampling.

    A face samples most coarsely at its centre, with its focal length, half its edge, in px per radian.
    """
    edge = 2 * density(camera)
    return int(np.clip(_MULTIPLE * np.ceil(edge / _MULTIPLE), SMALLEST, LARGEST))
