"""How the rows of a trajectory's file are written: separator, comments, and what the columns are."""

import csv
import re
from typing import NamedTuple

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.geometry.trajectory_columns import MATRIX, column_of, named_columns

_MANY = 5  # names of columns that a comment does not have by chance
_WORD = re.compile(r"[^\W\d][\w.]*(?:\s*[\[(][^\])]*[\])])?")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+(e[-+]?\d+)?", re.IGNORECASE)
_TUM = ["time", "x", "y", "z", "qx", "qy", "qz", "qw"]
_EUROC = ["time", "x", "y", "z", "qw", "qx", "qy", "qz"]


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


def dialect_of(names: str, comments: list[str], row: str, keyed: bool = False) -> tuple[Dialect, list[str]]:
    """Return how rows are written, and the types of columns as NumPy names them.

    Args:
        names: the line of names; "" for none.
        comments: those above the first row.
        row: the first row.
        keyed: whether rows have a name, in a column that is called so or in the first one.
    """
    comment = comments[-1][0] if comments else "#"
    row = row.partition(comment)[0].strip()
    separator = _separator_of(row)
    check_decimals(row, separator)
    words = split(row, separator)
    if names:
        line = names
        listed = _names_of_line(names, separator)
    else:
        line, listed = names_in_comments(comments, len(words), separator)
    if listed:
        columns, units = named_columns(listed, len(words), keyed)
        name = "EuRoC" if "rs_r" in line.lower() else ""
    else:
        name, columns = _without_names(separator, len(words) - keyed, keyed)
        if keyed:
            columns = ["name", *columns]
        units = {}
        line = " ".join(columns) if "m0" not in columns else "the 12 numbers of a rigid 3x4 matrix"
    types = [_TYPES.get(column, "f8") for column in columns]
    if "time" in columns:
        i = columns.index("time")
        if (name == "EuRoC" and not listed) or re.fullmatch(r"[+-]?\d{15,}", words[i]):
            types[i] = "i8"  # a float64 would lose digits
            units.setdefault("time", "ns" if name == "EuRoC" else "")
    return Dialect(name, columns, units, separator, comment, line.strip()), types


_TYPES = {"name": "O", "": "S1"}
"""Types of columns that are no numbers: names, and what is not read."""


def _separator_of(row: str) -> str | None:
    """Return the separator of a row, quotes aside; None for blanks."""
    unquoted = re.sub(r'"[^"]*"', "", row)
    return next((mark for mark in ";," if mark in unquoted), None)


def _names_of_line(line: str, separator: str | None) -> list[str]:
    """Return the names of columns in a line of them; a blank before a unit in brackets does not part two."""
    mark = separator or ("\t" if "\t" in line else None)
    return split(line, mark) if mark else re.split(r"\s+(?![\[(])", line)


def _without_names(separator: str | None, count: int, keyed: bool) -> tuple[str, list[str]]:
    """Return the layout, and the columns, of rows without names."""
    if separator and count in (8, 17) and not keyed:
        return "EuRoC", _EUROC + [""] * (count - 8)
    of_count = {3: ["x", "y", "z"], 7: _TUM[1:], 12: MATRIX[:12], 16: MATRIX}
    if keyed and count in of_count:
        return "", of_count[count]
    if not separator and count in (8, *of_count):
        return {8: "TUM", 12: "KITTI"}.get(count, ""), _TUM if count == 8 else of_count[count]
    if keyed:
        wanted = "rows of a name and x y z qx qy qz qw, x y z, or a matrix"
        raise ArgumentError(f"expected names of the columns, or {wanted}; got {count} numbers without names")
    known = "8 or 17 columns with a separator (EuRoC), 8 (TUM), 12 (KITTI), 3, 7 or 16 with blanks"
    raise ArgumentError(f"expected names of the columns, or {known}; got {count} columns without names")


def check_decimals(row: str, separator: str | None) -> None:
    """Refuse decimal commas.

    Args:
        row: a line of numbers.
        separator: of the file; None for blanks.
    """
    cells = split(row, ";") if separator == ";" else row.split()
    alone = len(cells) > 1 and not any(cell.strip(",") != cell for cell in cells)
    if alone and any(map(_DECIMAL_COMMA.fullmatch, cells)):
        raise ArgumentError(f"expected decimal points, got a comma in {shown(row[:60])}")


def is_names(text: str) -> bool:
    """Return whether a line has names of columns: words, none of which is a number."""
    words = [word for word in re.split(r"[\s,;]+", text) if word]
    return any(word[0].isalpha() for word in words) and not any(map(_NUMBER.fullmatch, words))


def split(text: str, separator: str | None) -> list[str]:
    """Return the words of a line.

    Args:
        text: the line; quotes hold separators.
        separator: None for blanks.
    """
    if separator is None:
        words = re.findall(r'"[^"]*"|\S+', text)
    else:
        words = next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    return [word.strip().strip("\"'") for word in words]


def names_in_comments(comments: list[str], count: int, separator: str | None) -> tuple[str, list[str]]:
    """Return the last comment that names the columns, and the names; none if there is no such.

    Args:
        comments: of the file, in order.
        count: of columns.
        separator: of rows; None for blanks.

    Raises:
        ArgumentError: it names many, but not each.
    """
    for line in reversed(comments):
        text = line.lstrip("#% ")
        words = split(text.rpartition(":")[2], separator) if separator else _WORD.findall(text)
        words = [word for word in words if column_of(word)[0] is not None]
        known = {column_of(word)[0] for word in words}
        if len(words) == count and {*"xyz"} <= known:
            return line, words
        if len(known) >= _MANY:
            raise ArgumentError(f"expected {count} names of columns, got {len(words)} in {shown(line)}")
    return "", []
