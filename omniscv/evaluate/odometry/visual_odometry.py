"""Visual odometry on bearings: the motion of any central camera from its images.

1. SIFT features, as bearings, are followed from frame to frame.
2. The first frame with enough parallax to frame 0 gives the first points, and the unit of length.
3. The pose of each further frame follows from known points. Tracks with enough parallax become points, and
   the last frames are adjusted together (:mod:`omniscv.evaluate.odometry.adjustment`).

No loop is closed, so drift remains. Non-central cameras are not supported: a bearing alone does not determine
the line on which a point lies.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.evaluate.odometry.adjustment import Observations, adjust, meeting_points, residuals
from omniscv.evaluate.odometry.pose_estimation import absolute_pose, inner_mask, relative_pose
from omniscv.geometry import Array, Pose

_FEWEST = 15  # matches or points that agree on a pose
_RATIO = 0.8  # D. G. Lowe, IJCV 60, 2004, 7.1
_CONTRAST = 0.01
_PARALLAX = np.radians(2.0)
_WINDOW = 8  # frames that are adjusted together

Rows = NDArray[np.int64]
"""Indices of observations."""


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
        if motion is None or np.count_nonzero(motion[1]) < _FEWEST:
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


def estimate(features: Sequence[Features], limit_rad: float) -> dict[int, Pose]:
    """Return the poses of a sequence by frame, in the frame of the first, until tracking is lost.

    Args:
        features: of each frame, in their order.
        limit_rad: tolerance of bearings.
    """
    if not features:
        return {}
    odometry = Odometry(follow(features, limit_rad), limit_rad)
    if odometry.start():
        while odometry.extend():
            odometry.adjust(_WINDOW)
    return dict(enumerate(odometry.poses))


class Odometry:
    """Poses of the frames so far, and points.

    Args:
        seen: observations, ordered by frame; ``camera`` is the frame, ``point`` the track.
        limit_rad: tolerance of bearings.

    Attributes:
        poses: in the frame of the first camera.
        points: (P, 3) of the tracks; NaN where not known.
    """

    def __init__(self, seen: Observations, limit_rad: float) -> None:
        self.poses = [Pose(np.zeros(3), np.eye(3))]
        self.points = np.full((seen.point.max(initial=-1) + 1, 3), np.nan)
        self._seen, self._limit = seen, limit_rad
        self._frames = int(seen.camera.max(initial=0)) + 1

    def start(self) -> bool:
        """Estimate the frames up to the first with enough parallax to frame 0; False if there is none."""
        for frame in range(1, self._frames):
            rows, others = self._pairs(0, frame)
            first, second = self._seen.bearings[rows], self._seen.bearings[others]
            motion = relative_pose(first, second, self._limit)
            if motion is None or np.count_nonzero(motion[1]) < _FEWEST:
                return False
            T_0_frame, agree = motion
            if np.median(_angles(first, second @ T_0_frame.R_w_c.T)[agree]) > _PARALLAX:
                break
        else:
            return False
        self.poses += [T_0_frame] * frame
        self._triangulate(np.concatenate([rows[agree], others[agree]]))
        for i in range(1, frame):
            pose = self._resect(i)
            if pose is None:
                del self.poses[i:]
                return False
            self.poses[i] = pose
        return True

    def extend(self) -> bool:
        """Estimate the next frame; False if there is none, or too few known points agree with it."""
        frame = len(self.poses)
        pose = self._resect(frame) if frame < self._frames else None
        if pose is None:
            return False
        self.poses.append(pose)
        self._triangulate(self._rows(0, frame))
        return True

    def adjust(self, window: int) -> None:
        """Adjust the last frames and their points together; remove points that disagree."""
        last = len(self.poses) - 1
        first = max(0, last + 1 - window)
        rows = self._known(first, last)
        tracks, index = np.unique(self._seen.point[rows], return_inverse=True)
        seen = Observations(self._seen.camera[rows] - first, index, self._seen.bearings[rows])
        fixed = 2 if first else 1  # the scale is free until frame 0 leaves the window
        self.poses[first:], self.points[tracks] = adjust(
            self.poses[first:], self.points[tracks], seen, self._limit, fixed
        )
        self._remove(tracks, _largest(self._off(rows), index, len(tracks)) > self._limit)

    def _triangulate(self, rows: Rows) -> None:
        """Add the unknown points of observations that have enough parallax."""
        rows = rows[np.isnan(self.points[self._seen.point[rows], 0])]
        tracks, index = np.unique(self._seen.point[rows], return_inverse=True)
        frames = self._seen.camera[rows]
        R, t = self._stacked()
        directions = np.einsum("nij,nj->ni", R[frames], self._seen.bearings[rows])
        self.points[tracks] = meeting_points(t[frames], directions, index, len(tracks))
        mean = np.zeros((len(tracks), 3))
        np.add.at(mean, index, directions)
        apart = _largest(_angles(directions, mean[index]), index, len(tracks))
        off = _largest(self._off(rows), index, len(tracks))
        self._remove(tracks, (apart < _PARALLAX / 2) | (off > self._limit))

    def _resect(self, frame: int) -> Pose | None:
        """The pose of a frame from known points; None if too few agree."""
        rows = self._known(frame, frame)
        points, bearings = self.points[self._seen.point[rows]], self._seen.bearings[rows]
        found = absolute_pose(points, bearings, self._limit) if len(rows) >= _FEWEST else None
        return found[0] if found is not None and np.count_nonzero(found[1]) >= _FEWEST else None

    def _rows(self, first: int, last: int) -> Rows:
        """The observations of frames."""
        start, end = np.searchsorted(self._seen.camera, (first, last + 1))
        return np.arange(start, end)

    def _known(self, first: int, last: int) -> Rows:
        """The observations of known points in frames."""
        rows = self._rows(first, last)
        return np.asarray(rows[np.isfinite(self.points[self._seen.point[rows], 0])])

    def _pairs(self, one: int, other: int) -> tuple[Rows, Rows]:
        """Observations of the same points in two frames."""
        rows, others = self._rows(one, one), self._rows(other, other)
        tracks = self._seen.point
        _, a, b = np.intersect1d(tracks[rows], tracks[others], assume_unique=True, return_indices=True)
        return rows[a], others[b]

    def _off(self, rows: Rows) -> Array:
        """(M,) residuals of observations, sines."""
        seen = Observations(self._seen.camera[rows], self._seen.point[rows], self._seen.bearings[rows])
        return np.asarray(np.linalg.norm(residuals(*self._stacked(), self.points, seen), axis=1))

    def _stacked(self) -> tuple[Array, Array]:
        return np.array([p.R_w_c for p in self.poses]), np.array([p.position for p in self.poses])

    def _remove(self, tracks: Rows, wrong: NDArray[np.bool_]) -> None:
        self.points[tracks[wrong]] = np.nan


def _largest(values: Array, index: Rows, count: int) -> Array:
    """(count,) the largest of the values of each index."""
    largest = np.zeros(count)
    np.maximum.at(largest, index, values)
    return largest


def _angles(a: Array, b: Array) -> Array:
    """(N,) radians between vectors."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))
