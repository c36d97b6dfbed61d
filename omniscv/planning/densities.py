"""How finely a camera samples the sphere, and the face that keeps up with it."""

import numpy as np

from omniscv.geometry import Array

_QUANTILE = 0.98  # of the pixels, by how finely they sample
_MULTIPLE = 8
_OVERSAMPLING = 1.2
"""By measurement: with less, faces of twice the size gain a tenth and more (test_face_size.py)."""
SMALLEST, LARGEST = 16, 8192


def steps(directions: Array) -> Array:
    """(H, W) angle in radians from each pixel's ray to the next one's, along the coarser of the two axes.

    NaN where a pixel has no valid neighbour. Near the poles of a panorama columns crowd, but rows, and so
    detail, do not: hence the coarser.

    Args:
        directions: (H, W, 3) unit, NaN where not valid.
    """
    found = []
    for axis in (0, 1):
        lines = np.moveaxis(directions, axis, 0)
        angle = np.full(lines.shape[:-1], np.nan)
        if len(lines) > 1:
            angle[:-1] = 2 * np.arcsin(np.clip(np.linalg.norm(lines[1:] - lines[:-1], axis=-1) / 2, 0, 1))
            angle[-1] = angle[-2]
        found.append(np.moveaxis(angle, 0, axis))
    return np.asarray(np.fmax(*found))


def face_size(steps: Array) -> int:
    """Edge in px of the smallest 90 degree face that loses no detail against the camera's own sampling.

    A face samples most coarsely at its centre, with its focal length, half its edge, in px per radian;
    interpolating between pixels that lie just as densely as the image's takes a little more.
    """
    found = steps[np.isfinite(steps) & (steps > 0)]
    if found.size == 0:
        return SMALLEST
    edge = 2 * _OVERSAMPLING / np.quantile(found, 1 - _QUANTILE)
    return int(np.clip(_MULTIPLE * np.ceil(edge / _MULTIPLE), SMALLEST, LARGEST))
