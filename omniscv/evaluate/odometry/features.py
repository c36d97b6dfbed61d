"""Features in the images of a central camera: the bearings of points, and what they look like."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.geometry import Array

_RATIO = 0.8  # D. G. Lowe, IJCV 60, 2004, 7.1
_CONTRAST = 0.01
_RIM_PX = 6  # SIFT finds the rim of the image circle; what is this near to it is left out


class Features(NamedTuple):
    """Of one image.

    Attributes:
        bearings: (N, 3) float64, unit, camera frame.
        descriptors: (N, 128) float32, unit: square roots of SIFT's, as R. Arandjelovic and A. Zisserman,
            CVPR 2012, compare them.
    """

    bearings: Array
    descriptors: NDArray[np.float32]


def inner_mask(camera: Camera) -> NDArray[np.uint8]:
    """(H, W) 255 where a feature cannot be the rim of the field of view, else 0."""
    valid = np.asarray(camera.valid(), np.uint8) * 255
    around = np.ones((2 * _RIM_PX + 1, 2 * _RIM_PX + 1), np.uint8)
    return np.asarray(cv2.erode(valid, around, borderType=cv2.BORDER_CONSTANT, borderValue=255), np.uint8)


def detect(grey: NDArray[np.uint8], camera: Camera, most: int) -> Features:
    """Return the SIFT features of an image.

    Args:
        grey: (H, W) uint8.
        camera: that took it, central.
        most: how many, the strongest.
    """
    # Without precise upscaling, OpenCV's features lie a quarter of a pixel too far to the right and below.
    sift = cv2.SIFT.create(nfeatures=most, contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    points, found = sift.detectAndCompute(grey, inner_mask(camera))
    if found is None:
        return Features(np.zeros((0, 3)), np.zeros((0, 128), np.float32))
    pixels = np.array([point.pt for point in points]) + 0.5  # OpenCV counts from pixel centres
    rays = camera.unproject(np.clip(pixels, 0, (camera.width, camera.height)))
    descriptors = np.sqrt(found / np.maximum(found.sum(axis=1, keepdims=True), 1e-6))
    return Features(rays.directions[rays.valid], descriptors[rays.valid].astype(np.float32))


def match(first: Features, second: Features) -> NDArray[np.int64]:
    """Return (M, 2) indices of features that are each other's nearest, and clearly nearer than the next."""
    if min(len(first.bearings), len(second.bearings)) < 2:
        return np.zeros((0, 2), np.int64)
    likeness = first.descriptors @ second.descriptors.T
    forth, back = _clear_partners(likeness), likeness.argmax(axis=0)
    rows = np.flatnonzero(forth >= 0)
    rows = rows[back[forth[rows]] == rows]
    return np.stack([rows, forth[rows]], axis=1)


def _clear_partners(likeness: NDArray[np.float32]) -> NDArray[np.int64]:
    """(N,) of each row the column that is most alike; -1 where the second is nearly so."""
    rows = np.arange(len(likeness))
    best = likeness.argmax(axis=1)
    distance = 2 - 2 * likeness[rows, best]  # squared, of unit vectors
    others = likeness.copy()
    others[rows, best] = -np.inf
    clear = distance < _RATIO**2 * (2 - 2 * others.max(axis=1))
    return np.where(clear, best, -1)
