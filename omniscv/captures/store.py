"""The recorded file: one SQLite database, a capture a row.

A capture appears whole or not at all, whatever kills the process: each is its own transaction in a
write-ahead log, which is folded into the one file when the recording ends.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from omniscv.captures.database import open_to_read, open_to_write
from omniscv.captures.decode import decode
from omniscv.captures.source import ObjectTable
from omniscv.captures.view import Capture, Request, View
from omniscv.errors import ArgumentError, DamagedRecord, NewerRecord, NotARecord, RecordNotWritable
from omniscv.geometry import Pose

SCHEMA_VERSION = 1
_APPLICATION_ID = 0x6F6D6E69  # "omni"

_SCHEMA = f"""
PRAGMA application_id = {_APPLICATION_ID};
PRAGMA user_version = {SCHEMA_VERSION};
CREATE TABLE capture (
    key TEXT PRIMARY KEY,          -- mode and View.key() of what was asked
    mode TEXT NOT NULL,
    asked TEXT NOT NULL,           -- the view that was asked for, JSON
    captured TEXT NOT NULL,        -- the view that came, JSON
    encoding TEXT NOT NULL,        -- see omniscv.captures.decode
    checksum INTEGER NOT NULL,     -- CRC-32 of the payload
    provenance TEXT NOT NULL,      -- JSON
    payload BLOB NOT NULL          -- the bytes as they came
);
CREATE TABLE object (name TEXT PRIMARY KEY, red INTEGER, green INTEGER, blue INTEGER);
"""


class Row(NamedTuple):
    """A capture as it is stored: views and provenance as JSON, see the schema."""

    key: str
    mode: str
    asked: str
    captured: str
    encoding: str
    checksum: int
    provenance: str
    payload: bytes


class Store:
    """An open recorded file.

    Args:
        path: the file.
        write: whether captures will be added; the file is then made if it is not there.

    Raises:
        NotARecord: the file is not there (to read), is something else, or is damaged.
        NewerRecord: it was written by a later version.
        RecordNotWritable: it cannot be written.
    """

    def __init__(self, path: Path | str, *, write: bool = False) -> None:
        self.path = Path(path)
        self._write = write
        self._database = open_to_write(self.path, _SCHEMA) if write else open_to_read(self.path)
        try:
            self._check_version()
            if write:
                with self._writing():
                    self._database.execute("PRAGMA journal_mode = WAL")
                    # A capture outlives even a power cut; it costs a flush each, little beside a capture.
                    self._database.execute("PRAGMA synchronous = FULL")
        except BaseException:
            self._database.close()
            raise

    def _check_version(self) -> None:
        [(found,)] = self._query("PRAGMA application_id")
        [(version,)] = self._query("PRAGMA user_version")
        if found != _APPLICATION_ID:
            raise NotARecord(f"{self.path}: expected a recorded file, got another SQLite database")
        if version > SCHEMA_VERSION:
            raise NewerRecord(
                f"{self.path}: expected schema version {SCHEMA_VERSION} or earlier, got {version}; "
                f"it takes an omniscv that knows version {version}"
            )

    def close(self) -> None:
        """Folds the log into the file and closes it; closing twice is fine."""
        if self._write:
            self._write = False
            # Refused while another process has it open: that one folds the log when it ends.
            with contextlib.suppress(sqlite3.OperationalError):
                self._database.execute("PRAGMA journal_mode = DELETE")
        self._database.close()

    def keys(self) -> set[str]:
        """The keys of all captures."""
        return {row[0] for row in self._query("SELECT key FROM capture")}

    def views(self, mode: str | None = None) -> Iterator[tuple[View, str]]:
        """Every recorded (asked view, mode)."""
        for asked, found in self._query("SELECT asked, mode FROM capture ORDER BY rowid"):
            if mode in (None, found):
                yield view_from_json(asked), found

    def entries(self) -> Iterator[tuple[View, str, dict[str, Any]]]:
        """Every (view that came, mode, provenance), without pixels."""
        for captured, mode, provenance in self._query("SELECT captured, mode, provenance FROM capture"):
            yield view_from_json(captured), mode, object_from_json(provenance)

    def rows(self) -> Iterator[Row]:
        """Every capture as it is stored, unchecked, in the order of recording."""
        for row in self._query(f"SELECT {', '.join(Row._fields)} FROM capture ORDER BY rowid"):
            yield Row(*row)

    def structural_faults(self) -> list[str]:
        """What SQLite finds wrong with the file's own structure; nothing if it is sound."""
        return [row[0] for row in self._query("PRAGMA integrity_check") if row[0] != "ok"]

    def get(self, request: Request) -> Capture | None:
        """The capture of a request; None if there is none.

        Raises:
            DamagedRecord: its bytes are not those that were recorded.
        """
        row = self.row(request)
        return None if row is None else self.capture_of(request, row)

    def row(self, request: Request) -> Row | None:
        """What is stored for a request, unchecked; None if nothing is."""
        found = self._query(f"SELECT {', '.join(Row._fields)} FROM capture WHERE key = ?", key_of(request))
        return next((Row(*row) for row in found), None)

    def capture_of(self, request: Request, row: Row) -> Capture:
        """A stored capture, checked and decoded. Needs no database: may run in any thread.

        Raises:
            DamagedRecord: its bytes are not those that were recorded.
        """
        if (found := checksum_of(row.payload)) != row.checksum:
            raise DamagedRecord(
                f"{self.path}: expected checksum {row.checksum:08x} for a {request.mode} capture, "
                f"got {found:08x}; run 'omniscv captures verify'"
            )
        view = view_from_json(row.captured)
        pixels = decode(row.payload, row.encoding, request.mode, view)
        return Capture(request, view, pixels, row.payload, row.encoding, object_from_json(row.provenance))

    def add(self, capture: Capture) -> None:
        """Writes a capture, whole.

        Raises:
            RecordNotWritable: the disk is full, or the file cannot be written.
        """
        with self._writing():
            self._database.execute(
                "INSERT OR REPLACE INTO capture VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    key_of(capture.request),
                    capture.mode,
                    view_to_json(capture.request.view),
                    view_to_json(capture.view),
                    capture.encoding,
                    zlib.crc32(capture.payload),
                    json.dumps(capture.provenance),
                    capture.payload,
                ),
            )

    def objects(self) -> ObjectTable:
        """The recorded objects and their mask colours."""
        rows = self._query("SELECT name, red, green, blue FROM object")
        return ObjectTable({name: (r, g, b) for name, r, g, b in rows})

    def set_objects(self, table: ObjectTable) -> None:
        """Records the objects and their mask colours."""
        with self._writing():
            self._database.executemany(
                "INSERT OR REPLACE INTO object VALUES (?, ?, ?, ?)",
                [(name, *color) for name, color in table.colors.items()],
            )

    def _query(self, statement: str, *values: Any) -> Iterator[Any]:
        try:
            yield from self._database.execute(statement, values)
        except sqlite3.DatabaseError as cause:
            raise NotARecord(f"{self.path}: expected a recorded file, got a damaged one: {cause}") from cause

    def _writing(self) -> _Writing:
        return _Writing(self.path)


class _Writing:
    """Turns SQLite's errors of writing into one of ours."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, sqlite3.OperationalError):
            raise RecordNotWritable(
                f"{self._path}: expected to write a capture, got: {error}; what was recorded before is intact"
            ) from error
        if isinstance(error, sqlite3.DatabaseError):
            raise NotARecord(
                f"{self._path}: expected a recorded file, got something else: {error}"
            ) from error


def key_of(request: Request) -> str:
    """What identifies a request in a file."""
    return json.dumps([request.mode, *request.view.key()], separators=(",", ":"))


def view_to_json(view: View) -> str:
    """A view as JSON, exact."""
    return json.dumps(
        {**view.pose.to_dict(), "fov_deg": view.fov_deg, "width": view.width, "height": view.height}
    )


def view_from_json(text: Any) -> View:
    """The inverse of :func:`view_to_json`.

    Raises:
        DamagedRecord: the text is something else.
    """
    data = object_from_json(text)
    try:
        size = data["width"], data["height"]
        if not all(type(edge) is int for edge in size):
            raise ArgumentError(f"size: expected whole numbers, got {size}")
        return View(Pose.from_dict(data), data["fov_deg"], *size)
    except (KeyError, TypeError, ValueError) as cause:
        raise DamagedRecord(f"expected a view in a recorded file, got {text[:200]!r}: {cause}") from cause


def object_from_json(text: Any) -> dict[str, Any]:
    """A JSON object that a recorded file holds; anything may be written in a file.

    Raises:
        DamagedRecord: the text is something else.
    """
    try:
        data = json.loads(text)
    except (TypeError, ValueError, RecursionError) as cause:
        raise DamagedRecord(f"expected JSON in a recorded file, got {str(text)[:200]!r}") from cause
    if not isinstance(data, dict):
        raise DamagedRecord(f"expected a JSON object in a recorded file, got {text[:200]!r}")
    return data


def checksum_of(payload: Any) -> int:
    """The CRC-32 of a stored payload.

    Raises:
        DamagedRecord: it is no bytes.
    """
    if not isinstance(payload, bytes):
        raise DamagedRecord(f"expected the bytes of a picture in a recorded file, got {str(payload)[:200]!r}")
    return zlib.crc32(payload)
