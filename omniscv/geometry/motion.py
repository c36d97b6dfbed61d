"""Poses between two poses: positions linearly, rotations along the shortest turn (slerp)."""

import numpy as np

from omniscv.geometry.pose import Array, Pose


def rotation_vector(start: Pose, end: Pose) -> Array:
    """(3,) the turn from one pose to another in the first one's camera frame: axis times angle, radians."""
    from scipy.spatial.transform import Rotation  # loaded when something moves

    return np.asarray(Rotation.from_matrix(start.R_w_c.T @ end.R_w_c).as_rotvec())


def between(start: Pose, end: Pose, part: float) -> Pose:
    """Return the pose at a part of the way from one to another: 0 to 1, or beyond them."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(part * rotation_vector(start, end)).as_matrix()
    return Pose(start.t_w_c + part * (end.t_w_c - start.t_w_c), start.R_w_c @ turn)
