"""The file of a recording: one SQLite database, one row per capture.

Each capture is a transaction in a write-ahead log beside the file, which is merged into it when it is closed:
whatever kills the process, a capture is in the file whole or not at all. After a kill the log stays; whoever
opens the file next reads the log with it.
"""

import contextlib
import json
import os
import secrets
import sqlite3
import threading
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from omniscv import errors, modalities
from omniscv.errors import ArgumentError, BadReplyError, DamagedRecordingError, NotARecordingError
from omniscv.geometry import Pose
from omniscv.sources.base import Capture, ObjectTable, Request, View, closed_error
from omniscv.sources.codecs import decode, payload_of

SCHEMA_VERSION = 1
DEFAULT_TOLERANCE = 3  # of the object table in recordings that hold none: that of UnrealCV servers

_APPLICATION_ID = 0x6F6D6E69  # "omni"
_SCHEMA = f"""
PRAGMA application_id = {_APPLICATION_ID};
PRAGMA user_version = {SCHEMA_VERSION};
CREATE TABLE capture (
    key TEXT PRIMARY KEY,          -- mode and View.key() of the request
    mode TEXT NOT NULL,
    asked TEXT NOT NULL,           -- the requested view, JSON
    captured TEXT NOT NULL,        -- the captured view, JSON
    encoding TEXT NOT NULL,        -- see omniscv.sources.codecs
    checksum INTEGER NOT NULL,     -- CRC-32 of the payload
    provenance TEXT NOT NULL,      -- JSON
    payload BLOB NOT NULL          -- the bytes as received
);
CREATE TABLE object (name TEXT PRIMARY KEY, red INTEGER, green INTEGER, blue INTEGER);
"""
# One row, where the object table has instance ids (JSON, name to id) or another tolerance:
_MASK_TABLE = "CREATE TABLE IF NOT EXISTS mask (tolerance INTEGER NOT NULL, ids TEXT NOT NULL)"
# Errors of a file that needs the index of a log beside it, in a folder where none can be created:
_NO_INDEX = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY_DIRECTORY)
# Connections of the parent process, which a forked child must neither use nor close:
_inherited: list[sqlite3.Connection] = []


class Row(NamedTuple):
    """A capture as it is stored, see the schema; anything may be written in a file."""

    key: str
    mode: str
    asked: str
    captured: str
    encoding: str
    checksum: int
    provenance: str
    payload: bytes

    @property
    def mode_name(self) -> str:
        """The name of the modality, which earlier versions may have stored by an alias."""
        with contextlib.suppress(ArgumentError):
            return modalities.get(self.mode).name
        return str(self.mode)

    def capture(self) -> Capture:
        """The capture, checked and decoded; DamagedRecordingError if a value is not what was recorded."""
        checksum = zlib.crc32(self.payload) if isinstance(self.payload, bytes) else "no bytes"
        try:
            if checksum != self.checksum:
                raise ArgumentError(f"expected checksum {self.checksum!r}, got {checksum}")
            request = Request(view_from_json(self.asked), self.mode_name)
            view, provenance = view_from_json(self.captured), object_from_json(self.provenance)
            pixels = decode(self.payload, self.encoding, request.mode, view)
        except (ArgumentError, BadReplyError, DamagedRecordingError) as cause:
            raise DamagedRecordingError(f"capture {self.key}: {cause}") from cause
        return Capture(request, view, pixels, provenance, self.payload, self.encoding)


class Store:
    """An open recording; safe to use from several threads, and in forked children.

    Args:
        path: the file.
        write: whether captures will be added; the file is then created if there is none.

    Raises:
        NotARecordingError: there is no file to read, it is something else, or it is damaged.
        NewerRecordingError: written by a later version.
        RecordingNotWritableError: the file cannot be written.
    """

    def __init__(self, path: Path | str, *, write: bool = False) -> None:
        self.path = Path(path)
        self._write, self._closed = write, False
        self._connection = self._connect()

    def _connect(self) -> tuple[sqlite3.Connection, threading.Lock, int]:
        database = _open_to_write(self.path) if self._write else _open_to_read(self.path)
        try:
            with _errors_of(self.path, write=False):
                (found,) = database.execute("PRAGMA application_id").fetchone()
                (version,) = database.execute("PRAGMA user_version").fetchone()
            if found != _APPLICATION_ID:
                raise NotARecordingError(f"{self.path}: expected a recording, got another SQLite database")
            if version > SCHEMA_VERSION:
                wanted = f"expected schema version {SCHEMA_VERSION} or earlier, got version {version}"
                raise errors.NewerRecordingError(f"{self.path}: {wanted}; update omniscv to a newer one")
            if self._write:
                with _errors_of(self.path, write=True):
                    database.execute("PRAGMA journal_mode = WAL")
                    # Flush each capture, so that it outlives a power cut; little time beside capturing it.
                    database.execute("PRAGMA synchronous = FULL")
        except BaseException:
            database.close()
            raise
        return database, threading.Lock(), os.getpid()

    def close(self) -> None:
        """Merge the log into the file and close it."""
        database, lock, process = self._connection
        if self._closed or process != os.getpid():
            self._closed = True
            return
        with lock:
            self._closed = True
            if self._write:
                # Refused while another process has the file open; that one merges the log.
                with contextlib.suppress(sqlite3.OperationalError):
                    database.execute("PRAGMA journal_mode = DELETE")
            database.close()

    def rows(self, *, payload: bool = True) -> Iterator[Row]:
        """Every capture as stored, unchecked, in the order of recording; without its payload if so wanted."""
        columns = ", ".join(Row._fields if payload else (*Row._fields[:-1], "x''"))
        for (number,) in self._query("SELECT rowid FROM capture ORDER BY rowid"):
            yield from map(Row._make, self._query(f"SELECT {columns} FROM capture WHERE rowid = ?", number))

    def structural_faults(self) -> list[str]:
        """What SQLite's integrity check reports; nothing for a sound file."""
        return [row[0] for row in self._query("PRAGMA integrity_check") if row[0] != "ok"]

    def holds(self, request: Request) -> bool:
        """Whether there is a capture of a request."""
        return bool(self._find("1", request))

    def get(self, request: Request) -> Capture | None:
        """The capture of a request, None if there is none; DamagedRecordingError as :meth:`Row.capture`."""
        found = self._find(", ".join(Row._fields), request)
        try:
            return replace(Row._make(found[0]).capture(), request=request) if found else None
        except DamagedRecordingError as cause:
            raise DamagedRecordingError(f"{self.path}: {cause}; run 'omniscv captures verify'") from cause

    def add(self, capture: Capture) -> None:
        """Write a capture, in place of an earlier one of the same request.

        Raises:
            ArgumentError: provenance that is no JSON.
            BadReplyError: pixels that do not fit the modality or the view.
            RecordingNotWritableError: the disk is full, or the file cannot be written.
        """
        payload, encoding = payload_of(capture)
        try:
            provenance = json.dumps(dict(capture.provenance))
        except (TypeError, ValueError) as cause:
            got = f"{capture.provenance!r:.200}: {cause}"
            raise ArgumentError(f"provenance: expected plain JSON values, got {got}") from cause
        requested, captured = map(_view_to_json, (capture.request.view, capture.view))
        key, *aliases = _keys(capture.request)
        row = Row(key, capture.mode, requested, captured, encoding, zlib.crc32(payload), provenance, payload)
        with self._transaction() as database:
            database.executemany("DELETE FROM capture WHERE key = ?", [(each,) for each in aliases])
            database.execute("INSERT OR REPLACE INTO capture VALUES (?, ?, ?, ?, ?, ?, ?, ?)", row)

    def objects(self) -> ObjectTable:
        """The recorded objects and how masks show them; DamagedRecordingError if the file holds none."""
        mask = self._query("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'mask'")
        masks = self._query("SELECT tolerance, ids FROM mask") if mask else [(DEFAULT_TOLERANCE, "{}")]
        rows = self._query("SELECT name, red, green, blue FROM object")
        [(tolerance, text)] = masks or [(None, None)]
        ids = object_from_json(text)
        numbers = (tolerance, *ids.values(), *(n for row in rows for n in row[1:]))
        if not all(type(n) is int and n >= 0 for n in numbers):
            wanted = "expected colours, ids and a tolerance"
            raise DamagedRecordingError(f"{self.path}: {wanted}, got {numbers!r:.99}")
        return ObjectTable({str(name): (r, g, b) for name, r, g, b in rows}, tolerance, ids)

    def set_objects(self, table: ObjectTable) -> None:
        """Add objects to the table, or write them anew; RecordingNotWritableError if masks conflict."""
        before = self.objects()
        labelled = {row.name for row in modalities.layers() if row.derives}
        if any(row.mode_name in labelled for row in self.rows(payload=False)):
            _refuse_conflict(self.path, before, table)
        ids = {**before.ids, **table.ids}
        with self._transaction() as database:
            rows = [(name, *color) for name, color in table.colors.items()]
            database.executemany("INSERT OR REPLACE INTO object VALUES (?, ?, ?, ?)", rows)
            if ids or {table.tolerance, before.tolerance} != {DEFAULT_TOLERANCE}:
                database.execute(_MASK_TABLE)
                database.execute("DELETE FROM mask")
                database.execute("INSERT INTO mask VALUES (?, ?)", (table.tolerance, json.dumps(ids)))

    def _find(self, columns: str, request: Request) -> list[Any]:
        keys = _keys(request)
        marks = ", ".join("?" * len(keys))
        statement = f"SELECT {columns} FROM capture WHERE key IN ({marks}) ORDER BY key = ? DESC LIMIT 1"
        return self._query(statement, *keys, keys[0])

    def _query(self, statement: str, *values: Any) -> list[Any]:
        with _errors_of(self.path, write=False), self._using() as database:
            return database.execute(statement, values).fetchall()

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with _errors_of(self.path, write=True), self._using() as database, database:
            database.execute("BEGIN IMMEDIATE")
            yield database

    @contextlib.contextmanager
    def _using(self) -> Iterator[sqlite3.Connection]:
        """The connection, for one thread at a time; a new one in a forked child."""
        database, lock, process = self._connection
        if process != os.getpid() and not self._closed:
            _inherited.append(database)
            database, lock, process = self._connection = self._connect()
        with lock if not self._closed else contextlib.nullcontext():
            if self._closed:
                raise closed_error(str(self.path))
            yield database


def _refuse_conflict(path: Path, before: ObjectTable, after: ObjectTable) -> None:
    """Raise if recorded masks would get other names: a name has two colours, or a colour has two names."""
    kind = "ids" if after.ids else "colors"
    known: dict[str, Any] = getattr(before, kind)
    names = {value: name for name, value in known.items()}
    for name, value in getattr(after, kind).items():
        if known.get(name, value) != value:
            conflict = f"{name} is {value} and was {known[name]}"
        elif names.get(value, name) != name:
            conflict = f"{name} is {value}, which was {names[value]}"
        else:
            continue
        raise errors.RecordingNotWritableError(
            f"{path}: expected the mask {kind} of its object masks, but {conflict}; record into another file"
        )


def _keys(request: Request) -> list[str]:
    """The keys of a request in a file: the one to write, then those by aliases of its mode."""
    names = (request.mode, *modalities.get(request.mode).aliases)
    return [json.dumps([name, *request.view.key()], separators=(",", ":")) for name in names]


def _view_to_json(view: View) -> str:
    size = {"fov_deg": view.fov_deg, "width": view.width, "height": view.height}
    return json.dumps({**view.pose.to_dict(), **size})


def view_from_json(text: Any) -> View:
    """A view as it is stored, JSON; DamagedRecordingError for anything else."""
    data = object_from_json(text)
    try:
        size = data["width"], data["height"]
        if not all(type(edge) is int for edge in size):
            raise ArgumentError(f"size: expected whole numbers, got {size}")
        return View(Pose.from_dict(data), data["fov_deg"], *size)
    except (KeyError, TypeError, ValueError) as cause:
        raise DamagedRecordingError(f"expected a view in a recording, got {text[:200]!r}: {cause}") from cause


def object_from_json(text: Any) -> dict[str, Any]:
    """A JSON object; DamagedRecordingError for anything else."""
    try:
        data = json.loads(text)
    except (TypeError, ValueError, RecursionError) as cause:
        raise DamagedRecordingError(f"expected JSON in a recording, got {str(text)[:200]!r}") from cause
    if not isinstance(data, dict):
        raise DamagedRecordingError(f"expected a JSON object in a recording, got {text[:200]!r}")
    return data


@contextlib.contextmanager
def _errors_of(path: Path, *, write: bool) -> Iterator[None]:
    """Raise errors of SQLite and of the file system as NotARecordingError or RecordingNotWritableError."""
    try:
        yield
    except (OSError, sqlite3.OperationalError) as cause:
        if write:
            what = f"expected a file that can be written, got: {cause}; what it held is intact"
            raise errors.RecordingNotWritableError(f"{path}: {what}") from cause
        raise NotARecordingError(
            f"{path}: expected a recording that can be read, got: {cause}; if its recorder was killed, "
            "open it once in a folder that can be written, together with the files beside it"
        ) from cause
    except sqlite3.DatabaseError as cause:
        damage = f"another file, or damage: {cause}"
        raise NotARecordingError(f"{path}: expected a recording, got {damage}") from cause


def _open_to_write(path: Path) -> sqlite3.Connection:
    with _errors_of(path, write=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.stat().st_size == 0:
            _create(path)
        return _connect(path, "rw")


def _open_to_read(path: Path) -> sqlite3.Connection:
    """The database, with the log that a killed writer left; only a half-written change is rolled back."""
    if not path.is_file():
        found = "a folder" if path.is_dir() else "nothing there; record one first"
        raise NotARecordingError(f"{path}: expected a recording, got {found}")
    with _errors_of(path, write=False):
        try:
            return _connect(path, "ro")
        except sqlite3.OperationalError as refused:
            if refused.sqlite_errorcode == sqlite3.SQLITE_READONLY_ROLLBACK:
                _connect(path, "rw").close()  # rolls back
                return _connect(path, "ro")
            if refused.sqlite_errorcode in _NO_INDEX and not Path(f"{path}-wal").exists():
                return _connect(path, "ro&immutable=1")  # no log, and nobody can write one there
            raise


def _create(path: Path) -> None:
    """Create the file with its schema, as one step: a kill leaves no half of it."""
    fresh = path.with_name(f".{path.name}-{secrets.token_hex(8)}")
    try:
        database = sqlite3.connect(fresh)
        database.executescript(_SCHEMA)
        database.close()
        try:
            os.link(fresh, path)  # fails where another recorder has just created it
        except FileExistsError:
            if path.stat().st_size == 0:
                fresh.replace(path)
        except OSError:  # a file system without hard links
            fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    """A connection that has read the file's header, and with it the log."""
    uri, timeout = f"{path.absolute().as_uri()}?mode={mode}", 30.0  # for others to merge their logs
    database = sqlite3.connect(uri, timeout, isolation_level=None, check_same_thread=False, uri=True)
    try:
        database.execute("PRAGMA schema_version").fetchone()
    except BaseException:
        database.close()
        raise
    return database
