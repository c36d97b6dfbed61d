"""The tables of a recording, version 4 to 1, and connections that refuse all else.

docs/recording-format.md describes versions 4 to 2 for other programs. A file is data that anybody may have
written: a connection is bounded in what it reads, and the schema is checked before a table is read.
"""

import contextlib
import sqlite3
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from omniscv import errors
from omniscv.arguments import shown
from omniscv.errors import DamagedRecordingError, NotARecordingError

SCHEMA_VERSION = 4
WITHOUT_GEOMETRY, WITHOUT_STATES = 2, 3
"""The versions of recordings that know no shapes, or one state of the world: they have no table for more."""
LARGEST_BYTES = 1 << 29
"""Of a row that is written."""
MOST_OBJECTS = 0xFFFF

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
) STRICT;
CREATE TABLE object (
    name TEXT PRIMARY KEY NOT NULL, red INTEGER NOT NULL, green INTEGER NOT NULL, blue INTEGER NOT NULL,
    instance INTEGER
) STRICT;
"""
_GEOMETRY = """
CREATE TABLE geometry (content TEXT NOT NULL, checksum INTEGER NOT NULL) STRICT;
"""
"""What version 3 has more."""
_STATES = """
CREATE TABLE state (name TEXT PRIMARY KEY NOT NULL, content TEXT NOT NULL, checksum INTEGER NOT NULL) STRICT;
ALTER TABLE capture ADD COLUMN state TEXT NOT NULL DEFAULT '';
"""
"""What version 4 has more."""
# Version 1, as omniscv wrote it before: its tables, the last of which may be missing, and their columns.
_TABLES_1 = {
    "capture": ("key", "mode", "asked", "captured", "encoding", "checksum", "provenance", "payload"),
    "object": ("name", "red", "green", "blue"),
    "mask": ("tolerance", "ids"),
}
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
_BUSY_TIMEOUT_S = 30.0  # for others to finish a change


def connect(path: Path, mode: str, *, torn: bool = False) -> sqlite3.Connection:
    """Return a connection that has read the header, and with it a log.

    Args:
        path: the file.
        mode: as in SQLite's addresses.
        torn: accept a file that a change has not yet made as long as its header says.
    """
    uri = f"{path.absolute().as_uri()}?mode={mode}"
    database = sqlite3.connect(uri, _BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False, uri=True)
    database.text_factory = bytes.decode
    try:
        # A row is no longer than the file; one that is read while it grows may be.
        longest = LARGEST_BYTES if mode.startswith("rw") else max(_GROWTH_BYTES, _extent(path))
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


def create(path: Path, head: Sequence[str | int]) -> sqlite3.Connection:
    """Return a connection to a new file with the tables of version 2, and its row of ``recording``."""
    database = connect(path, "rwc")
    try:
        database.execute("PRAGMA auto_vacuum = NONE")
        for name, value in (("application_id", _APPLICATION_ID), ("user_version", WITHOUT_GEOMETRY)):
            database.execute(f"PRAGMA {name} = {value}")
        database.executescript(_TABLES)
        database.execute(f"INSERT INTO recording VALUES ({', '.join('?' * len(head))})", head)
    except BaseException:
        database.close()
        raise
    return database


def add_geometry(database: sqlite3.Connection) -> None:
    """Make a recording of version 2 one of version 3, within a transaction."""
    database.execute(_GEOMETRY)
    database.execute(f"PRAGMA user_version = {WITHOUT_STATES}")


def add_states(database: sqlite3.Connection) -> None:
    """Make a recording of version 3 one of version 4, within a transaction."""
    for statement in _STATES.split(";")[:-1]:
        database.execute(statement)
    database.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")


def present_version(database: sqlite3.Connection) -> int:
    """Return the version of a schema that was checked: it grows while a recording is open."""
    (version,) = database.execute("PRAGMA user_version").fetchone()
    return int(version)


def version_of(database: sqlite3.Connection, path: Path) -> int:
    """Return the schema's version, and check the schema.

    Raises:
        NotARecordingError: another database, or tables, triggers or views that recordings do not have.
        NewerRecordingError: written by a later version.
    """
    (found,) = database.execute("PRAGMA application_id").fetchone()
    (version,) = database.execute("PRAGMA user_version").fetchone()
    if found != _APPLICATION_ID:
        raise NotARecordingError(f"{path}: expected a recording, got another SQLite database")
    if version > SCHEMA_VERSION:
        wanted = f"expected schema version {SCHEMA_VERSION} or earlier, got version {version}"
        raise errors.NewerRecordingError(f"{path}: {wanted}; update omniscv to a newer one")
    if version < 1:
        raise NotARecordingError(f"{path}: expected a recording, got schema version {version}")
    fault = _fault_of_1(database) if version == 1 else _fault(database, version)
    if fault:
        raise NotARecordingError(f"{path}: expected the tables of a recording only, got {fault}")
    return int(version)


def most_captures(path: Path) -> int:
    """Return how many captures a file can hold at most; more come of damaged pages only."""
    return _extent(path) // _SHORTEST_BYTES


def _extent(path: Path) -> int:
    """Size of a file and of the write-ahead log that it may have, bytes."""
    wal = Path(f"{path}-wal")
    return path.stat().st_size + (wal.stat().st_size if wal.exists() else 0)


def structural_faults(database: sqlite3.Connection) -> list[str]:
    """Return what SQLite's integrity check reports; nothing for a sound file."""
    lines = (line for (text,) in database.execute("PRAGMA integrity_check") for line in text.splitlines())
    return [line for line in lines if line != "ok" and not line.startswith("***")]  # no headings


@contextlib.contextmanager
def errors_of(path: Path, *, write: bool) -> Iterator[None]:
    """Raise errors of SQLite and of the file system as NotARecordingError or RecordingNotWritableError."""
    try:
        yield
    except (OSError, sqlite3.OperationalError) as cause:
        if write:
            what = f"expected a file that can be written, got: {_reason(cause)}; what it held is intact"
            raise errors.RecordingNotWritableError(f"{path}: {what}") from cause
        raise NotARecordingError(
            f"{path}: expected a recording that can be read, got: {_reason(cause)}; if its recorder was "
            "killed, open it once in a folder that can be written, together with the files beside it"
        ) from cause
    except (sqlite3.DataError, sqlite3.IntegrityError, UnicodeError) as cause:
        raise DamagedRecordingError(
            f"{path}: expected rows as they were recorded, got: {_reason(cause)}"
        ) from cause
    except sqlite3.DatabaseError as cause:
        damage = f"another file, or damage: {_reason(cause)}"
        raise NotARecordingError(f"{path}: expected a recording, got {damage}") from cause


def _reason(cause: Exception) -> str:
    return cause.strerror or str(cause) if isinstance(cause, OSError) else shown(str(cause))


def _fault(database: sqlite3.Connection, version: int) -> str:
    """What is too much or missing in a schema of version 2 to 4; empty if nothing is."""
    wanted = _schema(version)
    bound = len(wanted) + 1
    rows = database.execute(f"SELECT type, name, tbl_name, sql FROM sqlite_master LIMIT {bound}").fetchall()
    return "" if set(rows) == wanted else _named(set(rows) - wanted)


@cache
def _schema(version: int) -> frozenset[tuple[str, ...]]:
    with contextlib.closing(sqlite3.connect(":memory:")) as model:
        model.executescript("".join((_TABLES, _GEOMETRY, _STATES)[: version - 1]))
        return frozenset(model.execute("SELECT type, name, tbl_name, sql FROM sqlite_master"))


def _fault_of_1(database: sqlite3.Connection) -> str:
    query = "SELECT type, name, tbl_name, rootpage FROM sqlite_master LIMIT 9"
    rows = database.execute(query).fetchall()
    tables = {name for kind, name, _, root in rows if kind == "table" and root}
    own = {(kind, name) for kind, name, _, root in rows if kind == "table" and root and name in _TABLES_1}
    indexes = {(kind, f"sqlite_autoindex_{name}_1") for kind, name in own for kind in ("index",)}
    strange = {row for row in rows if row[:2] not in own | indexes}
    if strange or not {"capture", "object"} <= tables:
        return _named(strange)
    for table in tables:
        columns = database.execute(f"PRAGMA table_xinfo({table})").fetchall()
        if tuple(column[1] for column in columns) != _TABLES_1[table] or any(each[6] for each in columns):
            return f"other columns in {table}"
    return ""


def _named(strange: set[tuple[str, ...]]) -> str:
    found = sorted(f"the {row[0]} {shown(row[1])}" for row in strange)
    return found[0] if found else "some of them only"
