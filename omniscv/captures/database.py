"""Opening the SQLite file of a record, whatever killed the process that wrote it.

While a recording is open its newest captures are in a write-ahead log beside the file; killed there, the
log stays. Whoever opens the file next reads the log with it.
"""

from __future__ import annotations

import os
import secrets
import sqlite3
from pathlib import Path

from omniscv.errors import NotARecord, RecordNotWritable

_WAIT_S = 30.0
"""How long one process waits for another that is folding its log into the file."""

_NO_INDEX = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY_DIRECTORY)
"""The file expects a log's index beside it, in a folder where none can be made."""


def open_to_write(path: Path, schema: str) -> sqlite3.Connection:
    """The database, made with a schema where there is none.

    Raises:
        RecordNotWritable: the folder or the file cannot be written.
        NotARecord: the file is no SQLite database.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.stat().st_size == 0:
            _create(path, schema)
        return _connect(path, "rw")
    except (OSError, sqlite3.OperationalError) as cause:
        raise RecordNotWritable(f"{path}: expected a file that can be written, got: {cause}") from cause
    except sqlite3.DatabaseError as cause:
        raise _something_else(path, cause) from cause


def open_to_read(path: Path) -> sqlite3.Connection:
    """The database, with what a killed writer left beside it. The file itself is never changed, except to
    undo a half-written change of its header.

    Raises:
        NotARecord: the file is not there, is no SQLite database, or what was left beside it cannot be read.
    """
    if not path.is_file():
        raise NotARecord(f"{path}: expected a recorded file, but there is none; record one first")
    try:
        try:
            return _connect(path, "ro")
        except sqlite3.OperationalError as refused:
            if refused.sqlite_errorcode == sqlite3.SQLITE_READONLY_ROLLBACK:
                _connect(path, "rw").close()  # undoes the change
                return _connect(path, "ro")
            if refused.sqlite_errorcode in _NO_INDEX and not _log_of(path).exists():
                return _connect(path, "ro&immutable=1")  # nothing beside it, and nobody can write there
            raise
    except sqlite3.OperationalError as cause:
        raise NotARecord(
            f"{path}: expected a recorded file that can be read, got: {cause}; if its recording was "
            "interrupted, open it once in a folder that can be written, together with the files beside it"
        ) from cause
    except sqlite3.DatabaseError as cause:
        raise _something_else(path, cause) from cause


def _create(path: Path, schema: str) -> None:
    """The file appears whole, with its schema, or not at all."""
    fresh = path.with_name(f".{path.name}-{secrets.token_hex(8)}")
    try:
        database = sqlite3.connect(fresh)
        database.executescript(schema)
        database.close()
        try:
            os.link(fresh, path)  # refuses to replace what another recorder has just made
        except FileExistsError:
            if path.stat().st_size == 0:
                fresh.replace(path)
        except OSError:  # a file system without hard links
            fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    """A connection that has read the file's header, and with it the log."""
    database = sqlite3.connect(
        f"{path.absolute().as_uri()}?mode={mode}",
        timeout=_WAIT_S,
        uri=True,
        isolation_level=None,
        check_same_thread=False,
    )
    try:
        database.execute("PRAGMA schema_version").fetchone()
    except BaseException:
        database.close()
        raise
    return database


def _log_of(path: Path) -> Path:
    return path.with_name(path.name + "-wal")


def _something_else(path: Path, cause: sqlite3.DatabaseError) -> NotARecord:
    return NotARecord(f"{path}: expected a recorded file, got something else: {cause}")
