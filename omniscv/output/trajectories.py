"""Trajectories: sequences of poses, in the TUM format that SLAM benchmarks use.

One line a pose: ``time tx ty tz qx qy qz qw``, separated by spaces; ``#`` starts a comment. The
position is the camera's in the world, metres; the quaternion turns camera to world, both frames as
in ``omniscv.geometry``, so that a trajectory estimated from the images compares directly.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from omniscv.errors import ArgumentError
from omniscv.geometry import Pose


def read_trajectory(path: Path) -> tuple[Pose, ...]:
    """The poses of a TUM file, in its order.

    Raises:
        ArgumentError: the file cannot be read, or a line is not eight finite numbers.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as cause:
        raise ArgumentError(f"{path}: expected a trajectory file in TUM format, got {cause}") from cause
    poses = [
        _pose(path, number, text)
        for number, line in enumerate(lines, start=1)
        if (text := line.partition("#")[0].strip())
    ]
    if not poses:
        raise ArgumentError(f"{path}: expected lines 'time tx ty tz qx qy qz qw', got none")
    return tuple(poses)


def _pose(path: Path, number: int, text: str) -> Pose:
    try:
        values = np.array([float(word) for word in text.split()])
        if values.shape != (8,):
            raise ValueError(f"{values.size} numbers")
        return Pose(values[1:4], Rotation.from_quat(values[4:]).as_matrix())
    except ValueError as cause:
        raise ArgumentError(
            f"{path}, line {number}: expected 'time tx ty tz qx qy qz qw', got {text!r}"
        ) from cause
