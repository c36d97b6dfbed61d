"""The open database of a recording: connections, transactions, and what the recording is."""

import contextlib
import os
import secrets
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omniscv.errors import DamagedRecordingError
from omniscv.sources.base import closed_error
from omniscv.sources.recording import schema
from omniscv.sources.recording.forking import hold_at_forks
from omniscv.sources.recording.opening import open_to_read, open_to_write
from omniscv.sources.recording.replacing import followed, place_of
from omniscv.sources.recording.rows import Head, write_head

# Connections of the parent process, which a forked child must neither use nor close:
_inherited: list[sqlite3.Connection] = []


class _UndoneError(Exception):
    """Ends a transaction that is to be undone."""


class Database:
    """An open database of a recording: one thread uses it at a time, and a forked child has its own.

    Args:
        path: the file; links are followed.
        write: whether it will be changed; the file is then created if there is none, and a recording of
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

    def structural_faults(self) -> list[str]:
        """What SQLite's integrity check reports; nothing for a sound file."""
        with schema.errors_of(self.path, write=False), self._using() as database:
            return schema.structural_faults(database)

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
