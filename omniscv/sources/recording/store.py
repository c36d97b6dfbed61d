"""The file of a recording: one SQLite database, one row per capture, described in docs/recording-format.md.

Each capture is a transaction: whatever kills the process, a capture is in the file whole or not at all. What
a killed process left half-written is undone from the journal beside the file when it is next opened.
"""

import contextlib
import os
import secrets
import sqlite3
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from omniscv.arguments import shown
from omniscv.errors import DamagedRecordingError, RecordingNotWritableError
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import Capture, ObjectTable, Request, SceneIdentity, closed_error
from omniscv.sources.recording import geometry_table, object_tables, schema, state_table
from omniscv.sources.recording.forking import hold_at_forks
from omniscv.sources.recording.opening import open_to_read, open_to_write
from omniscv.sources.recording.replacing import followed, place_of
from omniscv.sources.recording.rows import (
    Head,
    Row,
    insert,
    keys,
    scene_in_words,
    scene_to_json,
    the_scene,
    write_head,
)
from omniscv.sources.recording.state_table import HeldState
from omniscv.sources.recording.upgrade import COLUMNS_1

ADVICE = "; run 'omniscv captures verify'"  # at the end of errors about damage

_ALL, _STILL = (", ".join(columns) for columns in (Row._fields, (*Row._fields[:-1], "''")))
_COLUMNS = {1: COLUMNS_1, 2: _STILL, 3: _STILL, 4: _ALL}
# Connections of the parent process, which a forked child must neither use nor close:
_inherited: list[sqlite3.Connection] = []


class _UndoneError(Exception):
    """Ends a transaction that is to be undone."""


class Store:
    """An open recording; safe to use from several threads, and in forked children.

    Args:
        path: the file; links are followed.
        write: whether captures will be added; the file is then created if there is none, and a recording of
            version 1 becomes one of version 2.

    Raises:
        NotARecordingError: there is no file to read, it is something else, or it is damaged.
        NewerRecordingError: written by a later version.
        RecordingNotWritableError: the file cannot be written.
    """

    def __init__(self, path: Path | str, *, write: bool = False) -> None:
        self.path = Path(path)
        self._write, self._closed, self._version = write, False, 0
        self._head: Head | None = None  # of the transaction under way
        self._id: str | None = None
        self._place = place_of(path) if write else followed(path)
        self._connection = self._connect()
        hold_at_forks(self)

    def _connect(self) -> tuple[sqlite3.Connection, threading.RLock, int]:
        opened = open_to_write if self._write else open_to_read
        database = opened(self._place, self.path)
        try:
            with schema.errors_of(self.path, write=False):
                self._version = schema.version_of(database, self.path)
        except BaseException:
            database.close()
            raise
        return database, threading.RLock(), os.getpid()

    def close(self) -> None:
        """Close the file; no log is left beside it."""
        database, lock, process = self._connection
        if self._closed or process != os.getpid():
            self._closed = True
            return
        with lock:
            self._closed = True
            if self._write:
                # Removes the empty journal; refused while another process writes, which removes it then.
                with contextlib.suppress(sqlite3.OperationalError):
                    database.execute("PRAGMA journal_mode = DELETE")
            database.close()

    @property
    def lock(self) -> threading.RLock:
        """Held by the thread that uses the file."""
        return self._connection[1]

    @property
    def version(self) -> int:
        """The version of the schema; it grows when another recorder needs a later one."""
        if self._version == 1:
            return 1
        with schema.errors_of(self.path, write=False), self._using() as database:
            return schema.present_version(database)

    def head(self) -> Head | None:
        """What the recording is, checked, with the changes under way; None in version 1."""
        if self._version == 1:
            return None
        with self._using():
            if self._head is not None:
                return self._head
            rows = self._query(f"SELECT {', '.join(Head._fields)} FROM recording LIMIT 2")
        if len(rows) != 1:
            raise DamagedRecordingError(f"{self.path}: expected one row in recording, got {len(rows)}")
        head = Head._make(rows[0])
        with self._named():
            head.check()
        return head

    def listing(self) -> list[Row]:
        """Every capture but its payload, in the order of recording; DamagedRecordingError if one is damaged
        or lost."""
        with self._reading():
            head, rows = self.head(), self._rows()
        if head is None:
            return rows
        states = {row.state for row in rows} - {""}
        with self._named(ADVICE):
            for row in rows:
                row.check(head.id)
            if lost := states - self.states().keys():
                raise DamagedRecordingError(f"expected a row of state {shown(min(lost))}, got none")
            found = head._replace(captures=0, capture_sum=0).with_rows(rows, ())
            if (found.captures, found.capture_sum) != (head.captures, head.capture_sum):
                wanted = f"expected {head.captures} captures as recorded"
                raise DamagedRecordingError(f"{wanted}, got {found.captures}, or others")
        return rows

    def rows(self, *, payload: bool = True) -> Iterator[Row]:
        """Every capture as stored, unchecked, in the order of recording; without its payload if so wanted."""
        if not payload:
            yield from self._rows()
            return
        most = schema.most_captures(self._place)
        numbers = self._query(f"SELECT rowid FROM capture ORDER BY rowid LIMIT {most}")
        for number in dict.fromkeys(numbers):
            found = self._query(f"SELECT {_COLUMNS[self.version]} FROM capture WHERE rowid = ?", *number)
            yield from map(Row._make, found)

    def structural_faults(self) -> list[str]:
        """What SQLite's integrity check reports; nothing for a sound file."""
        with schema.errors_of(self.path, write=False), self._using() as database:
            return schema.structural_faults(database)

    def holds(self, request: Request) -> bool:
        """Whether there is a capture of a request."""
        return bool(self._find("1", request))

    def get(self, request: Request) -> Capture | None:
        """The capture of a request, None if there is none; DamagedRecordingError as :meth:`Row.capture`."""
        found = self._find(_COLUMNS[self.version], request)
        if not found:
            return None
        with self._named(ADVICE):
            row = Row._make(found[0])
            row.check(self._recording_id())
            return replace(row.capture(), request=request)

    def add(self, capture: Capture) -> None:
        """Write a capture, in place of an earlier one of the same request.

        Raises:
            ArgumentError: provenance that is no JSON.
            BadReplyError: pixels that do not fit the modality or the view.
            RecordingNotWritableError: the disk is full, the capture is too large, or the file cannot be
                written.
        """
        with self.transaction() as database:
            assert self._head is not None  # there is a transaction
            known = keys(capture.request)
            where = f"FROM capture WHERE key IN ({', '.join('?' * len(known))})"
            (number,) = database.execute("SELECT coalesce(max(number), 0) + 1 FROM capture").fetchone()
            row = Row.of(capture, number, self._head.id)
            if len(row.payload) + len(row.provenance) > schema.LARGEST_BYTES - 10_000:
                wanted = f"expected a capture of at most {schema.LARGEST_BYTES} bytes"
                raise RecordingNotWritableError(f"{self.path}: {wanted}, got {len(row.payload)}")
            if row.state and self.state(row.state) is None:
                state_table.write(database, self._head.id, row.state, HeldState())
            replaced = [crc for (crc,) in database.execute(f"SELECT checksum {where}", known)]
            database.execute(f"DELETE {where}", known)
            insert(database, row)
            self._head = self._head.with_rows([row], replaced)

    def objects(self) -> ObjectTable:
        """The recorded objects and how masks show them; DamagedRecordingError if the table is damaged."""
        with self._named(), self._reading():
            return object_tables.read(self._query, self.head())

    def set_objects(self, table: ObjectTable) -> None:
        """Add objects to the table; write it anew where no recorded mask needs it.

        Raises:
            RecordingNotWritableError: recorded masks would get other names, or the objects are of another
                scene: none of them is known.
        """
        with self.transaction() as database:
            assert self._head is not None  # there is a transaction
            before = self.objects()
            after = object_tables.union(before, table) if self.has_masks() else table
            if after is not table and (conflict := object_tables.conflict(before, table)):
                self._refuse(f"the mask colours of its object masks, but {conflict}")
            strange = before.colors and table.colors and not before.colors.keys() & table.colors.keys()
            if self._head.captures and strange:
                known, new = (shown(min(each.colors)) for each in (before, table))
                self._refuse(f"objects of its scene, such as {known}, got only others, such as {new}")
            rows = object_tables.rows_of(after)
            if after != before:
                database.execute("DELETE FROM object")
                database.executemany(object_tables.INSERT, rows)
            crc = object_tables.checksum_of(rows)
            self._head = self._head._replace(tolerance=after.tolerance, object_checksum=crc)

    def geometry(self) -> SceneGeometry:
        """What is known of shapes; DamagedRecordingError if that is not as it was written."""
        with self._named(), self._reading():
            return geometry_table.read(self._query, self._recording_id())

    def set_geometry(self, geometry: SceneGeometry) -> None:
        """Note what is known of shapes; makes a recording of version 2 one of version 3."""
        with self.transaction() as database:
            assert self._head is not None  # there is a transaction
            known = self.geometry()
            merged = SceneGeometry({**known.boxes, **geometry.boxes}, geometry.room or known.room)
            if merged.to_dict() != known.to_dict():
                geometry_table.write(database, self._head.id, merged)

    def states(self) -> dict[str, HeldState]:
        """What is known of the states that captures show, but the still one; DamagedRecordingError if that is
        not as it was written."""
        with self._named(), self._reading():
            return state_table.read(self._query, self._recording_id())

    def state(self, name: str) -> HeldState | None:
        """What is known of a state; None of the still one, and of one that no capture shows."""
        with self._named(), self._reading():
            return state_table.read(self._query, self._recording_id(), name).get(name)

    def set_state(self, name: str, state: HeldState) -> None:
        """Note what is known of a state; makes a recording of version 2 or 3 one of version 4."""
        with self.transaction() as database:
            assert self._head is not None  # there is a transaction
            state_table.write(database, self._head.id, name, state)

    def has_masks(self) -> bool:
        """Whether there is a capture that the object table gives names to."""
        modes = object_tables.labelled_modes()
        marks = ", ".join("?" * len(modes))
        return bool(self._query(f"SELECT 1 FROM capture WHERE mode IN ({marks}) LIMIT 1", *modes))

    @property
    def scene_identity(self) -> SceneIdentity:
        """The scene that the captures are of; in version 1, what their provenance names alike."""
        head = self.head()
        if head is not None:
            with self._named():
                return head.identity
        return the_scene(row.scene for row in self.rows(payload=False))

    def set_scene(self, identity: SceneIdentity) -> None:
        """Note what is known of the scene; RecordingNotWritableError if it is another one."""
        known = self.scene_identity
        if known.differs(identity):
            self._refuse(f"captures of the scene {scene_in_words(known)}, got {scene_in_words(identity)}")
        if known.merged(identity) != known:
            with self.transaction():
                assert self._head is not None  # there is a transaction
                self._head = self._head._replace(scene=scene_to_json(known.merged(identity)))

    @contextlib.contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Make all changes within together, or none of them; may be nested."""
        with schema.errors_of(self.path, write=True), self._using() as database:
            if self._head is not None:
                yield database
                return
            with database:  # commits, or rolls back
                database.execute("BEGIN IMMEDIATE")
                head = self.head()
                assert head is not None  # of version 2, as every file that is written
                self._head = head = head._replace(token=secrets.token_hex(16), parent=head.token)
                try:
                    write_head(database, head)  # first: see omniscv.sources.recording.logs
                    before = database.total_changes
                    yield database
                    if self._head != head or database.total_changes != before:
                        write_head(database, self._head)
                    else:
                        database.rollback()
                finally:
                    self._head = None

    @contextlib.contextmanager
    def all_or_none(self) -> Iterator[None]:
        """Make all changes within together, as :meth:`transaction`; errors raised within pass unchanged."""
        failed: BaseException | None = None
        with contextlib.suppress(_UndoneError), self.transaction():
            try:
                yield
            except BaseException as cause:
                failed = cause
                raise _UndoneError from cause
        if failed is not None:
            raise failed

    def _recording_id(self) -> str:
        if self._id is None:
            head = self.head()
            self._id = head.id if head else ""
        return self._id

    def _rows(self) -> list[Row]:
        columns = _COLUMNS[self.version].replace(", payload,", ", x'',")
        most = schema.most_captures(self._place)
        return [*map(Row._make, self._query(f"SELECT {columns} FROM capture ORDER BY rowid LIMIT {most}"))]

    def _find(self, columns: str, request: Request) -> list[Any]:
        known = keys(request)
        marks = ", ".join("?" * len(known))
        statement = f"SELECT {columns} FROM capture WHERE key IN ({marks}) ORDER BY key = ? DESC LIMIT 1"
        return self._query(statement, *known, known[0])

    def _query(self, statement: str, *values: Any) -> list[Any]:
        with schema.errors_of(self.path, write=False), self._using() as database:
            return database.execute(statement, values).fetchall()

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        """Queries within see one state of the file."""
        with schema.errors_of(self.path, write=False), self._using() as database:
            if database.in_transaction:
                yield
                return
            database.execute("BEGIN")
            try:
                yield
            finally:
                database.rollback()

    @contextlib.contextmanager
    def _named(self, advice: str = "") -> Iterator[None]:
        """Name the file in errors about damage."""
        try:
            yield
        except DamagedRecordingError as cause:
            if str(cause).startswith(f"{self.path}: "):
                raise
            raise DamagedRecordingError(f"{self.path}: {cause}{advice}") from cause

    @contextlib.contextmanager
    def _using(self) -> Iterator[sqlite3.Connection]:
        """The connection, for one thread at a time; a new one in a forked child."""
        database, lock, process = self._connection
        if process != os.getpid() and not self._closed:
            _inherited.append(database)
            self._head = None  # a transaction under way is the parent's
            database, lock, process = self._connection = self._connect()
        with lock if not self._closed else contextlib.nullcontext():
            if self._closed:
                raise closed_error(str(self.path))
            yield database

    def _refuse(self, expected: str) -> NoReturn:
        raise RecordingNotWritableError(f"{self.path}: expected {expected}; record into another file")
