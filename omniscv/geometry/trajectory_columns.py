"""How the rows of a trajectory's file are written: separator, comments, and what the columns are."""

import re
from typing import NamedTuple

from omniscv.arguments import shown
from omniscv.errors import ArgumentError

UNITS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_MANY = 5  # names of columns that a comment does not have by chance
_TUM, _EUROC = (
    ["time", "x", "y", "z", "qx", "qy", "qz", "qw"],
    ["time", "x", "y", "z", "qw", "qx", "qy", "qz"],
)
MATRIX = [f"m{i}" for i in range(12)]
ANGLES, QUATERNION = ("yaw", "pitch", "roll"), ("qx", "qy", "qz", "qw")
_UNITS_OF: dict[str, tuple[str, ...]] = {
    "time": (*UNITS, "sec"), **dict.fromkeys("xyz", ("m",)), **dict.fromkeys(ANGLES, ("deg", "rad")),
}  # fmt: skip
_POSE = r"(?:field\.)?(?:pose\.){0,2}(?:pano_)?"
_SPELLINGS = (
    (rf"{_POSE}(?:position[._]|pos_|p_rs_r_|[tp]_?)?([xyz])", r"\1"),
    (rf"{_POSE}(?:orientation[._]|ori_|q_rs_|q_?)([wxyz])", r"q\1"),
    (r"(yaw|pitch|roll)", r"\1"),
    (r"time|timestamp|t|stamp|secs?|seconds", "time"),
    (r"nsecs?|nanosecs?|nanoseconds", "nsec"),
    (r"v_rs_r_[xyz]|b_[wa]_rs_s_[xyz]|id|seq|filename|field\.header\.\w+", ""),
    (r"frame(?:_?(?:idx|id|index|number))?|state|is_\w+|(?:vel(?:ocity)?[._]?|v_?)[xyz]", ""),
)
"""Names of columns in lower case, and what each is; empty: nothing of a pose."""
_MARKED = re.compile(r"(.*?)(?:\s*[\[(]\s*([^\])]*?)\s*[\])]|_(ns|us|ms|s|rad|deg))?")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+(e[-+]?\d+)?", re.IGNORECASE)
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
_WORD = re.compile(r"[^\W\d][\w.]*(?:\s*[\[(][^\])]*[\])])?")


class Dialect(NamedTuple):
    """How the rows of a file are written.

    Attributes:
        name: TUM, KITTI, EuRoC, or empty where names say what the columns are.
        columns: what each is; empty for one that is not read.
        units: of columns that have one: ``ms``, ``rad``.
        separator: None for blanks.
        comment: what starts one.
        named: the names in the file, for messages.
    """

    name: str
    columns: list[str]
    units: dict[str, str]
    separator: str | None
    comment: str
    named: str


def is_names(text: str) -> bool:
    """Return whether a line has names of columns: words, none of which is a number."""
    words = [word for word in re.split(r"[\s,;]+", text) if word]
    return any(word[0].isalpha() for word in words) and not any(map(_NUMBER.fullmatch, words))


def split(text: str, separator: str | None) -> list[str]:
    return [word.strip().strip("\"'") for word in text.split(separator)]


def dialect_of(names: str, comments: list[str], row: str) -> tuple[Dialect, list[str]]:
    """Return how rows are written, and the types of columns, by the first row and what is above it."""
    comment = comments[-1][0] if comments else "#"
    row = row.partition(comment)[0].strip()
    separator = next((mark for mark in ";," if mark in row), None)
    check_decimals(row, separator)
    words = split(row, separator)
    count = len(words)
    line = names
    if names:
        mark = separator or ("\t" if "\t" in names else None)
        of_line = split(names, mark) if mark else re.split(r"\s+(?![\[(])", names)  # not before a unit
    else:
        line, of_line = _names_in_comments(comments, count, separator)
    if of_line:
        columns, units = _named(of_line, count)
        name = "EuRoC" if "rs_r" in line.lower() else ""
    else:
        name, columns = _without_names(separator, count)
        units, line = {}, " ".join(columns) if name != "KITTI" else "the 12 numbers of a rigid 3x4 matrix"
    types = ["f8" if column else "S1" for column in columns]
    if "time" in columns:
        i = columns.index("time")
        if (name == "EuRoC" and not of_line) or re.fullmatch(r"[+-]?\d{15,}", words[i]):
            types[i] = "i8"  # a float64 would lose digits
            units.setdefault("time", "ns" if name == "EuRoC" else "")
    return Dialect(name, columns, units, separator, comment, line.strip()), types


def _names_in_comments(comments: list[str], count: int, separator: str | None) -> tuple[str, list[str]]:
    """Return the last comment that names the columns, and the names; none if there is no such.

    Raises:
        ArgumentError: it names many, but not each.
    """
    for line in reversed(comments):
        words = split(line.lstrip("#% "), separator) if separator else _WORD.findall(line)
        words = [word for word in words if _column(word)[0] is not None]
        known = {_column(word)[0] for word in words}
        if len(words) == count and {*"xyz"} <= known:
            return line, words
        if len(known) >= _MANY:
            raise ArgumentError(f"expected {count} names of columns, got {len(words)} in {shown(line)}")
    return "", []


def _column(word: str) -> tuple[str | None, str]:
    """Return what a name stands for, None if it is not known, and its unit."""
    match = _MARKED.fullmatch(word.lower())
    name, *units = match.groups() if match else (word,)
    for pattern, column in _SPELLINGS:
        if match := re.fullmatch(pattern, name):
            return match.expand(column), next(filter(None, units), "")
    return None, ""


def _named(words: list[str], count: int) -> tuple[list[str], dict[str, str]]:
    """Return what columns are, and their units, by their names."""
    found = [_column(word) for word in words]
    columns = [column or "" for column, _ in found]
    if unknown := [word for word, (column, _) in zip(words, found, strict=True) if column is None]:
        known = ", ".join(("time", *"xyz", *ANGLES, *QUATERNION))
        raise ArgumentError(f"expected names of columns among {known}; got {shown(unknown[0])}")
    if len(words) != count:
        raise ArgumentError(
            f"expected {len(words)} columns, as there are names, got {count} in the first row"
        )
    if twice := [column for column in columns if column and columns.count(column) > 1]:
        raise ArgumentError(f"expected each column once, got {twice[0]} twice")
    if missing := [name for name in "xyz" if name not in columns]:
        raise ArgumentError(f"expected columns x, y and z, got no {missing[0]}")
    turned = [name for name in QUATERNION if name in columns]
    if turned and (len(turned) < 4 or {*ANGLES} & {*columns}):
        raise ArgumentError("expected qx, qy, qz and qw, or yaw, pitch and roll; got some of them")
    units = {column: unit for column, unit in found if column and unit}
    if "nsec" in columns and "time" not in columns:
        columns[columns.index("nsec")], units["time"] = "time", "ns"
    for column, unit in units.items():
        fitting = _UNITS_OF.get(column, ())
        if unit not in fitting:
            raise ArgumentError(
                f"expected {column} in {' or '.join(fitting) or 'no unit'}, got {shown(unit)}"
            )
    return columns, units


def _without_names(separator: str | None, count: int) -> tuple[str, list[str]]:
    """Return the layout, and the columns, of rows without names."""
    if separator and count in (8, 17):
        return "EuRoC", _EUROC + [""] * (count - 8)
    if not separator and count in (8, 12):
        return ("TUM", _TUM) if count == 8 else ("KITTI", MATRIX)
    known = "8 or 17 columns with a separator (EuRoC), 8 (TUM) or 12 (KITTI) with blanks"
    raise ArgumentError(f"expected names of the columns, or {known}; got {count} columns without names")


def check_decimals(row: str, separator: str | None) -> None:
    """Refuse decimal commas."""
    cells = split(row, ";") if separator == ";" else row.split()
    alone = len(cells) > 1 and not any(cell.strip(",") != cell for cell in cells)
    if alone and any(map(_DECIMAL_COMMA.fullmatch, cells)):
        raise ArgumentError(f"expected decimal points, got a comma in {shown(row[:60])}")
