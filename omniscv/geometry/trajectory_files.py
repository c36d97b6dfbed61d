"""Files of trajectories: TUM, KITTI, EuRoC and CSV, read by columns.

Files hold the camera's positions in the world, metres, and rotations from camera to world, in the frames of
:mod:`omniscv.geometry`: a trajectory estimated from the images compares directly. ``#`` or ``%`` starts a
comment. Columns are separated by commas, semicolons, tabs or blanks. Names of the columns, in a first line or
a comment, say what each is, and its unit: ``time_ms``, ``timestamp [ns]``, ``yaw_rad``. Without names:

TUM
    ``time tx ty tz qx qy qz qw``, seconds, separated by blanks.
KITTI odometry
    the 3x4 matrix of T_0_i row by row, from camera i to the first camera. Times are in another file, one
    number per line.
EuRoC
    ``time,px,py,pz,qw,qx,qy,qz``, the time in whole nanoseconds; 8 columns, or 17 with velocities and biases.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, Literal
from warnings import catch_warnings

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry.pose import FARTHEST, R_LEVEL, Array, Pose
from omniscv.geometry.trajectory import Poses, Trajectory
from omniscv.geometry.trajectory_columns import (
    ANGLES,
    MATRIX,
    QUATERNION,
    UNITS,
    Dialect,
    check_decimals,
    dialect_of,
    is_names,
    split,
)
from omniscv.storage.bounded import open_regular

Frame = Literal["camera", "body", "object"] | Pose

_NS = 10**9
_SECONDS, _MOST_TIME = 1e11, 1e19  # the year 5138; since 1970, milliseconds are more, and all are less
_SLOW, _TOO_SLOW = 10.0, 1e4  # seconds from row to row: no camera is so slow
_MOST_BYTES, _BLOCK = 1 << 28, 1 << 16
_MOST_ANGLE = 1e5  # degrees or radians; more digits than a turn has are lost
_FIRST = Pose(np.zeros(3), R_LEVEL)
_KITTI_ROUNDING = 1e-4
"""Largest entry of |R R^T - I| in a file: those of KITTI have seven digits."""
_UNIT = {"TUM": 1e-2, "EuRoC": 1e-3}
"""How far the length of a quaternion may be off 1 where no names say that it is one."""
_SAME_M, _SAME_ENTRY = 1e-3, 2e-3  # two rows of one time, rounded, are one pose


def read_trajectory(path: Path, first: Pose = _FIRST, frame: Frame | None = None) -> Trajectory:
    """Return the poses of a TUM, KITTI, EuRoC or CSV file in its order; its lines show which it is.

    Args:
        path: the file. KITTI's times are read from a file beside it: the same name with the suffix
            ``.times``, or ``times.txt``.
        first: the pose of KITTI's first camera, to which its poses are relative; level at the origin if not
            given.
        frame: what the file's rotations turn. ``camera``, also if not given: x right, y down, z forward.
            ``body``: x forward, y left, z up, angles as ROS has them (pitch down +); poses are then those of
            a camera that looks along its x, and KITTI's world is the first body. A pose: the same of a camera
            that has this pose on the body. ``object``: as ``body``, and the poses are the object's own.

    Returns:
        The trajectory; ``says`` has what was assumed.

    Raises:
        ArgumentError: the file cannot be read, a line does not hold the finite numbers of a pose, times
            do not increase, or two rows of one time have different poses.
    """
    with within(path):
        dialect, rows = _rows(path)
        columns = {name: rows[f"c{i}"] for i, name in enumerate(dialect.columns) if name}
        _check(path, dialect, columns)
        times, says = _times_of(dialect, columns)
        if times is None and dialect.name == "KITTI":
            times = _kitti_times(path)
        positions, rotations = _poses_of(dialect, columns, frame or "camera", first)
        del rows, columns
        if times is not None:
            kept, again = _without_repeats(path, dialect, times, positions, rotations)
            if again:
                times, positions, rotations = times[kept], positions[kept], rotations[kept]
                says.append(f"{again} rows that repeat the row before are left out")
    if dialect.name == "EuRoC" and frame is None:
        says.append(
            f"the rotation is that of EuRoC's body, an IMU, taken as the camera's; for the camera write "
            f"{{file: {path.name}, frame: cam0/sensor.yaml}}, the file that has its T_BS"
        )
    seconds = None
    if times is not None:
        per_s = _NS if dialect.units.get("time") == "ns" else 1
        seconds = tuple(time / per_s for time in times.tolist())
    with within(path):
        return Trajectory(Poses(positions, rotations), seconds, says=tuple(says))


# -- rows --------------------------------------------------------------------------------


def _lines(path: Path) -> Iterator[str]:
    try:
        with io.TextIOWrapper(open_regular(path, most=_MOST_BYTES), encoding="utf-8-sig") as lines:
            yield from lines
    except OSError as cause:
        raise ArgumentError(f"expected a readable file, got {cause.strerror}") from cause
    except UnicodeDecodeError as cause:
        raise ArgumentError(str(cause)) from cause


def _rows(path: Path) -> tuple[Dialect, NDArray[Any]]:
    """Return how a file is written, and its rows, a structured array with a field for each column."""
    comments, names, where, lines = list[str](), "", 0, _lines(path)
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if text.startswith(("#", "%")):
            comments.append(text)
        elif text and not names and is_names(text):
            names, where = text, number
        elif text:
            break
    else:
        wanted = "expected rows of numbers below the names" if names else "expected rows of a trajectory"
        raise ArgumentError(f"{wanted}, such as 'time tx ty tz qx qy qz qw', got none")
    with within(f"line {where or number}"):
        dialect, types = dialect_of(names, comments, text)
    try:
        with catch_warnings(action="error"):  # a fraction of a nanosecond
            rows = np.loadtxt(
                (line for line in chain([text], lines) if not line.isspace()),
                np.dtype([(f"c{i}", kind) for i, kind in enumerate(types)]),
                comments=dialect.comment,
                delimiter=dialect.separator,
                ndmin=1,
            )
    except (ValueError, OverflowError, DeprecationWarning) as cause:
        raise _wrong_line(path, dialect, types) from cause
    return dialect, rows


def _data_lines(path: Path, dialect: Dialect) -> Iterator[tuple[int, str]]:
    """Yield the numbers and texts of the lines with rows."""
    names = True
    for number, line in enumerate(_lines(path), start=1):
        text = line.partition(dialect.comment)[0].strip()
        if text and line.strip()[0] not in "#%":
            if names and is_names(text):
                names = False
                continue
            names = False
            yield number, text


def _wrong_line(path: Path, dialect: Dialect, types: Sequence[str]) -> ArgumentError:
    """Return the error of the first line that is no row."""
    readers = {"f8": float, "i8": int, "S1": str}
    for number, text in _data_lines(path, dialect):
        words = split(text, dialect.separator)
        try:
            with within(f"line {number}"):
                check_decimals(text, dialect.separator)
            for kind, word in zip(types, words, strict=True):
                np.array([readers[kind](word)], kind)
        except ArgumentError as cause:
            return cause
        except (ValueError, OverflowError):
            return ArgumentError(f"line {number}: expected {shown(dialect.named)}, got {shown(text)}")
    return ArgumentError(f"expected rows {shown(dialect.named)}, got others")


def _refuse(path: Path, dialect: Dialect, wrong: NDArray[np.bool_], expected: str) -> None:
    """Raise ArgumentError that names the line of the first row that is wrong, if any is."""
    if wrong.any():
        row = int(wrong.argmax())
        number, text = next(line for i, line in enumerate(_data_lines(path, dialect)) if i == row)
        raise ArgumentError(f"line {number}: expected {expected}, got {shown(text)}")


# -- from columns to poses ---------------------------------------------------------------------------------


@np.errstate(over="ignore", invalid="ignore")  # what overflows is refused
def _check(path: Path, dialect: Dialect, columns: dict[str, NDArray[Any]]) -> None:
    """Refuse rows with numbers that no pose has."""
    wrong = np.zeros(len(next(iter(columns.values()))), np.bool_)
    for values in columns.values():
        wrong |= ~np.isfinite(values)
    _refuse(path, dialect, wrong, f"finite numbers {shown(dialect.named)}")
    limits = dict.fromkeys((*"xyz", *MATRIX[3::4]), (FARTHEST, "coordinates"))
    limits |= dict.fromkeys(ANGLES, (_MOST_ANGLE, "angles"))
    for name in limits.keys() & columns.keys():
        most, what = limits[name]
        _refuse(path, dialect, np.abs(columns[name]) > most, f"{what} of at most {most:g}")
    if "m0" in columns:
        rotations = _matrices(columns)
        off = np.abs(rotations @ rotations.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
        wrong = ~(off < _KITTI_ROUNDING) | (np.linalg.det(rotations) < 0)
        _refuse(path, dialect, wrong, dialect.named)
    if "qw" in columns:
        length = np.sqrt(sum(columns[name] ** 2 for name in QUATERNION))
        _refuse(
            path,
            dialect,
            ~((length > 1e-12) & (length < 1e12)),
            "a quaternion of length 1, as the rotation is zero",
        )
        if (not dialect.units and dialect.name in _UNIT) or dialect.name == "EuRoC":
            off = np.abs(length - 1) > _UNIT[dialect.name]
            _refuse(path, dialect, off, "a quaternion of length 1, or names of the columns")


def _times_of(dialect: Dialect, columns: dict[str, NDArray[Any]]) -> tuple[NDArray[Any] | None, list[str]]:
    """Return times in seconds, or in whole nanoseconds if ``dialect.units`` says so; and what was assumed."""
    if "time" not in columns:
        return None, []
    times = columns["time"].copy()  # the rows can go
    unit, says = dialect.units.get("time", "").removesuffix("ec"), list[str]()
    if "nsec" in columns:
        dialect.units["time"] = "ns"
        whole, parts = (columns[name].astype(np.int64) for name in ("time", "nsec"))
        return whole * _NS + parts, says
    smallest, largest = float(np.abs(times).min()), float(np.abs(times).max())
    if not unit and largest > _SECONDS:
        unit = "ms" if largest < _SECONDS * 1e3 else "us" if largest < _SECONDS * 1e6 else "ns"
        if largest > _MOST_TIME or smallest < _SECONDS * UNITS[unit] / 1e3:
            raise ArgumentError(f"time: expected seconds, got {smallest:.15g} to {largest:.15g}")
        says.append(f"times up to {largest:.6g} are taken as {unit} since 1970")
    elif not unit and len(times) > 2 and (step := float(np.median(np.diff(times)))) >= _SLOW:
        advice = "name the column time_s, time_ms, time_us or time_ns"
        if step >= _TOO_SLOW:
            raise ArgumentError(f"time: expected seconds, got steps of {step:.9g}; {advice}")
        says.append(f"times in steps of {step:.9g} are taken as seconds; if they are others, {advice}")
    per_s = UNITS[unit or "s"]
    if unit == "ns" and times.dtype.kind == "i":
        dialect.units["time"] = "ns"
        return times, says
    dialect.units["time"] = "s"
    seconds = times if per_s == 1 else times / per_s
    if np.abs(seconds).max() > _SECONDS:
        raise ArgumentError(f"time: expected seconds, got {np.abs(seconds).max():.15g}")
    return seconds, says


def _poses_of(
    dialect: Dialect, columns: dict[str, NDArray[Any]], frame: Frame, first: Pose
) -> tuple[Array, Array]:
    """Return positions (N, 3) and rotations (N, 3, 3) of cameras, or of objects."""
    is_level = frame == "body" or (frame == "camera" and not {"m0", "qw"} & {*columns})
    turn = R_LEVEL if is_level else np.eye(3)
    mounted = frame if isinstance(frame, Pose) else Pose(np.zeros(3), turn)
    if dialect.name != "KITTI":
        first = Pose(np.zeros(3), np.eye(3))
    elif frame not in ("camera", "object"):  # the file's world is the first body, not the first camera
        first = Pose(first.position, first.rotation @ R_LEVEL.T)
    count = len(next(iter(columns.values())))
    positions, rotations = np.empty((count, 3)), np.empty((count, 3, 3))
    for start in range(0, count, _BLOCK):
        rows = slice(start, start + _BLOCK)
        block = {name: values[rows] for name, values in columns.items()}
        axes = MATRIX[3::4] if "m0" in block else "xyz"
        turns, at = _turns(dialect, block, frame), np.stack([block[axis] for axis in axes], axis=1)
        positions[rows] = (at + turns @ mounted.position) @ first.rotation.T + first.position
        rotations[rows] = first.rotation @ turns @ mounted.rotation
    return positions, rotations


def _turns(dialect: Dialect, columns: dict[str, NDArray[Any]], frame: Frame) -> Array:
    """Return the rotations (N, 3, 3) that columns hold; without any, those of angles that are 0."""
    from scipy.spatial.transform import Rotation  # slow to load

    if "m0" in columns:  # the nearest rotation
        return np.asarray(Rotation.from_matrix(_matrices(columns)).as_matrix())
    if "qw" in columns:
        return np.asarray(Rotation.from_quat(np.stack([columns[q] for q in QUATERNION], axis=1)).as_matrix())
    angles = np.zeros((len(columns["x"]), 3))
    for i, name in enumerate(ANGLES):
        if name in columns:
            is_rad = dialect.units.get(name) == "rad"
            angles[:, i] = np.degrees(columns[name]) if is_rad else columns[name]
    if frame in ("camera", "object"):
        angles[:, 1] *= -1  # ours: nose up +; ROS: down +
    return np.asarray(Rotation.from_euler("ZYX", angles, degrees=True).as_matrix())


def _matrices(columns: dict[str, NDArray[Any]]) -> Array:
    return np.stack([columns[name] for name in MATRIX if name not in MATRIX[3::4]], axis=1).reshape(-1, 3, 3)


def _without_repeats(
    path: Path, dialect: Dialect, times: NDArray[Any], positions: Array, rotations: Array
) -> tuple[NDArray[np.bool_], int]:
    """Return which rows stay, without those that repeat the time and the pose of the row before, and how many
    go."""
    again = np.diff(times, prepend=times[0] - 1) == 0
    rows = np.flatnonzero(again)
    if rows.size and len(times) == len(positions):
        moved = np.abs(positions[rows] - positions[rows - 1]).max(axis=1) > _SAME_M
        moved |= np.abs(rotations[rows] - rotations[rows - 1]).max(axis=(1, 2)) > _SAME_ENTRY
        different = np.zeros(len(again), np.bool_)
        different[rows] = moved
        _refuse(path, dialect, different, "one pose at a time, or two equal ones")
    return ~again, rows.size


def _kitti_times(path: Path) -> Array | None:
    for beside in (path.with_suffix(".times"), path.with_name("times.txt")):
        if beside.is_file():
            with within(beside.name):
                times = np.loadtxt(_lines(beside), ndmin=1)
                if times.ndim != 1 or not np.isfinite(times).all():
                    raise ArgumentError("expected a finite number in each line, got others")
                return np.asarray(times)
    return None


# -- writing -----------------------------------------------------------------------------------------------


def write_tum(trajectory: Trajectory) -> str:
    """Return the text of a TUM file; poses without times are numbered from 0."""
    return _text("# time tx ty tz qx qy qz qw", _timed_rows(trajectory))


def write_euroc(trajectory: Trajectory) -> str:
    """Return the text of a EuRoC ``data.csv``; poses without times are numbered from 0, in seconds."""
    names = "p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
    rows = (
        [round(Fraction(time) * _NS), *position, w, x, y, z]
        for time, *position, x, y, z, w in _timed_rows(trajectory)
    )
    return _text(f"#timestamp [ns],{names}", rows, ",")


def write_kitti(trajectory: Trajectory) -> str:
    """Return the text of a KITTI odometry file: poses relative to the first one, without times."""
    first = trajectory[0]
    relative = (
        np.column_stack([first.rotation.T @ pose.rotation, first.to_camera(pose.position)])
        for pose in trajectory
    )
    return _text("", (matrix.ravel().tolist() for matrix in relative))


def write_kitti_times(trajectory: Trajectory) -> str:
    """Return the text of KITTI's ``times.txt``: seconds, one per pose; without times, numbers from 0."""
    return _text("", ([time] for time in _times(trajectory)))


def plain(value: float) -> str:
    """Return the shortest text that is read back as the same number; whole numbers without ``.0``."""
    return str(value + 0).removesuffix(".0")


def _times(trajectory: Trajectory) -> Sequence[float]:
    return range(len(trajectory)) if trajectory.times is None else trajectory.times


def _timed_rows(trajectory: Trajectory) -> Iterator[list[float]]:
    """Yield time, position and quaternion (x, y, z, w) of each pose."""
    for time, pose in zip(_times(trajectory), trajectory, strict=True):
        yield [time, *pose.position.tolist(), *pose.quaternion()]


def _text(header: str, rows: Iterable[Iterable[float]], separator: str = " ") -> str:
    lines = [separator.join(map(plain, row)) for row in rows]
    return "\n".join([header, *lines] if header else lines) + "\n"
