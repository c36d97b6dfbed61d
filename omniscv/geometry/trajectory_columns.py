"""Rows of named columns, from which all poses of files are made: names, units, checks, axes.

A row is a line of a trajectory (:mod:`omniscv.geometry.trajectory_files`) or an entry of JSON
(:meth:`Rows.of_entries`). A rotation is a quaternion, angles or a matrix, from the camera to the file's
world; ``frame`` says what axes both have.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number, numbers, shown, within, wrong
from omniscv.errors import ArgumentError
from omniscv.geometry.pose import FARTHEST, R_LEVEL, Array, Pose
from omniscv.geometry.unreal_frame import rotation_from_unreal

Frame = Literal["camera", "body", "object", "opengl", "ned", "unreal"] | Pose

UNITS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
PER_M = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
MATRIX = [f"m{i}" for i in range(16)]
ANGLES = ("yaw", "pitch", "roll")
QUATERNION = ("qx", "qy", "qz", "qw")
_LAST_ROW = MATRIX[12:]
_MOVED = MATRIX[3:12:4]
_TURNED = [m for m in MATRIX[:12] if m not in MATRIX[3:12:4]]
_UNITS_OF: dict[str, tuple[str, ...]] = {
    "time": (*UNITS, "sec"),
    **dict.fromkeys("xyz", tuple(PER_M)),
    **dict.fromkeys(ANGLES, ("deg", "rad")),
}
_POSE = r"(?:field\.)?(?:pose\.){0,2}(?:pano_)?"
_SPELLINGS = (
    (rf"{_POSE}(?:(?:position|location|loc|pos|translation)[._ ]?|p_rs_r_|[tp]_?)?([xyz])", r"\1"),
    (rf"{_POSE}(?:(?:orientation|ori|quat|rotation)[._ ]|q_rs_|q_?)([wxyz])", r"q\1"),
    (r"(?:(?:rotation|rot|rotator)[._ ]?)?(yaw|pitch|roll)", r"\1"),
    (r"time|timestamp|t|stamp|secs?|seconds", "time"),
    (r"nsecs?|nanosecs?|nanoseconds", "nsec"),
    (r"(?:file|image|frame|pano)?_?names?|file|image|filenames?", "name"),
    (r"v_rs_r_[xyz]|b_[wa]_rs_s_[xyz]|id|seq|field\.header\.\w+|[fc][xy]", ""),
    (r"frame(?:_?(?:idx|id|index|number))?|state|is_\w+|(?:vel(?:ocity)?[._]?|v_?)[xyz]", ""),
)  # fmt: skip
"""Names of columns in lower case, and what each is; empty: nothing of a pose."""
_MARKED = re.compile(r"(.*?)(?:\s*[\[(]\s*([^\])]*?)\s*[\])]|_(ns|us|ms|s|rad|deg|cm|mm|m))?")
_KEYS = {
    "position": ["x", "y", "z"], "translation": ["x", "y", "z"], "location": ["x", "y", "z"],
    "rotation": _TURNED, "matrix": MATRIX, "transform_matrix": MATRIX,
}  # fmt: skip
"""Keys of JSON that hold several columns, row by row."""

_MOST_ANGLE = 1e5  # degrees or radians; more digits than a turn has are lost
_ROUNDING = 1e-3  # of a quaternion's length, and the entries of R R^T: files have few digits
_EXACT = 1e-9  # a matrix that is a rotation as it is
_BLOCK = 1 << 16  # rows in memory at a time
_I = np.eye(3)
_GL = np.diag([1.0, -1, -1])
_MIRROR = np.diag([1.0, -1, 1])
_AXES: dict[str, tuple[Array, Array, tuple[int, int, int]]] = {
    "camera": (_I, _I, (1, -1, 1)),
    "object": (_I, _I, (1, -1, 1)),
    "opengl": (_I, _GL, (1, -1, 1)),
    "body": (_I, R_LEVEL, (-1, -1, 1)),
    "ned": (_GL, np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), (1, 1, 1)),
    "unreal": (_MIRROR, _MIRROR @ R_LEVEL, (1, 1, 1)),
    "povray": (R_LEVEL @ _MIRROR, _MIRROR, (1, 1, 1)),
}
"""By frame W and C of ``R_w_c = W R C``: from the file's world to ours, from our camera to the file's; and
the signs of pitch, yaw and roll against Unreal's: nose up +, turning right +, right side down +."""
FRAMES = tuple(name for name in _AXES if name not in ("object", "povray"))
_SIGNED = re.compile(r"[+-][xyz] [+-][xyz] [+-][xyz]")


def axes_of(frame: str) -> tuple[Array, Array]:
    """Return W and C of ``R_w_c = W R C``: from the file's world to ours, from our camera to the file's.

    Args:
        frame: one of :data:`FRAMES`, or where right, down and ahead point: ``+x -y -z`` is ``opengl``.
    """
    if frame in _AXES:
        return _AXES[frame][:2]
    if not _SIGNED.fullmatch(frame):
        raise wrong("axes", "where right, down and ahead point, such as +x -y -z", frame)
    directions = []
    for word in frame.split(" "):
        directions.append(float(f"{word[0]}1") * np.eye(3)["xyz".index(word[1])])
    C = np.stack(directions, axis=1)
    if round(abs(np.linalg.det(C))) != 1:
        raise ArgumentError(f"axes: expected x, y and z once each, got {shown(frame)}")
    return (_I, C) if np.linalg.det(C) > 0 else (_MIRROR, C)


def frame_of_axes(C: Array) -> str:
    """Return the name of axes by their C: one of a frame, or where right, down and ahead point."""
    for name, (_, C_of_frame, _) in _AXES.items():
        if np.array_equal(C_of_frame, C):
            return name
    words = []
    for i, row in enumerate(np.abs(C).argmax(axis=0).tolist()):
        sign = "-" if C[row, i] < 0 else "+"
        words.append(sign + "xyz"[row])
    return " ".join(words)


def length_unit(name: str, value: object) -> str | float | None:
    """Return a unit of positions: m, cm, mm, or metres; None where none is given.

    Args:
        name: what messages call it.
        value: as a user gives it: a word, a number of metres, or its text.
    """
    if value is None or value in PER_M:
        return value
    try:
        return number(name, float(value) if isinstance(value, str) else value, above=0)
    except ValueError as cause:
        raise ArgumentError(f"{name}: expected m, cm, mm, or metres of one, got {shown(value)}") from cause


# -- rows ---------------------------------------------------------------------------------------------------


@dataclass
class Rows:
    """The rows of a file, by column.

    Attributes:
        columns: x, y, z; qx ... qw, yaw, pitch, roll, or m0 ... m11, a matrix row by row, m12 ... m15 its
            last row; time; name.
        units: of columns that have one: ``ms``, ``rad``, ``cm``.
        where: returns where a row is, and its text.
        named: what the columns are called, for messages.
        relative: whether poses are relative to the first camera, as KITTI's.
        written_times: the column ``time`` as it is written; None without one.
    """

    columns: dict[str, NDArray[Any]]
    units: dict[str, str]
    where: Callable[[int], tuple[str, str]]
    named: str = "numbers of a pose"
    relative: bool = False
    written_times: NDArray[Any] | None = None

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    @classmethod
    def of_entries(cls, entries: Sequence[tuple[str, Mapping[str, Any]]]) -> Rows:
        """Return the rows of JSON, with where each is: keys as columns are called, or lists of several."""
        rows: list[dict[str, float]] = []
        units: dict[str, str] = {}
        for where, entry in entries:
            with within(where):
                rows.append(_columns_of(entry, units))
                if rows[-1].keys() != rows[0].keys():
                    before = ", ".join(rows[0])
                    others = ", ".join(rows[-1])
                    raise ArgumentError(f"expected {before}, as before, got {others}")
        columns = {}
        for name in rows[0] if rows else ():
            columns[name] = np.array([row[name] for row in rows])

        def where_is(row: int) -> tuple[str, str]:
            return entries[row][0], " ".join(f"{value:.9g}" for value in rows[row].values())

        return cls(columns, units, where_is)

    def listed(self, lossy: bool = False, **options: Any) -> dict[str, Pose | None]:
        """Return the pose of each row by its name, or by its number from 0 where rows have no names.

        Args:
            lossy: whether a row that is not finite gives None; otherwise it is refused.
            options: as of :meth:`poses`.

        Raises:
            ArgumentError: a name stands twice, or a row is no pose.
        """
        rows = np.flatnonzero(self.finite()) if lossy else np.arange(len(self))
        names = [str(name).strip() for name in self.columns.get("name", np.arange(len(self)))]
        poses: dict[str, Pose | None] = {}
        is_repeated = np.zeros(len(self), np.bool_)
        for row, name in enumerate(names):
            is_repeated[row] = name in poses
            poses[name] = None
        self.refuse(is_repeated, "each name once")
        finite = replace(self._part(rows), where=lambda row: self.where(int(rows[row])))
        positions, rotations = finite.poses(**options)
        for row, position, rotation in zip(rows.tolist(), positions, rotations, strict=True):
            poses[names[row]] = Pose(position, rotation)
        return poses

    def _part(self, rows: NDArray[np.int64] | slice) -> Rows:
        """Return these of the rows, by index."""
        return replace(self, columns={name: values[rows] for name, values in self.columns.items()})

    def refuse(self, wrong: NDArray[np.bool_], expected: str) -> None:
        """Raise ArgumentError that names the first row that is wrong, if any is.

        Args:
            wrong: (N,) which rows are.
            expected: what rows should hold.
        """
        if wrong.any():
            where, text = self.where(int(wrong.argmax()))
            raise ArgumentError(f"{where}: expected {expected}, got {shown(text)}")

    def finite(self) -> NDArray[np.bool_]:
        """Return which rows have finite numbers."""
        numeric = [values for name, values in self.columns.items() if name != "name"]
        return np.asarray(np.isfinite(np.stack(numeric)).all(axis=0))

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is refused
    def check(self) -> None:
        """Refuse rows with numbers that no pose has."""
        columns = self.columns
        self.refuse(~self.finite(), f"finite numbers {shown(self.named)}")
        for name in (*"xyz", *_MOVED):
            if name in columns:
                self.refuse(np.abs(columns[name]) > FARTHEST, f"coordinates of at most {FARTHEST:g}")
        for name in ANGLES:
            if name in columns:
                self.refuse(np.abs(columns[name]) > _MOST_ANGLE, f"angles of at most {_MOST_ANGLE:g}")
        if "m0" in columns:
            self._check_matrices()
        if "qw" in columns:
            off = np.sqrt(sum(columns[name] ** 2 for name in QUATERNION)) - 1
            self.refuse(~(np.abs(off) <= _ROUNDING), "a quaternion of length 1")

    def _check_matrices(self) -> None:
        """Refuse matrices that are no rigid motions."""
        if "m15" in self.columns:
            last = self._stack(_LAST_ROW)
            moved = np.abs(self._stack(_MOVED)).max(axis=1)
            turned = (last[:, 3] == 1) & (last[:, :3] != 0).any(axis=1) & (moved == 0)
            self.refuse(turned, "a matrix with the last row 0 0 0 1, not its transpose")
            self.refuse((last != [0, 0, 0, 1]).any(axis=1), "a matrix with the last row 0 0 0 1")
        R = self._stack(_TURNED).reshape(-1, 3, 3)
        off = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
        wrong = ~(off <= _ROUNDING) | (np.linalg.det(R) < 0)
        if wrong.any():
            remedy = _remedy(R[int(wrong.argmax())])
            self.refuse(wrong, f"the numbers of a rigid 3x4 matrix, neither scaled nor mirrored{remedy}")

    def _stack(self, names: Sequence[str]) -> Array:
        """Return columns (N, n) by their names."""
        return np.stack([self.columns[name] for name in names], axis=1)

    # -- poses ------------------------------------------------------------------------------------------

    def poses(
        self,
        frame: Frame = "camera",
        unit: str | float | None = None,
        first: Pose | None = None,
        inverse: bool = False,
    ) -> tuple[Array, Array]:
        """Return positions (N, 3) and rotations (N, 3, 3) of cameras, or of objects.

        Args:
            frame: the axes of the rows, or the pose of the camera on a body whose poses they are.
            unit: of positions, a word or in metres; if not given centimetres of Unreal, else metres.
            first: the pose of the first camera, where poses are relative to it.
            inverse: whether rows are from the world to the camera.
        """
        self.check()
        axes = frame if isinstance(frame, str) else "body"
        W, C = self._axes(frame)
        scale = self._scale(unit, frame)
        start = np.zeros(3)
        if self.relative and first is not None:
            if axes not in ("camera", "object", "body"):
                raise ArgumentError(f"frame: expected camera or body, as poses are relative, got {axes}")
            start = first.position
            # The file's world is the first camera, or the first body.
            W = first.rotation @ R_LEVEL.T if axes == "body" else first.rotation
        positions = np.empty((len(self), 3))
        rotations = np.empty((len(self), 3, 3))
        is_own = np.array_equal(W, _I) and np.array_equal(C, _I)
        for begin in range(0, len(self), _BLOCK):
            rows = slice(begin, begin + _BLOCK)
            R, t = self._part(rows)._turns_and_places(axes, scale, inverse)
            if isinstance(frame, Pose):
                t = t + R @ frame.position
            positions[rows] = t @ W.T + start
            rotations[rows] = R if is_own else W @ R @ C  # of millions of rows, a product takes seconds
        return positions, rotations

    def _axes(self, frame: Frame) -> tuple[Array, Array]:
        """Return W and C of ``R_w_c = W R C``, see :func:`axes_of`, for the rotations that columns hold."""
        if isinstance(frame, Pose):
            return np.eye(3), frame.rotation
        W, C = axes_of(frame)
        if "m0" in self.columns or "qw" in self.columns:
            return W, C
        return W, np.eye(3) if frame == "object" else R_LEVEL

    def _turns_and_places(self, axes: str, scale: float, inverse: bool) -> tuple[Array, Array]:
        """Return rotations (N, 3, 3) and positions (N, 3), metres, in the file's own axes."""
        R = self._turns(axes)
        t = self._stack(_MOVED if "m0" in self.columns else "xyz") * scale
        if inverse:
            R = R.swapaxes(1, 2)
            t = -(R @ t[..., None])[..., 0]
        return R, t

    def _scale(self, unit: str | float | None, frame: Frame) -> float:
        """Return the metres of one unit of positions."""
        of_columns = sorted({self.units[axis] for axis in "xyz" if axis in self.units})
        if len(of_columns) > 1 or (of_columns and unit not in (None, *of_columns)):
            raise ArgumentError(f"unit: expected one of positions, got {[unit or '', *of_columns]}")
        if unit is None and of_columns:
            unit = of_columns[0]
        if unit is None:
            unit = "cm" if frame == "unreal" else "m"
        return 1 / PER_M[unit] if isinstance(unit, str) else unit

    def _turns(self, axes: str) -> Array:
        """Return the rotations (N, 3, 3) that columns hold; without any, those of angles that are 0."""
        from scipy.spatial.transform import Rotation  # slow to load

        if "m0" in self.columns:
            R = self._stack(_TURNED).reshape(-1, 3, 3)
            off = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2)) > _EXACT
            R[off] = Rotation.from_matrix(R[off]).as_matrix()  # the nearest rotation
            return R
        if "qw" in self.columns:
            return np.asarray(Rotation.from_quat(self._stack(QUATERNION)).as_matrix())
        if axes not in _AXES:
            raise ArgumentError(f"axes: expected the name of a frame for angles, got {shown(axes)}")
        W, _, signs = _AXES[axes]
        rotators = np.zeros((len(self), 3))
        for i, (name, sign) in enumerate(zip(("pitch", "yaw", "roll"), signs, strict=True)):
            if name in self.columns:
                angles = self.columns[name]
                if self.units.get(name) == "rad":
                    angles = np.degrees(angles)
                rotators[:, i] = sign * angles
        return W @ rotation_from_unreal(rotators)


def _remedy(R: Array) -> str:
    """Return what to do with a matrix that is a scaled or mirrored rotation; empty for any other."""
    volume = float(np.linalg.det(R))
    scale = abs(volume) ** (1 / 3)
    if not (np.isfinite(scale) and scale > 0):
        return ""
    if np.abs(R @ R.T / scale**2 - np.eye(3)).max() > _ROUNDING:
        return ""
    if volume < 0:
        return (
            " (its axes are mirrored: say those of the file, as --frame unreal, or exchange the sign of one)"
        )
    return f" (it is a rotation times {scale:.6g}, as MatrixCity's of 0.01: divide its nine numbers by that)"


def _columns_of(entry: Mapping[str, Any], units: dict[str, str]) -> dict[str, float]:
    """Return the numbers of an entry of JSON by column; add their units, "" for none, to ``units``."""
    columns: dict[str, float] = {}
    for key, value in entry.items():
        if value is None:
            continue
        numbers_of_key = _numbers_of(key, value, units)
        twice = numbers_of_key.keys() & columns.keys()
        if twice:
            raise ArgumentError(f"expected each of a pose once, got {min(twice)} twice, by {key}")
        columns |= numbers_of_key
    if "m0" in columns and "x" in columns:
        for name, axis in zip(_MOVED, "xyz", strict=True):
            columns[name] = columns.pop(axis)
    for column in list(units):
        if not units[column]:
            del units[column]
    _check_columns(list(columns))
    return columns


def _numbers_of(key: str, value: Any, units: dict[str, str]) -> dict[str, float]:
    """Return the numbers of a key of JSON by column: one, or several of :data:`_KEYS`."""
    names = _KEYS.get(key.lower())
    if names is not None:
        is_listed = isinstance(value, list | tuple | np.ndarray)
        values = np.ravel(numbers(key, value, np.shape(value) if is_listed else (None,))).tolist()
        counts = (12, 16) if names is MATRIX else (len(names),)
        if len(values) not in counts:
            raise ArgumentError(f"{key}: expected {len(names)} numbers, got {shown(value)}")
        if names is MATRIX:
            values += [0, 0, 0, 1]  # where it has no last row
        return dict(zip(names, values, strict=False))
    column, unit = column_of(key)
    if not column or column == "name":
        known = ", ".join(("x, y, z", *ANGLES, *QUATERNION, *_KEYS))
        raise ArgumentError(f"expected keys among {known}; got {shown(key)}")
    units[column] = unit or units.get(column, "")
    return {column: number(key, value)}


def _check_columns(columns: Sequence[str]) -> None:
    """Refuse what is no pose, or is given twice."""
    for column in columns:
        if column and columns.count(column) > 1:
            raise ArgumentError(f"expected each column once, got {column} twice")
    for name in _MOVED if "m0" in columns else "xyz":
        if name not in columns:
            raise ArgumentError(f"expected columns x, y and z, got no {name}")
    turned = [name for name in QUATERNION if name in columns]
    ways = bool(turned) + bool({*ANGLES} & {*columns}) + ("m0" in columns)
    if turned and (len(turned) < 4 or ways > 1):
        raise ArgumentError("expected qx, qy, qz and qw, or yaw, pitch and roll; got some of them")
    if ways > 1:
        raise ArgumentError("expected a rotation once, got a matrix and angles")


# -- names of columns ---------------------------------------------------------------------------------------


def column_of(word: str) -> tuple[str | None, str]:
    """Return what a name stands for, None if it is not known, and its unit."""
    match = _MARKED.fullmatch(word.lower())
    name, in_brackets, behind = match.groups() if match else (word, None, None)
    for pattern, column in _SPELLINGS:
        spelling = re.fullmatch(pattern, name)
        if spelling:
            return spelling.expand(column), in_brackets or behind or ""
    return None, ""


def named_columns(words: list[str], count: int, keyed: bool) -> tuple[list[str], dict[str, str]]:
    """Return what columns are, "" for those that are not read, and their units, by their names.

    Args:
        words: the names.
        count: of numbers in a row.
        keyed: whether rows have a name, in a column that is called so or in the first one.
    """
    columns, units = _columns_and_units(words, keyed)
    if len(words) != count:
        raise ArgumentError(f"expected {len(words)} columns, as there are names, got {count} in one row")
    if keyed and "name" not in columns:
        raise ArgumentError(f"expected a column 'name', got {shown(' '.join(words))}")
    if not keyed:
        columns = ["" if column == "name" else column for column in columns]
    _check_columns(columns)
    if "nsec" in columns and "time" not in columns:
        columns[columns.index("nsec")] = "time"
        units["time"] = "ns"
    _check_units(units)
    return columns, units


def _columns_and_units(words: list[str], keyed: bool) -> tuple[list[str], dict[str, str]]:
    """Return what columns are by their names, and the units of those that have one; of ``keyed`` rows the
    first column is the name where none is called so."""
    found = [column_of(word) for word in words]
    if keyed and "name" not in dict(found) and not found[0][0]:
        found[0] = ("name", "")
    columns = []
    units = {}
    for word, (column, unit) in zip(words, found, strict=True):
        if column is None:
            known = ", ".join(("time", *"xyz", *ANGLES, *QUATERNION))
            raise ArgumentError(f"expected names of columns among {known}; got {shown(word)}")
        columns.append(column)
        if column and unit:
            units[column] = unit
    return columns, units


def _check_units(units: Mapping[str, str]) -> None:
    """Refuse units that the numbers of a column cannot have."""
    for column, unit in units.items():
        fitting = _UNITS_OF.get(column, ())
        if unit not in fitting:
            wanted = " or ".join(fitting) or "no unit"
            raise ArgumentError(f"expected {column} in {wanted}, got {shown(unit)}")
