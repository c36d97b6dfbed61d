"""How finely a camera samples the sphere, and the views that keep up with it.

Two things ask for pixels. Detail in colours: views sample as densely as the camera does, along the coarser of
its axes (the finer one, where both differ, adds nothing by measurement). And edges in masks and depth, which
are not blended: there a pixel is wrong if an edge runs between its ray and the nearest of the view's, so that
the wrong part of an image is the length of the edges per solid angle times the angle between the view's
pixels, whatever the camera's own sampling. Small images of much of a room need views finer than they are.
"""

import numpy as np

from omniscv.geometry import Array

_QUANTILE = 0.98  # of the pixels, by how finely they sample
_MULTIPLE = 8
_OVERSAMPLING = 1.2
"""By measurement: with less, faces of twice the size gain a tenth and more (test_face_size.py)."""
SMALLEST, LARGEST = 384, 8192
"""px of a 90 degree face. With the smallest, 0.8 % of the labels are wrong at most in rooms, and points lie
within 16 mm of a surface (test_enough_pixels.py); a capture takes about as long as one of a single pixel."""


_PARALLEL_M = 2.0
"""From where a step between parallel rays is seen as an angle, metres: about as far are surfaces in rooms."""


def steps(directions: Array, origins: Array | None = None) -> Array:
    """(H, W) angle in radians from each pixel's ray to the next one's, along the coarser of the two axes.

    NaN where a pixel has no valid neighbour. Near the poles of a panorama columns crowd, but rows, and so
    detail, do not: hence the coarser. The step between parallel rays is that between their origins, seen
    from 2 m.

    Args:
        directions: (H, W, 3) unit, NaN where not valid.
        origins: (H, W, 3) metres; None: one for all.
    """
    found = []
    for axis in (0, 1):
        lines = np.moveaxis(directions, axis, 0)
        angle = np.full(lines.shape[:-1], np.nan)
        if len(lines) > 1:
            angle[:-1] = 2 * np.arcsin(np.clip(np.linalg.norm(lines[1:] - lines[:-1], axis=-1) / 2, 0, 1))
            if origins is not None and (angle == 0).any():
                apart = np.linalg.norm(np.diff(origins, axis=axis), axis=-1) / _PARALLEL_M
                angle[:-1] = np.where(angle[:-1] == 0, np.moveaxis(apart, axis, 0), angle[:-1])
            angle[-1] = angle[-2]
        found.append(np.moveaxis(angle, 0, axis))
    return np.asarray(np.fmax(*found))


def focal_px(steps: Array, smallest: int = SMALLEST) -> float:
    """Return the least focal length, px per radian, of views that lose no detail and few edges.

    A view samples most coarsely at its centre, with its focal length; interpolating between pixels that
    lie just as densely as the image's takes a little more.

    Args:
        steps: of a camera's pixels, or of those that a view shows.
        smallest: px of a 90 degree face that edges take.
    """
    found = steps[np.isfinite(steps) & (steps > 0)]
    if not found.size:
        return smallest / 2
    dense = 1 / np.quantile(found, 1 - _QUANTILE, overwrite_input=True)  # px per radian where it is fine
    return max(smallest / 2, _OVERSAMPLING * float(dense))


def face_size(steps: Array, smallest: int = SMALLEST) -> int:
    """Return the edge in px of the smallest 90 degree face with that focal length, at most LARGEST."""
    return min(int(_MULTIPLE * np.ceil(2 * focal_px(steps, smallest) / _MULTIPLE)), LARGEST)
