"""Recordings of version 1 become recordings of version 2: as a whole, or not at all."""

import contextlib
import sqlite3
from pathlib import Path
from typing import Any

from omniscv.sources.recording import object_tables, schema
from omniscv.sources.recording.logs import settle
from omniscv.sources.recording.replacing import part_of, place_of, publish
from omniscv.sources.recording.rows import (
    Head,
    Row,
    insert,
    scene_to_json,
    the_scene,
    write_head,
)

COLUMNS_1 = "rowid, key, mode, asked, captured, encoding, provenance, checksum, NULL, payload, ''"
"""The columns of a :class:`Row` in version 1."""


def upgrade(path: Path | str) -> bool:
    """Upgrade a recording of version 1; return False if it is of version 2 already.

    Every payload is copied as it is, and a damaged one stays known as damaged.

    Raises:
        RecordingError: the file is no recording, another program has it open, or it cannot be written.
    """
    place = place_of(path)
    with schema.errors_of(Path(path), write=True):
        settle(place)
        while (done := _upgraded(place)) is None:
            pass
    return done


def _upgraded(place: Path) -> bool | None:
    """Whether the file was upgraded now; None if another process has replaced it meanwhile."""
    inode = place.stat().st_ino
    with contextlib.closing(schema.connect(place, "rw")) as old:
        if schema.version_of(old, place) != 1:
            return False
        old.execute("PRAGMA journal_mode = DELETE")  # merges the log; refused while others have it open
        old.execute("BEGIN EXCLUSIVE")
        if place.stat().st_ino != inode:
            return None
        with part_of(place) as part:
            head = Head.new()
            with contextlib.closing(schema.create(part, head)) as new:
                _copy(old, new, head)
                publish(part, place)
    return True


def _copy(old: sqlite3.Connection, new: sqlite3.Connection, head: Head) -> None:
    def query(statement: str, *values: Any) -> list[Any]:
        return old.execute(statement, values).fetchall()

    table, scenes = object_tables.read(query, None), set()
    new.execute("BEGIN IMMEDIATE")
    for number, found in enumerate(old.execute(f"SELECT {COLUMNS_1} FROM capture ORDER BY rowid"), start=1):
        row = Row._make(found)
        row.check(head.id)
        row = row._replace(number=number)
        row = row._replace(checksum=row.own_checksum(head.id))
        insert(new, row)
        head = head.with_rows([row], ())
        scenes.add(row.scene)
    objects = object_tables.rows_of(table)
    new.executemany(object_tables.INSERT, objects)
    scene, crc = scene_to_json(the_scene(scenes)), object_tables.checksum_of(objects)
    write_head(new, head._replace(tolerance=table.tolerance, object_checksum=crc, scene=scene))
    new.commit()
