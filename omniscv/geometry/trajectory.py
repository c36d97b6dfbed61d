"""Trajectories: sequences of poses, timed or not, and the files of SLAM benchmarks that hold them.

Files hold the camera's positions in the world, metres, and rotations from camera to world, in the frames of
:mod:`omniscv.geometry`: a trajectory estimated from the images compares directly. ``#`` starts a comment.

TUM
    ``time tx ty tz qx qy qz qw``, seconds, separated by blanks; a comment may name ``qw`` before ``qx``.
KITTI odometry
    the 3x4 matrix of T_0_i row by row, from camera i to the first camera. Times are in another file, one
    number per line.
EuRoC
    ``time,px,py,pz,qw,qx,qy,qz``, the time in whole nanoseconds; 8 or 17 columns, a quaternion of length 1.
CSV
    a line of names, then numbers, separated by commas, semicolons or tabs: ``x,y,z``, and ``yaw,pitch,roll``
    in degrees (``yaw_rad``: radians) as of :meth:`Pose.from_angles`, or ``qx,qy,qz,qw``; ``time`` in seconds
    may be among them.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple, overload

import numpy as np

from omniscv.arguments import number, shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, Array, Pose

Curve = Literal["linear", "spline"]
Frame = Literal["camera", "body", "object"]

_NS = 10**9
_ANGLES, _QUATERNION = ("yaw", "pitch", "roll"), ("qx", "qy", "qz", "qw")
_MOST_BYTES = 1 << 28
_MOST_SECONDS = 1e11  # the year 5138; since 1970, milliseconds are more
_FIRST = Pose(np.zeros(3), R_LEVEL)
_KITTI_ROUNDING = 1e-4
"""Largest entry of |R R^T - I| in a file: those of KITTI have seven digits."""


class Motions(NamedTuple):
    """A body's motion at N times, by the derivatives of splines.

    Attributes:
        positions_w, velocities_w, accelerations_w: (N, 3) metres and seconds, world frame.
        rotations: (N, 3, 3) from the body to the world.
        rates, rate_changes: (N, 3) angular velocity, rad/s, and acceleration, in the body's frame.
    """

    positions_w: Array
    velocities_w: Array
    accelerations_w: Array
    rotations: Array
    rates: Array
    rate_changes: Array


@dataclass(frozen=True, eq=False)
class Trajectory(Sequence[Pose]):
    """Poses in order, and their times.

    Args:
        poses: at least one.
        times: seconds, increasing, one per pose; None if they are unknown.
        curve: between poses: ``linear`` interpolates as :meth:`Pose.interpolate`; ``spline`` uses cubic
            splines of positions and rotations, whose velocities and accelerations are continuous.

    Raises:
        ArgumentError: no pose, not one time per pose, or times that do not increase.
    """

    poses: tuple[Pose, ...]
    times: tuple[float, ...] | None = None
    curve: Curve = "linear"

    def __post_init__(self) -> None:
        if not self.poses:
            raise ArgumentError("trajectory: expected at least one pose, got none")
        if self.times is None:
            return
        if len(self.times) != len(self.poses):
            got = f"{len(self.times)} for {len(self.poses)} poses"
            raise ArgumentError(f"times: expected one per pose, got {got}")
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
            return Trajectory(self.poses[index], self.times and self.times[index], self.curve)
        return self.poses[index]

    def __iter__(self) -> Iterator[Pose]:
        return iter(self.poses)

    def at(self, time: float, steps_beyond: float = 0.0) -> Pose:
        """Return the pose at a time, as ``curve`` says.

        Args:
            time: seconds.
            steps_beyond: how far outside the trajectory the time may lie, as a multiple of the first or the
                last step, whose motion is then continued.

        Raises:
            ArgumentError: the trajectory has no times, or the time lies outside them.
        """
        if self.times is None:
            raise ArgumentError("trajectory: expected poses with times, got poses without times")
        first, last = self.times[0], self.times[-1]
        if first == last == time:
            return self.poses[0]
        i = min(max(bisect_right(self.times, time), 1), len(self.times) - 1)
        start, end = self.times[i - 1], self.times[i]
        fraction = (time - start) / (end - start) if end > start else math.nan
        if not -steps_beyond <= fraction <= 1 + steps_beyond:
            beyond = ", or a step beyond" if steps_beyond else ""
            raise ArgumentError(f"time: expected {first:.15g} to {last:.15g} s{beyond}, got {time:.15g}")
        if self.curve == "spline":
            positions, rotations = self._splines
            return Pose(positions(time), rotations(time).as_matrix())
        return self.poses[i - 1].interpolate(self.poses[i], fraction)

    def motions(self, times: Array) -> Motions:
        """Return what the splines and their derivatives are at times (N,), seconds."""
        positions, rotations = self._splines
        at, velocities, accelerations = (positions(times, order) for order in range(3))
        rates, changes = (rotations(times, order) for order in (1, 2))
        return Motions(at, velocities, accelerations, rotations(times).as_matrix(), rates, changes)

    def misses(self) -> tuple[float, float]:
        """Return how far the splines pass from the poses at most: metres, and radians."""
        at = self.motions(np.array(self.times))
        away = np.linalg.norm(at.positions_w - [pose.position for pose in self.poses], axis=1)
        turned = np.abs(at.rotations - [pose.rotation for pose in self.poses])
        return float(away.max()), float(turned.max())

    @cached_property
    def _splines(self) -> tuple[Any, Any]:
        """Splines of positions, and of rotations with rates in the body's frame: slow to load."""
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        if self.times is None or len(self.times) < 2:
            raise ArgumentError("trajectory: expected two or more poses with times, for splines")
        rotations = Rotation.from_matrix(np.stack([pose.rotation for pose in self.poses]))
        positions = CubicSpline(self.times, np.stack([pose.position for pose in self.poses]))
        return positions, RotationSpline(self.times, rotations)


def read_trajectory(path: Path, first: Pose = _FIRST, frame: Frame = "camera") -> Trajectory:
    """Return the poses of a TUM, KITTI, EuRoC or CSV file in its order; its lines show which it is.

    Args:
        path: the file. KITTI's times are read from a file beside it: the same name with the suffix
            ``.times``, or ``times.txt``.
        first: the pose of KITTI's first camera, to which its poses are relative; level at the origin if not
            given.
        frame: what the file's quaternions and matrices turn. ``camera``: x right, y down, z forward.
            ``body``: x forward, y left, z up, angles as ROS has them (pitch down +); poses are then those of
            a camera that looks along its x, and KITTI's world is the first body.
            ``object``: the same, and the poses are the object's own.

    Raises:
        ArgumentError: the file cannot be read, a line does not hold the finite numbers of a pose, or times
            do not increase.
    """
    content = _content(path)
    rows = list(_rows(path, content))
    if not rows:
        raise ArgumentError(f"{path}: expected lines 'time tx ty tz qx qy qz qw', got none")
    (_, words, commas), *_ = rows
    if {"x", "y", "z"} & {word.lower() for word in words}:
        with within(path):
            columns, read = _csv([word.lower() for word in words], frame)
            if len(rows) == 1:
                raise ArgumentError("expected rows of numbers below the names, got none")
        del rows[0]
    else:
        columns, read = _EUROC if commas else _KITTI if len(words) == 12 else _TUM
        if read is _tum and re.search(r"^#.*\bqw\b.*\bqx\b", content, re.MULTILINE):
            columns, read = "'time tx ty tz qw qx qy qz'", _tum_w_first
    times, poses = [], []
    for line, words, _ in rows:
        try:
            time, pose = read(words)
        except (ValueError, OverflowError) as cause:
            got, why = shown(" ".join(words)), f": {cause}" if isinstance(cause, ArgumentError) else ""
            raise ArgumentError(f"{path}, line {line}: expected {columns}, got {got}{why}") from cause
        times.append(time)
        poses.append(Pose(pose.position, pose.rotation @ R_LEVEL) if frame == "body" else pose)
    with within(path):
        if read is not _kitti:
            return Trajectory(tuple(poses), None if math.isnan(times[0]) else tuple(times))
        if frame == "body":  # the file's world is the first body, not the first camera
            first = Pose(first.position, first.rotation @ R_LEVEL.T)
        return Trajectory(tuple(first @ pose for pose in poses), _kitti_times(path))


def write_tum(trajectory: Trajectory) -> str:
    """Return the text of a TUM file; poses without times are numbered from 0."""
    return _lines("# time tx ty tz qx qy qz qw", _timed_rows(trajectory))


def write_euroc(trajectory: Trajectory) -> str:
    """Return the text of a EuRoC ``data.csv``; poses without times are numbered from 0, in seconds."""
    names = "p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
    rows = (
        [round(Fraction(time) * _NS), *position, w, x, y, z]
        for time, *position, x, y, z, w in _timed_rows(trajectory)
    )
    return _lines(f"#timestamp [ns],{names}", rows, ",")


def write_kitti(trajectory: Trajectory) -> str:
    """Return the text of a KITTI odometry file: poses relative to the first one, without times."""
    first = trajectory[0]
    relative = (
        np.column_stack([first.rotation.T @ pose.rotation, first.to_camera(pose.position)])
        for pose in trajectory
    )
    return _lines("", (matrix.ravel().tolist() for matrix in relative))


def write_kitti_times(trajectory: Trajectory) -> str:
    """Return the text of KITTI's ``times.txt``: seconds, one per pose; without times, numbers from 0."""
    return _lines("", ([time] for time in _times(trajectory)))


def plain(value: float) -> str:
    """Return the shortest text that is read back as the same number; whole numbers without ``.0``."""
    return str(value + 0).removesuffix(".0")


def _content(path: Path) -> str:
    from omniscv.storage.bounded import read_bytes  # loads YAML

    try:
        return read_bytes(path, _MOST_BYTES).decode("utf-8-sig")
    except ValueError as cause:
        raise ArgumentError(f"{path}: {cause}") from cause


def _rows(path: Path, content: str) -> Iterator[tuple[int, list[str], bool]]:
    """Yield line number, words, and whether commas separate them, of lines that are more than a comment."""
    for line, text in enumerate(content.splitlines(), start=1):
        if numbers := text.partition("#")[0].strip():
            separator = next((mark for mark in ";," if mark in numbers), None)
            words = [word.strip() for word in numbers.split(separator)]
            cells = words if separator == ";" else numbers.split()
            alone = len(cells) > 1 and not any(cell.strip(",") != cell for cell in cells)
            if alone and any(map(_DECIMAL_COMMA.fullmatch, cells)):
                got = shown(numbers[:60])
                raise ArgumentError(f"{path}, line {line}: expected decimal points, got a comma in {got}")
            yield line, words, separator is not None


_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+(e[-+]?\d+)?", re.IGNORECASE)


def _seconds(word: float) -> float:
    if abs(time := number("time", word)) > _MOST_SECONDS:
        raise ArgumentError(f"time: expected seconds, got {time:.15g}: milli-, micro- or nanoseconds?")
    return time


def _tum(words: list[str]) -> tuple[float, Pose]:
    time, x, y, z, *quaternion = map(float, words)
    return _seconds(time), Pose.from_quaternion((x, y, z), quaternion)


def _tum_w_first(words: list[str]) -> tuple[float, Pose]:
    return _tum([*words[:4], *words[5:], *words[4:5]])


def _euroc(words: list[str]) -> tuple[float, Pose]:
    if len(words) not in (8, 17):
        raise ArgumentError(f"expected 8 or 17 columns, got {len(words)}")
    x, y, z, qw, qx, qy, qz = map(float, words[1:8])
    if not abs((length := math.hypot(qw, qx, qy, qz)) - 1) < 1e-3:
        raise ArgumentError(f"expected a quaternion of length 1, got {length:.6g}")
    return int(words[0]) / _NS, Pose.from_quaternion((x, y, z), (qx, qy, qz, qw))


def _kitti(words: list[str]) -> tuple[float, Pose]:
    from scipy.spatial.transform import Rotation

    matrix = np.array([float(word) for word in words]).reshape(3, 4)
    rotation = matrix[:, :3]
    if not np.abs(rotation @ rotation.T - np.eye(3)).max() < _KITTI_ROUNDING:
        raise ValueError("expected a rotation")
    return math.nan, Pose(matrix[:, 3], Rotation.from_matrix(rotation).as_matrix())  # the nearest rotation


def _csv(names: Sequence[str], frame: Frame) -> tuple[str, Callable[[list[str]], tuple[float, Pose]]]:
    """Return what the lines below a header hold, and a function that reads one."""
    known = ("time", "x", "y", "z", *_ANGLES, *_QUATERNION)
    plain_names = [name.removesuffix("_rad").removesuffix("_deg") for name in names]
    if wrong := [name for name, plain in zip(names, plain_names, strict=True) if plain not in known]:
        raise ArgumentError(f"line 1: expected names among {', '.join(known)}; got {shown(wrong[0])}")
    if missing := [name for name in "xyz" if name not in names]:
        raise ArgumentError(f"line 1: expected columns x, y and z, got no {missing[0]}")
    if twice := [name for name in plain_names if plain_names.count(name) > 1]:
        raise ArgumentError(f"line 1: expected each column once, got {twice[0]} twice")
    turned = [name for name in _QUATERNION if name in names]
    if turned and (len(turned) < 4 or set(_ANGLES) & set(plain_names)):
        raise ArgumentError("line 1: expected qx, qy, qz and qw, or yaw, pitch and roll; got some of them")

    def read(words: list[str]) -> tuple[float, Pose]:
        values = dict(zip(plain_names, map(float, words), strict=True))
        position = values["x"], values["y"], values["z"]
        time = _seconds(values["time"]) if "time" in values else math.nan
        if turned:
            return time, Pose.from_quaternion(position, [values[name] for name in _QUATERNION])
        for name, plain in zip(names, plain_names, strict=True):
            if name.endswith("_rad"):
                values[plain] = math.degrees(values[plain])
        angles = [values.get(name, 0.0) for name in _ANGLES]
        if frame == "body":
            from scipy.spatial.transform import Rotation

            return time, Pose(
                np.array(position), Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
            )
        level = Pose.from_angles(position, *angles)
        return time, level if frame == "camera" else Pose(level.position, level.rotation @ R_LEVEL.T)

    return f"'{','.join(names)}'", read


_TUM = ("'time tx ty tz qx qy qz qw'", _tum)
_EUROC = ("'nanoseconds,px,py,pz,qw,qx,qy,qz'", _euroc)
_KITTI = ("the 12 numbers of a rigid 3x4 matrix", _kitti)


def _kitti_times(path: Path) -> tuple[float, ...] | None:
    for beside in (path.with_suffix(".times"), path.with_name("times.txt")):
        if beside.is_file():
            return tuple(
                number(f"line {line}", words[0]) for line, words, _ in _rows(beside, _content(beside))
            )
    return None


def _times(trajectory: Trajectory) -> Sequence[float]:
    return range(len(trajectory)) if trajectory.times is None else trajectory.times


def _timed_rows(trajectory: Trajectory) -> Iterator[list[float]]:
    """Yield time, position and quaternion (x, y, z, w) of each pose."""
    for time, pose in zip(_times(trajectory), trajectory, strict=True):
        yield [time, *pose.position.tolist(), *pose.quaternion()]


def _lines(header: str, rows: Iterable[Iterable[float]], separator: str = " ") -> str:
    lines = [separator.join(map(plain, row)) for row in rows]
    return "\n".join([header, *lines] if header else lines) + "\n"
