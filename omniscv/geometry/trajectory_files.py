"""Files of trajectories: TUM, KITTI, EuRoC and CSV, read by columns.

Files hold the camera's positions in the world, metres, and rotations from camera to world. Names of the
columns, in a first line or a comment (``#``, ``%``), say what each is, and its unit: ``time_ms``,
``timestamp [ns]``, ``yaw_rad``. Without names:

* TUM: ``time tx ty tz qx qy qz qw``, seconds, separated by blanks.
* KITTI: the 3x4 matrix from camera i to the first one, row by row; times are in another file, one a line.
* EuRoC: ``time,px,py,pz,qw,qx,qy,qz``, whole nanoseconds; 8 columns, or 17 with velocities and biases.
"""

import io
import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple
from warnings import catch_warnings

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry.pose import R_LEVEL, Array, Pose
from omniscv.geometry.trajectory import NS, Poses, Trajectory, all_parsed, decimal, parsed
from omniscv.geometry.trajectory_columns import UNITS, Frame, Rows
from omniscv.geometry.trajectory_dialects import Dialect, check_decimals, dialect_of, is_names, split
from omniscv.storage.bounded import MOST_JSON_BYTES, encoding_of, open_regular, parse_json, read_bytes

_SECONDS = 1e11  # the year 5138: milliseconds since 1970 are more, and all seconds are less
_MOST_TIME = 1e19  # of a file, in any unit
_MOST_SECONDS = 9.2e9  # in nanoseconds of 64 bits

# Seconds from row to row:
_SLOW = 10.0  # no camera is so slow
_SLOW_WHOLE = 2.0  # whole numbers are as often ms
_TOO_SLOW = 1e4  # refused

_MOST_BYTES = 1 << 28  # of a file
_SAID_EVERY_S = 5.0  # how far a long file is read
_LOOKED_EVERY = 1 << 14  # rows
_log = logging.getLogger("omniscv")
_FIRST = Pose(np.zeros(3), R_LEVEL)
# Two rows of one time, rounded, are one pose:
_SAME_M = 1e-3  # metres between their coordinates
_SAME_ENTRY = 2e-3  # between the entries of their rotations
_CONVERTED = "cameraposes.csv"
"""EasySynth's file, in lower case: metres, x forward, y left, z up, by its own description."""


def read_trajectory(
    path: Path, first: Pose = _FIRST, frame: Frame | None = None, unit: str | float | None = None
) -> Trajectory:
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
            ``unreal``: Unreal's axes, rotators and centimetres. ``opengl`` and ``ned``, as for imports.
        unit: of positions: m, cm, mm, or metres of one.

    Returns:
        The trajectory; ``says`` has what was assumed.

    Raises:
        ArgumentError: the file cannot be read, a line does not hold the finite numbers of a pose, times
            do not increase, or two rows of one time have different poses.
    """
    with within(path):
        dialect, rows = read_rows(path)
        check_frame(path, frame)
        positions, rotations = rows.poses(frame or "camera", unit, first)
        times, says = _times_of(dialect, rows)
        if times is None and dialect.name == "KITTI":
            times = _kitti_times(path)
        if times is not None:
            kept, again = _without_repeats(rows, times, positions, rotations)
            if again:
                times = times[kept]
                positions = positions[kept]
                rotations = rotations[kept]
                says.append(f"{again} rows that repeat the row before are left out")
    if dialect.name == "EuRoC" and frame is None:
        says.append(
            f"the rotation is that of EuRoC's body, an IMU, taken as the camera's; for the camera write "
            f"{{file: {path.name}, frame: cam0/sensor.yaml}}, the file that has its T_BS"
        )
    with within(path):
        stamps = None if times is None else tuple(times.tolist())
        return Trajectory(Poses(positions, rotations), stamps, says=tuple(says))


def read_poses(path: Path, *, keyed: bool, whole: bool = False, **options: Any) -> dict[str, Pose | None]:
    """Return the poses of a file by name, or by number from 0.

    Args:
        path: a text of rows; or ``.json``, entries by name or a list with ``name``.
        keyed: as of :func:`read_rows`.
        whole: as of :func:`read_rows`.
        options: as of :meth:`Rows.listed`.
    """
    check_frame(path, options.get("frame"))
    if path.suffix.lower() != ".json":
        _, rows = read_rows(path, keyed, whole)
    else:
        rows = _rows_of_json(parse_json(read_bytes(path, MOST_JSON_BYTES)))
    return rows.listed(**options)


def _rows_of_json(data: Any) -> Rows:
    """Return the rows of entries by name, or of a list of entries, which may have a ``name``."""
    entries = []
    names = []
    if isinstance(data, list):
        for i, item in enumerate(data):
            entry = dict(item)
            names.append(str(entry.pop("name", f"[{i}]")))
            entries.append((f"[{i}]", entry))
    else:
        for name, entry in data.items():
            names.append(name)
            entries.append((name, entry))
    rows = Rows.of_entries(entries)
    return replace(rows, columns={"name": np.array(names, object), **rows.columns})


def check_frame(path: Path, frame: Frame | None) -> None:
    """Refuse a file of Unreal's poses without the word that says in which axes they are.

    Args:
        path: the file, of which only the name is read.
        frame: the word; None if none is given.
    """
    if frame is None and path.name.lower() == _CONVERTED:
        body = "frame: body (as EasySynth writes: metres, x forward, y left, z up)"
        raise ArgumentError(f"expected frame: unreal (Unreal's own axes, in cm) or {body}, got no frame")


# -- rows ------------------------------------------------------------------------------------------------


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text file; ArgumentError where it cannot be read."""
    try:
        opened = open_regular(path, most=_MOST_BYTES)
        with io.TextIOWrapper(opened, encoding=encoding_of(opened.peek(4)[:4])) as lines:
            yield from lines
    except OSError as cause:
        raise ArgumentError(f"expected a readable file, got {cause.strerror}") from cause
    except UnicodeDecodeError as cause:
        raise ArgumentError(str(cause)) from cause


def _counted(lines: Iterator[str], path: Path) -> Iterator[str]:
    """Yield lines, and say how far they are read every few seconds."""
    next_s = time.monotonic() + _SAID_EVERY_S
    for number, line in enumerate(lines, start=1):
        if not number % _LOOKED_EVERY and time.monotonic() > next_s:
            _log.warning("%s: %d rows read", path, number)
            next_s += _SAID_EVERY_S
        yield line


def read_rows(path: Path, keyed: bool = False, whole: bool = False) -> tuple[Dialect, Rows]:
    """Return how a file is written, and its rows.

    Args:
        path: the file.
        keyed: whether rows have names, in a column that is called so, or in the first one.
        whole: whether all numbers of the file are one row, as of a matrix in four lines.
    """
    lines: Iterator[str] = _lines(path)
    if whole:
        lines = iter([" ".join(lines).replace("\n", " ")])
    head = _head_of(lines)
    with within(f"line {head.number}"):
        dialect, types = dialect_of(head.names, head.comments, head.row, keyed)
    try:
        with catch_warnings(action="error"):  # a fraction of a nanosecond
            table = np.loadtxt(
                filter(str.strip, chain([head.row], _counted(lines, path))),
                np.dtype(_fields(dialect, types)),
                comments=dialect.comment,
                delimiter=dialect.separator,
                quotechar='"' if keyed else None,
                ndmin=1,
            )
        columns = {}
        for i, name in enumerate(dialect.columns):
            if name:
                columns[name] = table[f"c{i}"]
        written_times = columns.get("time")
        if written_times is not None:
            columns["time"] = written_times.astype(types[dialect.columns.index("time")])
    except (ValueError, OverflowError, DeprecationWarning) as cause:
        raise _wrong_line(path, dialect, types) from cause

    def where_is(row: int) -> tuple[str, str]:
        number, text = next(line for i, line in enumerate(_data_lines(path, dialect)) if whole or i == row)
        return f"line {number}", text

    relative = dialect.name == "KITTI"
    return dialect, Rows(columns, dialect.units, where_is, dialect.named, relative, written_times)


class _Head(NamedTuple):
    """The lines of a file up to its first row.

    Attributes:
        names: the line of names; "" for none.
        comments: the comments.
        row: the first row.
        number: of the line of names, else of the first row, from 1.
    """

    names: str
    comments: list[str]
    row: str
    number: int


def _head_of(lines: Iterator[str]) -> _Head:
    """Return the head of a file, whose lines are read up to the first row; ArgumentError without a row."""
    comments: list[str] = []
    names = ""
    number_of_names = 0
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if text.startswith(("#", "%")):
            comments.append(text)
        elif text and not names and is_names(text):
            names = text
            number_of_names = number
        elif text:
            return _Head(names, comments, text, number_of_names or number)
    wanted = "expected rows of numbers below the names" if names else "expected rows of a trajectory"
    raise ArgumentError(f"{wanted}, such as 'time tx ty tz qx qy qz qw', got none")


def _fields(dialect: Dialect, types: Sequence[str]) -> list[tuple[str, str]]:
    """Return the names and types of columns as NumPy reads them.

    Decimals of seconds are kept as they are written: a float64 would lose some.
    """
    fields = []
    for i, (name, kind) in enumerate(zip(dialect.columns, types, strict=True)):
        fields.append((f"c{i}", "O" if name == "time" else kind))
    return fields


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
    readers: dict[str, Any] = {"f8": float, "i8": int}
    for number, text in _data_lines(path, dialect):
        words = split(text, dialect.separator)
        try:
            with within(f"line {number}"):
                check_decimals(text, dialect.separator)
            for kind, word in zip(types, words, strict=True):
                np.array([readers.get(kind, str)(word)], kind)
        except ArgumentError as cause:
            return cause
        except (ValueError, OverflowError):
            return ArgumentError(f"line {number}: expected {shown(dialect.named)}, got {shown(text)}")
    return ArgumentError(f"expected rows {shown(dialect.named)}, got others")


# -- from columns to poses ---------------------------------------------------------------------------------


def _times_of(dialect: Dialect, rows: Rows) -> tuple[NDArray[np.int64] | None, list[str]]:
    """Return times in whole nanoseconds, and what was assumed."""
    if rows.written_times is None:
        return None, []
    times = rows.columns["time"]
    if "nsec" in rows.columns:
        return times.astype(np.int64) * NS + rows.columns["nsec"].astype(np.int64), []
    unit = dialect.units.get("time", "").removesuffix("ec")
    says: list[str] = []
    if not unit:
        unit, says = _assumed_unit(times)
    largest_s = float(np.abs(times).max()) / UNITS[unit]
    if largest_s > _MOST_SECONDS:
        raise ArgumentError(f"time: expected seconds, got {largest_s:.15g}")
    return np.array(all_parsed(rows.written_times.tolist(), UNITS[unit])), says


def _assumed_unit(times: NDArray[Any]) -> tuple[str, list[str]]:
    """Return the unit of times (N,) without one, and what to say of it: seconds, unless they are too many."""
    smallest = float(np.abs(times).min())
    largest = float(np.abs(times).max())
    if largest > _SECONDS:
        unit = "ns"
        if largest < _SECONDS * 1e3:
            unit = "ms"
        elif largest < _SECONDS * 1e6:
            unit = "us"
        if largest > _MOST_TIME or smallest < _SECONDS * UNITS[unit] / 1e3:
            raise ArgumentError(f"time: expected seconds, got {smallest:.15g} to {largest:.15g}")
        return unit, [f"times up to {largest:.6g} are taken as {unit} since 1970"]
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    slow = _SLOW if (times % 1).any() else _SLOW_WHOLE
    if not step >= slow:
        return "s", []
    advice = "name the column time_s, time_ms, time_us or time_ns"
    if step >= _TOO_SLOW:
        raise ArgumentError(f"time: expected seconds, got steps of {step:.9g}; {advice}")
    return "s", [f"times in steps of {step:.9g} are taken as seconds; if they are others, {advice}"]


def _without_repeats(
    file: Rows, times: NDArray[Any], positions: Array, rotations: Array
) -> tuple[NDArray[np.bool_], int]:
    """Return which rows do not repeat the time and the pose of the row before, and how many do."""
    again = np.diff(times, prepend=times[0] - 1) == 0
    rows = np.flatnonzero(again)
    if rows.size and len(times) == len(positions):
        moved = np.abs(positions[rows] - positions[rows - 1]).max(axis=1) > _SAME_M
        moved |= np.abs(rotations[rows] - rotations[rows - 1]).max(axis=(1, 2)) > _SAME_ENTRY
        different = np.zeros(len(again), np.bool_)
        different[rows] = moved
        file.refuse(different, "one pose at a time, or two equal ones")
    return ~again, rows.size


def _kitti_times(path: Path) -> NDArray[np.int64] | None:
    """Return the times beside a file of KITTI's, whole nanoseconds; None without such a file."""
    for beside in (path.with_suffix(".times"), path.with_name("times.txt")):
        if beside.is_file():
            with within(beside.name):
                try:
                    return np.array([parsed(text) for text in " ".join(_lines(beside)).split()])
                except (ArithmeticError, ValueError) as cause:
                    raise ArgumentError("expected a finite number in each line, got others") from cause
    return None


# -- writing -----------------------------------------------------------------------------------------------


def write_tum(trajectory: Trajectory) -> str:
    """Return the text of a TUM file; poses without times are numbered from 0."""
    return _text("# time tx ty tz qx qy qz qw", _timed_rows(trajectory))


def write_euroc(trajectory: Trajectory) -> str:
    """Return the text of a EuRoC ``data.csv``; poses without times are numbered from 0, in seconds."""
    names = "p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
    rows = []
    for stamp, row in zip(_stamps(trajectory), _timed_rows(trajectory), strict=True):
        _, x, y, z, qx, qy, qz, qw = row
        rows.append([str(stamp), x, y, z, qw, qx, qy, qz])
    return _text(f"#timestamp [ns],{names}", rows, ",")


def write_kitti(trajectory: Trajectory) -> str:
    """Return the text of a KITTI odometry file: poses relative to the first one, without times."""
    first = trajectory[0]
    rows = []
    for pose in trajectory:
        T_0_c = np.column_stack([first.rotation.T @ pose.rotation, first.to_camera(pose.position)])
        rows.append(map(plain, T_0_c.ravel().tolist()))
    return _text("", rows)


def write_kitti_times(trajectory: Trajectory) -> str:
    """Return the text of KITTI's ``times.txt``: seconds, one per pose; without times, numbers from 0."""
    return _text("", ([decimal(stamp)] for stamp in _stamps(trajectory)))


def plain(value: float) -> str:
    """Return the shortest text that is read back as the same number; whole numbers without ``.0``."""
    return str(value + 0).removesuffix(".0")


def _stamps(trajectory: Trajectory) -> Sequence[int]:
    """Return the times, whole nanoseconds; without any, seconds from 0."""
    return range(0, NS * len(trajectory), NS) if trajectory.times_ns is None else trajectory.times_ns


def _timed_rows(trajectory: Trajectory) -> Iterator[list[str]]:
    """Yield the texts of time, position and quaternion (x, y, z, w) of each pose."""
    for stamp, pose in zip(_stamps(trajectory), trajectory, strict=True):
        yield [decimal(stamp), *map(plain, (*pose.position.tolist(), *pose.quaternion()))]


def _text(header: str, rows: Iterable[Iterable[str]], separator: str = " ") -> str:
    """Return lines of words below a header, which may be empty."""
    lines = [separator.join(row) for row in rows]
    return "\n".join([header, *lines] if header else lines) + "\n"
