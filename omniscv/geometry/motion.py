"""Poses between timed poses: positions linearly, rotations along the shortest turn (slerp)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from omniscv.arguments import number, numbers
from omniscv.errors import ArgumentError
from omniscv.geometry.pose import Array, Pose


def rotation_vector(start: Pose, end: Pose) -> Array:
    """(3,) the turn from one pose to another in the first one's camera frame: axis times angle, radians."""
    return np.asarray(Rotation.from_matrix(start.R_w_c.T @ end.R_w_c).as_rotvec())


def between(start: Pose, end: Pose, part: float) -> Pose:
    """Return the pose at a part of the way from one to another, 0 to 1."""
    turn = Rotation.from_rotvec(part * rotation_vector(start, end)).as_matrix()
    return Pose(start.t_w_c + part * (end.t_w_c - start.t_w_c), start.R_w_c @ turn)


def pose_at(times: ArrayLike, poses: Sequence[Pose], time: float) -> Pose:
    """Return the pose at a time.

    Args:
        times: (N,) seconds, increasing.
        poses: N of them.
        time: seconds.

    Raises:
        ArgumentError: times that do not increase, are no times of the poses, or do not include ``time``.
    """
    known = numbers("times", times, (len(poses),))
    if len(known) < 2 or not (np.diff(known) > 0).all():
        raise ArgumentError(f"times: expected at least two, increasing, got {known.tolist()}")
    time = number("time", time, least=known[0], most=known[-1])
    i = min(int(np.searchsorted(known, time, "right")), len(known) - 1)
    return between(poses[i - 1], poses[i], (time - known[i - 1]) / (known[i] - known[i - 1]))
