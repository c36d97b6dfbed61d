"""The object table of a recording: as rows, and what two tables must agree in to be one."""

from collections.abc import Callable, Iterable
from typing import Any

from omniscv import modalities
from omniscv.arguments import shown
from omniscv.errors import DamagedRecordingError
from omniscv.sources.base import ObjectTable
from omniscv.sources.recording.rows import DEFAULT_TOLERANCE, Head, checksum, object_from_json
from omniscv.sources.recording.schema import MOST_OBJECTS

INSERT = "INSERT INTO object VALUES (?, ?, ?, ?, ?)"

Query = Callable[..., list[Any]]
ObjectRow = tuple[str, int, int, int, int | None]
"""name, red, green, blue, instance id."""

_MOST_ROWS = MOST_OBJECTS + 1


def read(query: Query, head: Head | None) -> ObjectTable:
    """Return the object table of a recording; ``head`` is None in version 1.

    Raises:
        DamagedRecordingError: it is not as it was written.
    """
    return _table(*(_read_1(query) if head is None else _read(query, head)))


def rows_of(table: ObjectTable) -> list[ObjectRow]:
    """Return the rows of a table, in the order of names."""
    return [(name, *table.colors[name], table.ids.get(name)) for name in table.names()]


def checksum_of(rows: Iterable[ObjectRow]) -> int:
    """Return the checksum of rows; an id that is not known counts as an empty text."""
    return checksum("" if value is None else value for row in rows for value in row)


def labelled_modes() -> list[str]:
    """Return the modes whose captures need the object table, with their aliases."""
    rows = [row for row in modalities.layers() if row.derives]
    return [name for row in rows for name in (row.name, *row.aliases)]


def conflict(before: ObjectTable, after: ObjectTable) -> str:
    """Return why captured masks would get other names: a name has two colours, or a colour two names.

    Empty where the tables agree.
    """
    if before.colors and before.tolerance != after.tolerance:
        return f"the tolerance is {after.tolerance} and was {before.tolerance}"
    kind = "ids" if after.ids else "colors"
    known: dict[str, Any] = getattr(before, kind)
    names = {value: name for name, value in known.items()}
    for name, value in getattr(after, kind).items():
        if known.get(name, value) != value:
            return f"{shown(name)} is {value} and was {known[name]}"
        if names.get(value, name) != name:
            return f"{shown(name)} is {value}, which was {shown(names[value])}"
    return ""


def union(before: ObjectTable, after: ObjectTable) -> ObjectTable:
    """Return the objects of two tables that agree."""
    ids = {**before.ids, **after.ids}
    return ObjectTable({**before.colors, **after.colors}, after.tolerance, ids)


def _read(query: Query, head: Head) -> tuple[list[ObjectRow], int]:
    bound = f"LIMIT {_MOST_ROWS}"
    rows = query(f"SELECT name, red, green, blue, instance FROM object ORDER BY name {bound}")
    found = checksum_of(sorted(rows, key=lambda row: str(row[0])))  # a flipped bit can make a name NULL
    if found != head.object_checksum:
        wanted = f"expected checksum {head.object_checksum} of the object table"
        raise DamagedRecordingError(f"{wanted}, got {found}")
    return rows, head.tolerance


def _read_1(query: Query) -> tuple[list[ObjectRow], int]:
    held = query("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'mask'")
    masks = query("SELECT tolerance, ids FROM mask LIMIT 2") if held else [(DEFAULT_TOLERANCE, "{}")]
    if len(masks) != 1:
        raise DamagedRecordingError(f"expected one row of JSON in mask, got {len(masks)}")
    tolerance, text = masks[0]
    ids = object_from_json(text)
    found = query(f"SELECT name, red, green, blue FROM object LIMIT {_MOST_ROWS}")
    return [(str(name), *color, ids.get(name)) for name, *color in found], tolerance


def _table(rows: list[ObjectRow], tolerance: int) -> ObjectTable:
    for value, most in [(tolerance, 255), *((each, 255) for row in rows for each in row[1:4])] + [
        (row[4], MOST_OBJECTS) for row in rows if row[4] is not None
    ]:
        if type(value) is not int or not 0 <= value <= most:
            wanted = f"expected colours, ids and a tolerance of 0 to {most}"
            raise DamagedRecordingError(f"{wanted}, got {shown(value)}")
    if len(rows) > MOST_OBJECTS:
        raise DamagedRecordingError(f"expected at most {MOST_OBJECTS} objects, got more")
    ids = {name: each for name, *_, each in rows if each is not None}
    return ObjectTable({name: (r, g, b) for name, r, g, b, _ in rows}, tolerance, ids)
