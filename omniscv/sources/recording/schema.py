"""The tables of a recording, and connections that refuse every other file.

docs/recording-format.md describes the tables for other programs. A file may come from anybody: the header and
the schema are checked before a table is read, and SQLite's limits bound what a connection reads.
"""

import contextlib
import sqlite3
import struct
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from omniscv.arguments import shown
from omniscv.errors import (
    DamagedRecordingError,
    NewerRecordingError,
    NotARecordingError,
    RecordingError,
    RecordingNotWritableError,
)
from omniscv.sources.recording.rows import Head, checked_json

SCHEMA_VERSION = 4
LARGEST_BYTES = 1 << 29
"""The largest row that is written."""

_APPLICATION_ID = 0x6F6D6E69  # "omni"
_TABLES = """
CREATE TABLE recording (
    id TEXT NOT NULL, token TEXT NOT NULL, parent TEXT NOT NULL, scene TEXT NOT NULL,
    tolerance INTEGER NOT NULL, captures INTEGER NOT NULL, capture_sum INTEGER NOT NULL,
    object_checksum INTEGER NOT NULL, checksum INTEGER NOT NULL
) STRICT;
CREATE TABLE capture (
    number INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE, mode TEXT NOT NULL, asked TEXT NOT NULL,
    captured TEXT NOT NULL, encoding TEXT NOT NULL, provenance TEXT NOT NULL,
    payload_checksum INTEGER NOT NULL, checksum INTEGER NOT NULL, payload BLOB NOT NULL
, state TEXT NOT NULL DEFAULT '') STRICT;
CREATE TABLE object (
    name TEXT PRIMARY KEY NOT NULL, red INTEGER NOT NULL, green INTEGER NOT NULL, blue INTEGER NOT NULL,
    instance INTEGER
) STRICT;
CREATE TABLE geometry (content TEXT NOT NULL, checksum INTEGER NOT NULL) STRICT;
CREATE TABLE state (name TEXT PRIMARY KEY NOT NULL, content TEXT NOT NULL, checksum INTEGER NOT NULL) STRICT;
"""
_HEADER = struct.Struct(">16s2xBB40xI4xI")
"""Of an SQLite file: magic, write and read version (2: write-ahead log), user version, application id."""
_MAGIC = b"SQLite format 3\0"
_LIMITS = {
    sqlite3.SQLITE_LIMIT_SQL_LENGTH: 10_000,
    sqlite3.SQLITE_LIMIT_COLUMN: 64,
    sqlite3.SQLITE_LIMIT_EXPR_DEPTH: 20,
    sqlite3.SQLITE_LIMIT_COMPOUND_SELECT: 2,
    sqlite3.SQLITE_LIMIT_ATTACHED: 0,
    sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH: 1,
}
_SHORTEST_BYTES = 100  # of a row of `capture`: two views and a key
_GROWTH_BYTES = 1 << 26
_BUSY_TIMEOUT_S = 30.0  # for other processes to finish a change


def create(path: Path) -> None:
    """Write a new, empty recording."""
    head = Head.new()
    with contextlib.closing(connect(path, "rwc")) as database:
        database.execute("PRAGMA auto_vacuum = NONE")
        database.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
        database.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        database.executescript(_TABLES)
        database.execute(f"INSERT INTO recording VALUES ({', '.join('?' * len(head))})", head)
        database.execute(
            "INSERT INTO geometry VALUES (?, ?)", checked_json({"boxes": {}, "room": None}, head.id)
        )


def connect(path: Path, mode: str, *, torn: bool = False) -> sqlite3.Connection:
    """Return a connection that has read the header, and with it a journal.

    Args:
        path: the file.
        mode: as in SQLite's addresses.
        torn: accept a file that is shorter than its header says, because a change was interrupted.
    """
    uri = f"{path.absolute().as_uri()}?mode={mode}"
    database = sqlite3.connect(
        uri, timeout=_BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False, uri=True
    )
    database.text_factory = bytes.decode
    try:
        # A row is at most as long as the file, unless the file grows while it is read.
        longest = LARGEST_BYTES if mode.startswith("rw") else max(_GROWTH_BYTES, path.stat().st_size)
        for limit, value in {**_LIMITS, sqlite3.SQLITE_LIMIT_LENGTH: longest}.items():
            database.setlimit(limit, value)
        database.execute("PRAGMA trusted_schema = OFF")
        database.execute("PRAGMA cell_size_check = ON")
        if torn:
            database.execute("PRAGMA writable_schema = ON")
        database.execute("PRAGMA schema_version").fetchone()
    except BaseException:
        database.close()
        raise
    return database


def check_header(path: Path) -> None:
    """Check the first bytes of a file; no journal is read, and nothing is changed.

    Raises:
        NotARecordingError: another file, or a recording of an earlier version.
        NewerRecordingError: written by a later version.
    """
    with path.open("rb") as file:
        header = file.read(_HEADER.size)
    if len(header) < _HEADER.size or not header.startswith(_MAGIC):
        got = "a file that is not a database" if header else "an empty file"
        raise NotARecordingError(f"expected a recording, got {got}")
    _, *log_versions, version, application = _HEADER.unpack(header)
    if application != _APPLICATION_ID:
        raise NotARecordingError("expected a recording, got another SQLite database")
    if version != SCHEMA_VERSION:
        newer = version > SCHEMA_VERSION
        advice = "update omniscv" if newer else "record it again"
        reason = f"expected schema version {SCHEMA_VERSION}, got version {version}; {advice}"
        raise (NewerRecordingError if newer else NotARecordingError)(reason)
    if log_versions != [1, 1]:
        got = "one that another program gave a write-ahead log"
        reason = f"expected a recording with a rollback journal, got {got}"
        raise NotARecordingError(f"{reason}; run 'PRAGMA journal_mode = DELETE' there")


def check_schema(database: sqlite3.Connection) -> None:
    """Raise NotARecordingError for other tables, triggers or views than those of a recording."""
    expected = _schema()
    query = f"SELECT type, name, tbl_name, sql FROM sqlite_master LIMIT {len(expected) + 1}"
    rows = set(database.execute(query))
    if rows != expected:
        strange = sorted(f"the {row[0]} {shown(row[1])}" for row in rows - expected)
        got = strange[0] if strange else "some of them only"
        raise NotARecordingError(f"expected the tables of a recording only, got {got}")


def most_captures(path: Path) -> int:
    """Return how many captures a file can hold at most; damaged pages can claim more."""
    return path.stat().st_size // _SHORTEST_BYTES


@contextlib.contextmanager
def errors_of(path: Path, *, write: bool = False, advice: str = "") -> Iterator[None]:
    """Raise errors of SQLite and of the file system as errors of a recording, and name the file in them.

    Args:
        path: of the recording.
        write: whether it is written.
        advice: what to do about damage.

    Raises:
        RecordingNotWritableError, NotARecordingError: the file cannot be written, or read.
        DamagedRecordingError: a value is not of its column's type.
    """
    try:
        yield
    except RecordingError as cause:
        if cause.path is not None:
            raise
        raise cause.at(path, advice) from cause
    except (OSError, sqlite3.Error, UnicodeError) as cause:
        got = cause.strerror if isinstance(cause, OSError) and cause.strerror else shown(str(cause))
        if write and isinstance(cause, OSError | sqlite3.OperationalError):
            reason = f"expected a file that can be written, got: {got}; what it held is intact"
            raise RecordingNotWritableError(reason, path) from cause
        if isinstance(cause, OSError | sqlite3.OperationalError):
            reason = f"expected a recording that can be read, got: {got}; if its recorder was killed, open it"
            advice = "once in a folder that can be written, together with the files beside it"
            raise NotARecordingError(f"{reason} {advice}", path) from cause
        if isinstance(cause, sqlite3.DataError | sqlite3.IntegrityError | UnicodeError):
            raise DamagedRecordingError(f"expected rows as recorded, got: {got}", path) from cause
        raise NotARecordingError(f"expected a recording, got another file, or damage: {got}", path) from cause


@cache
def _schema() -> frozenset[tuple[str, ...]]:
    with contextlib.closing(sqlite3.connect(":memory:")) as model:
        model.executescript(_TABLES)
        return frozenset(model.execute("SELECT type, name, tbl_name, sql FROM sqlite_master"))
