"""Opens the file of a recording, to read it or to add to it, and deals with what a killed recorder left."""

import sqlite3
from pathlib import Path

from omniscv.errors import NotARecordingError
from omniscv.sources.recording import schema
from omniscv.sources.recording.logs import settle
from omniscv.sources.recording.replacing import kind_of, part_of, publish_new, remove_leftovers
from omniscv.sources.recording.rows import Head
from omniscv.sources.recording.upgrade import upgrade

# Errors of a file that needs the index of a log beside it, in a folder where none can be created:
_NO_INDEX = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY_DIRECTORY)


def open_to_write(place: Path, path: Path) -> sqlite3.Connection:
    """Return the database of a file to add captures to: created if there is none, upgraded if it is old."""
    if kind_of(place) == "" or place.stat().st_size == 0:
        with part_of(place) as part, schema.errors_of(path, write=True):
            schema.create(part, Head.new()).close()
            publish_new(part, place)
    remove_leftovers(place)
    upgrade(path)
    with schema.errors_of(path, write=True):
        database = schema.connect(place, "rw")
        try:
            schema.version_of(database, path)
            database.execute("PRAGMA journal_mode = TRUNCATE")
            # Flush each capture, so that it outlives a power cut; little time beside capturing it.
            database.execute("PRAGMA synchronous = FULL")
        except BaseException:
            database.close()
            raise
        return database


def open_to_read(place: Path, path: Path) -> sqlite3.Connection:
    """Return the database of a file, with a log of its own; only a half-written change is undone."""
    if kind_of(place) != "a file":
        found = kind_of(place) or "nothing there; record one first"
        raise NotARecordingError(f"{path}: expected a recording, got {found}")
    with schema.errors_of(path, write=False):
        settle(place)
        try:
            return schema.connect(place, "ro")
        except sqlite3.OperationalError as refused:
            if refused.sqlite_errorcode in _NO_INDEX and not Path(f"{place}-wal").exists():
                return schema.connect(place, "ro&immutable=1")  # no log, and nobody can write one there
            raise
