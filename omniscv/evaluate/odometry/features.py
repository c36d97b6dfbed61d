"""Features in the images of a central camera: bearings of points, and the tracks that follow them."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.evaluate.odometry.adjustment import Observations
from omniscv.evaluate.odometry.pose_estimation import inner_mask, relative_pose
from omniscv.geometry import Array

FEWEST = 15
"""Matches that agree on a motion; with fewer, two frames are not linked."""

_RATIO = 0.8  # D. G. Lowe, IJCV 60, 2004, 7.1
_CONTRAST = 0.01


class Features(NamedTuple):
    """Of one image.

    Attributes:
        bearings: (N, 3) float64, unit, camera frame.
        descriptors: (N, 128) float32, unit: square roots of SIFT's, as R. Arandjelovic and A. Zisserman,
            CVPR 2012, compare them.
    """

    bearings: Array
    descriptors: NDArray[np.float32]


def detect(grey: NDArray[np.uint8], camera: Camera, most: int) -> Features:
    """Return the SIFT features of an image.

    Args:
        grey: (H, W) uint8.
        camera: of the image, central.
        most: number of features, the strongest.
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
    rows, best = np.arange(len(likeness)), likeness.argmax(axis=1)
    mutual = likeness.argmax(axis=0)[best] == rows
    distance = 2 - 2 * likeness[rows, best]  # squared, of unit vectors
    likeness[rows, best] = -np.inf
    clear = distance < _RATIO**2 * (2 - 2 * likeness.max(axis=1))
    return np.asarray(np.column_stack([rows, best])[mutual & clear], np.int64)


def follow(features: Sequence[Features], limit_rad: float) -> Observations:
    """Return the tracks of a sequence until a frame does not continue the one before.

    Matches that disagree with the motion between two frames make no track.

    Args:
        features: of each frame, at least one.
        limit_rad: tolerance of bearings.

    Returns:
        All observations of points that two frames or more see, ordered by frame; ``camera`` is the frame,
        ``point`` the track.
    """
    ids = [np.arange(len(features[0].bearings))]
    count = len(ids[0])
    for before, after in pairwise(features):
        pairs = match(before, after)
        motion = relative_pose(before.bearings[pairs[:, 0]], after.bearings[pairs[:, 1]], limit_rad)
        if motion is None or np.count_nonzero(motion[1]) < FEWEST:
            break
        first, second = pairs[motion[1]].T
        new = np.arange(count, count + len(after.bearings))
        new[second] = ids[-1][first]
        ids.append(new)
        count += len(after.bearings)
    frame = np.repeat(np.arange(len(ids)), [len(part) for part in ids])
    bearings = np.concatenate([part.bearings for part in features[: len(ids)]])
    _, track, lengths = np.unique(np.concatenate(ids), return_inverse=True, return_counts=True)
    long = lengths[track] > 1
    return Observations(frame[long], np.unique(track[long], return_inverse=True)[1], bearings[long])
