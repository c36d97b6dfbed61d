"""Trajectories: sequences of poses, in the TUM format that SLAM benchmarks use.

One line a pose: ``time tx ty tz qx qy qz qw``, separated by spaces; ``#`` starts a comment. The
position is the camera's in the world, metres; the quaternion turns camera to world, both frames as
in ``omniscv.geometry``, so that a trajectory estimated from the images compares directly.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses in order, and their times, s, if they have any."""

    poses: tuple[Pose, ...]
    times: tuple[float, ...] | None = None


def read_trajectory(path: Path) -> tuple[Pose, ...]:
    """The poses of a TUM file, in its order.

    Raises:
        ArgumentError: the file cannot be read, or a line is not eight finite numbers.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as cause:
        raise ArgumentError(f"{path}: expected a trajectory file in TUM format, got {cause}") from cause
    from scipy.spatial.transform import Rotation  # takes as long as the rest of a command's start

    poses = []
    for number, line in enumerate(lines, start=1):
        if text := line.partition("#")[0].strip():
            try:
                _, x, y, z, *quaternion = map(float, text.split())
                poses.append(Pose(np.array([x, y, z]), Rotation.from_quat(quaternion).as_matrix()))
            except ValueError as cause:
                wanted = "'time tx ty tz qx qy qz qw'"
                raise ArgumentError(f"{path}, line {number}: expected {wanted}, got {shown(text)}") from cause
    if not poses:
        raise ArgumentError(f"{path}: expected lines 'time tx ty tz qx qy qz qw', got none")
    return tuple(poses)
