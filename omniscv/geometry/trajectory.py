"""Trajectories: sequences of poses, with their times where they have some, as files of SLAM benchmarks.

Positions are the camera's in the world, metres; rotations turn camera to world, both frames as in
:mod:`omniscv.geometry`, so that a trajectory estimated from the images compares directly. ``#`` starts a
comment.

TUM
    ``time tx ty tz qx qy qz qw``, seconds, separated by single spaces.
KITTI odometry
    the 3x4 matrix of T_0_i row by row, from camera i to the first camera; no times, which are a file of
    one number a line.
EuRoC
    ``time,px,py,pz,qw,qx,qy,qz``, the time in whole nanoseconds; further columns are not read.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import overload

import numpy as np

from omniscv.arguments import number, shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, Array, Pose
from omniscv.geometry.motion import between
from omniscv.storage.bounded import read_bytes

_NS = 10**9
_MOST_BYTES = 1 << 28
_FIRST = Pose(np.zeros(3), R_LEVEL)
_KITTI_ROUNDING = 1e-4
"""Of R R^T: KITTI's own files have seven digits."""


@dataclass(frozen=True, eq=False)
class Trajectory(Sequence[Pose]):
    """Poses in their order, and the times they belong to.

    Args:
        poses: at least one.
        times: seconds, increasing, one a pose; None where they are not known.

    Raises:
        ArgumentError: no pose, another number of times, or times that do not increase.
    """

    poses: tuple[Pose, ...]
    times: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not self.poses:
            raise ArgumentError("trajectory: expected at least one pose, got none")
        if self.times is None:
            return
        if len(self.times) != len(self.poses):
            got = f"{len(self.times)} for {len(self.poses)} poses"
            raise ArgumentError(f"times: expected one a pose, got {got}")
        for before, after in zip(self.times, self.times[1:], strict=False):
            if not before < after:
                raise ArgumentError(f"times: expected increasing seconds, got {after!r} after {before!r}")

    def __len__(self) -> int:
        return len(self.poses)

    @overload
    def __getitem__(self, index: int) -> Pose: ...
    @overload
    def __getitem__(self, index: slice) -> Trajectory: ...
    def __getitem__(self, index: int | slice) -> Pose | Trajectory:
        if isinstance(index, slice):
            return Trajectory(self.poses[index], None if self.times is None else self.times[index])
        return self.poses[index]

    def __iter__(self) -> Iterator[Pose]:
        return iter(self.poses)

    def at(self, time: float, steps_beyond: float = 0.0) -> Pose:
        """Return the pose at a time: positions linear, rotations at constant speed (slerp) in between.

        Args:
            time: seconds.
            steps_beyond: how far before the first pose or after the last one the time may lie, as a part of
                the step between the two poses there, which goes on.

        Raises:
            ArgumentError: the trajectory has no times, or the time lies outside them.
        """
        if self.times is None:
            raise ArgumentError("trajectory: expected poses with times to interpolate, got none with times")
        first, last = self.times[0], self.times[-1]
        if first == last == time:
            return self.poses[0]
        i = min(max(bisect_right(self.times, time), 1), len(self.times) - 1)
        start, end = self.times[i - 1], self.times[i]
        part = (time - start) / (end - start) if end > start else math.nan
        if not -steps_beyond <= part <= 1 + steps_beyond:
            beyond = ", or a step beyond" if steps_beyond else ""
            raise ArgumentError(f"time: expected {first:.15g} to {last:.15g} s{beyond}, got {time:.15g}")
        return between(self.poses[i - 1], self.poses[i], part)


def read_trajectory(path: Path, first: Pose = _FIRST) -> Trajectory:
    """Return the poses of a TUM, KITTI or EuRoC file, recognised by what is on its lines, in its order.

    Args:
        path: the file. KITTI's times are in a file beside it: of the same name with the suffix ``.times``,
            or ``times.txt``.
        first: of KITTI's first camera, which its poses are relative to; level at the origin if not given.

    Raises:
        ArgumentError: the file cannot be read, a line is not the finite numbers of a pose, or times do not
            increase.
    """
    rows = list(_rows(path))
    if not rows:
        raise ArgumentError(f"{path}: expected lines 'time tx ty tz qx qy qz qw', got none")
    (_, words, commas), *_ = rows
    wanted, read = _EUROC if commas else _KITTI if len(words) == 12 else _TUM
    times, poses = [], []
    for line, words, _ in rows:
        try:
            time, pose = read(words)
        except (ValueError, OverflowError) as cause:
            got = shown(" ".join(words))
            raise ArgumentError(f"{path}, line {line}: expected {wanted}, got {got}") from cause
        times.append(time)
        poses.append(pose)
    with within(path):
        if read is not _kitti:
            return Trajectory(tuple(poses), tuple(times))
        return Trajectory(tuple(first @ pose for pose in poses), _kitti_times(path))


def write_tum(trajectory: Trajectory) -> str:
    """Return the text of a TUM file; poses without times are numbered from 0."""
    rows = zip(_times(trajectory), _positions(trajectory), _quaternions(trajectory), strict=True)
    return _lines("# time tx ty tz qx qy qz qw", ([time, *p, *q] for time, p, q in rows))


def write_euroc(trajectory: Trajectory) -> str:
    """Return the text of a EuRoC ``data.csv``; poses without times are numbered from 0, in seconds."""
    rows = zip(_times(trajectory), _positions(trajectory), _quaternions(trajectory), strict=True)
    names = "p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
    wanted = ([round(Fraction(time) * _NS), *p, w, x, y, z] for time, p, (x, y, z, w) in rows)
    return _lines(f"#timestamp [ns],{names}", wanted, ",")


def write_kitti(trajectory: Trajectory) -> str:
    """Return the text of a KITTI odometry file: poses relative to the first one, without times."""
    first = trajectory[0]
    relative = (
        np.column_stack([first.rotation.T @ pose.rotation, first.to_camera(pose.position)])
        for pose in trajectory
    )
    return _lines("", (matrix.ravel().tolist() for matrix in relative))


def write_kitti_times(trajectory: Trajectory) -> str:
    """Return the text of KITTI's ``times.txt``: seconds, one a pose; without times, numbers from 0."""
    return _lines("", ([time] for time in _times(trajectory)))


def quaternion(rotation: Array) -> list[float]:
    """Return x, y, z, w of a rotation (3, 3), w >= 0."""
    from scipy.spatial.transform import Rotation

    return list(Rotation.from_matrix(rotation).as_quat(canonical=True).tolist())


def plain(value: float) -> str:
    """Return the shortest text that reads back as the number; whole numbers without ``.0``."""
    return str(value + 0).removesuffix(".0")


def _rows(path: Path) -> Iterator[tuple[int, list[str], bool]]:
    """Line number, words and whether commas separate them, of lines that are not only comments."""
    try:
        content = read_bytes(path, _MOST_BYTES).decode("utf-8-sig")
    except ValueError as cause:
        raise ArgumentError(f"{path}: {cause}") from cause
    for line, text in enumerate(content.splitlines(), start=1):
        if numbers := text.partition("#")[0].strip():
            yield line, numbers.replace(",", " ").split(), "," in numbers


def _tum(words: list[str]) -> tuple[float, Pose]:
    time, x, y, z, *turn = map(float, words)
    return number("time", time), _pose((x, y, z), turn)


def _euroc(words: list[str]) -> tuple[float, Pose]:
    x, y, z, qw, qx, qy, qz = map(float, words[1:8])
    return int(words[0]) / _NS, _pose((x, y, z), (qx, qy, qz, qw))


def _kitti(words: list[str]) -> tuple[float, Pose]:
    from scipy.spatial.transform import Rotation

    matrix = np.array([float(word) for word in words]).reshape(3, 4)
    turned = matrix[:, :3]
    if not np.abs(turned @ turned.T - np.eye(3)).max() < _KITTI_ROUNDING:
        raise ValueError("expected a rotation")
    return math.nan, Pose(matrix[:, 3], Rotation.from_matrix(turned).as_matrix())


_TUM = ("'time tx ty tz qx qy qz qw'", _tum)
_EUROC = ("'nanoseconds,px,py,pz,qw,qx,qy,qz'", _euroc)
_KITTI = ("the 12 numbers of a rigid 3x4 matrix", _kitti)


def _kitti_times(path: Path) -> tuple[float, ...] | None:
    for beside in (path.with_suffix(".times"), path.with_name("times.txt")):
        if beside.is_file():
            return tuple(number(f"line {line}", words[0]) for line, words, _ in _rows(beside))
    return None


def _pose(position: Sequence[float], turn: Sequence[float]) -> Pose:
    from scipy.spatial.transform import Rotation

    if len(turn) != 4:
        raise ValueError("expected four numbers of a quaternion")
    return Pose(np.array(position), Rotation.from_quat(turn).as_matrix())


def _times(trajectory: Trajectory) -> Sequence[float]:
    return range(len(trajectory)) if trajectory.times is None else trajectory.times


def _positions(trajectory: Trajectory) -> list[list[float]]:
    return [pose.position.tolist() for pose in trajectory]


def _quaternions(trajectory: Trajectory) -> list[list[float]]:
    return [quaternion(pose.rotation) for pose in trajectory]


def _lines(header: str, rows: Iterable[Iterable[float]], separator: str = " ") -> str:
    found = [header] if header else []
    return "\n".join([*found, *(separator.join(map(plain, row)) for row in rows)]) + "\n"
