"""Visual odometry on bearings: the motion of any central camera from its images.

1. Features are followed from frame to frame (:mod:`omniscv.evaluate.odometry.tracks`).
2. The first frame with enough parallax to frame 0 gives the first points, and the unit of length.
3. A further frame is turned as its essential matrix says; how far it moved follows from points that are
   known, and its pose is fitted to them. Tracks seen from far enough apart become points, and the last frames
   are adjusted together (:mod:`omniscv.evaluate.odometry.adjustment`).

No loop is closed: what drifts stays. Cameras whose rays do not share one origin are not served: the bearing
alone does not fix the line on which a point lies.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omniscv.evaluate.odometry.adjustment import Observations, adjust, meeting_points, resect, residuals
from omniscv.evaluate.odometry.features import Features
from omniscv.evaluate.odometry.tracks import FEWEST, Tracks, follow
from omniscv.evaluate.odometry.two_views import relative_pose
from omniscv.geometry import Array, Pose

_PARALLAX = np.radians(2.0)
_WINDOW = 8  # frames that are adjusted together
_HELD = 2  # of them, for the frame and the scale

Rows = NDArray[np.int64]


def estimate(features: Sequence[Features], limit_rad: float) -> dict[int, Pose]:
    """Return the poses of a sequence by frame, in the frame of the first, up to where it is lost.

    Args:
        features: of each frame, in their order.
        limit_rad: the angle by which a bearing may be off.
    """
    if not features:
        return {}
    chain = Chain(follow(features, limit_rad), limit_rad)
    if chain.start():
        while chain.extend():
            chain.adjust(_WINDOW)
    return dict(enumerate(chain.poses))


class Chain:
    """Poses of the frames so far, and points.

    Attributes:
        poses: in the frame of the first camera.
        points: (P, 3) of the tracks; NaN where not known.
    """

    def __init__(self, tracks: Tracks, limit_rad: float) -> None:
        self.poses = [Pose(np.zeros(3), np.eye(3))]
        self.points = np.full((tracks.count, 3), np.nan)
        self._steps, self._seen, self._limit = tracks.steps, tracks.seen, limit_rad

    def start(self) -> bool:
        """Place the frames up to the first with enough parallax to frame 0; return whether there is one."""
        for frame in range(1, len(self._steps) + 1):
            rows, others = self._pairs(0, frame)
            first, second = self._seen.bearings[rows], self._seen.bearings[others]
            found = relative_pose(first, second, self._limit)
            if found is None or np.count_nonzero(found.agree) < FEWEST:
                return False
            apart = _angles(first, second @ found.T_1_2.R_w_c.T)[found.agree]
            if np.median(apart) > _PARALLAX:
                break
        else:
            return False
        self.poses += [self.poses[0].interpolate(found.T_1_2, i / frame) for i in range(1, frame + 1)]
        self._triangulate(np.concatenate([rows[found.agree], others[found.agree]]))
        for i in range(1, frame):
            self.poses[i] = self._fitted(i, self.poses[i])
        return True

    def extend(self) -> bool:
        """Place the next frame; return whether there is one that enough known points agree with."""
        frame = len(self.poses)
        if frame > len(self._steps) or len(self._known(frame, frame)) < FEWEST:
            return False
        self.poses.append(self._fitted(frame, self.poses[-1] @ self._scaled(frame)))
        if np.count_nonzero(self._off(self._known(frame, frame)) < self._limit) < FEWEST:
            self.poses.pop()
            return False
        self._triangulate(self._rows(0, frame))
        return True

    def adjust(self, window: int) -> None:
        """Adjust the last frames and their points together; forget points that disagree."""
        last = len(self.poses) - 1
        first = max(0, last + 1 - window)
        rows = self._known(first, last)
        tracks, index = np.unique(self._seen.point[rows], return_inverse=True)
        seen = Observations(self._seen.camera[rows] - first, index, self._seen.bearings[rows])
        self.poses[first:], self.points[tracks] = adjust(
            self.poses[first:], self.points[tracks], seen, self._limit, held=_HELD
        )
        self._forget(tracks, _largest(self._off(rows), index, len(tracks)) > self._limit)

    def _triangulate(self, rows: Rows) -> None:
        """Place the points of observations that are not known yet, seen from far enough apart."""
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
        self._forget(tracks, (apart < _PARALLAX / 2) | (off > self._limit))

    def _fitted(self, frame: int, guess: Pose) -> Pose:
        """The pose of a frame that the known points agree with."""
        rows = self._known(frame, frame)
        return resect(guess, self.points[self._seen.point[rows]], self._seen.bearings[rows], self._limit)

    def _scaled(self, frame: int) -> Pose:
        """The step to a frame, as long as known points say.

        A point p and its bearing d, both turned as the frame before, have ``d x (p - s u) = 0`` for a step u.
        """
        step, rows = self._steps[frame - 1], self._known(frame, frame)
        p = self.poses[-1].to_camera(self.points[self._seen.point[rows]])
        d = self._seen.bearings[rows] @ step.R_w_c.T
        by_step, by_point = np.cross(d, step.position), np.cross(d, p)
        squared = (by_step**2).sum(axis=1)
        clear = squared >= np.median(squared)
        lengths = (by_step * by_point).sum(axis=1)[clear] / np.maximum(squared[clear], 1e-12)
        return Pose(np.median(lengths) * step.position, step.R_w_c)

    def _rows(self, first: int, last: int) -> Rows:
        """The observations of frames; these are in the order of frames."""
        start, end = np.searchsorted(self._seen.camera, (first, last + 1))
        return np.arange(start, end)

    def _known(self, first: int, last: int) -> Rows:
        """Of these, the observations of known points."""
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

    def _forget(self, tracks: Rows, wrong: NDArray[np.bool_]) -> None:
        self.points[tracks[wrong]] = np.nan


def _largest(values: Array, index: Rows, count: int) -> Array:
    """(count,) the largest of the values of each index."""
    found = np.zeros(count)
    np.maximum.at(found, index, values)
    return found


def _angles(a: Array, b: Array) -> Array:
    """(N,) radians between vectors."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))
