"""The file of a recording: one SQLite database, one row per capture, described in docs/recording-format.md.

Each capture is a transaction: whatever kills the process, it is in the file whole or not at all. What a
killed process left half-written is undone when the file is next opened.
"""

import contextlib
import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from omniscv.arguments import shown
from omniscv.errors import DamagedRecordingError, OtherSceneError, RecordingNotWritableError
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import Capture, ObjectTable, Request, SceneIdentity, closed_error
from omniscv.sources.described import ORIGIN
from omniscv.sources.recording import files
from omniscv.sources.recording.rows import Head, Row, key_of, labelled_modes
from omniscv.sources.recording.world_rows import (
    MOST_OBJECTS,
    WorldState,
    checked_json,
    json_of_row,
    object_checksum,
    object_from_json,
    object_rows,
    object_table,
    readable,
    scene_from_json,
    scene_in_words,
    scene_to_json,
    table_conflict,
)
from omniscv.sources.world import Exposure, exposure_from_text

_ADVICE = "run 'omniscv recording check'"
_COLUMNS = ", ".join(Row._fields)
_WITHOUT_PAYLOAD = _COLUMNS.replace(", payload,", ", x'',")
_MOST_STATES = 1_000_000
_SHORTEST_BYTES = 100  # of a row of `capture`: two views and a key


def _column(rows: Iterable[tuple[Any]]) -> list[Any]:
    """Return the values of rows of one column."""
    return [value for (value,) in rows]


class Store(files.Forkable):
    """An open recording. One thread uses it at a time; a forked child opens a connection of its own.

    With ``write``, captures will be added, and the file is created if there is none.

    Raises:
        NotARecordingError: there is no file to read, it is something else, of an earlier version, or damaged.
        NewerRecordingError: written by a later version.
        RecordingNotWritableError: the file cannot be written.
    """

    def __init__(self, path: Path | str, *, write: bool = False) -> None:
        self.path = Path(path)
        self._write = write
        self._closed = False
        self._head: Head | None = None  # of the transaction under way
        self._id = ""  # read when it is needed first
        self._file = files.target_of(path) if write else files.followed(path)
        super().__init__(self._open)

    def close(self) -> None:
        """Close the file; no journal is left beside it."""
        with self._lock:
            self._closed = True
            if self._connection is None:
                return
            if self._write:
                # Removes the empty journal; refused while another process writes, which removes it then.
                with contextlib.suppress(sqlite3.OperationalError):
                    self._connection.execute("PRAGMA journal_mode = DELETE")
            self._connection.close()
            self._connection = None

    def head(self) -> Head:
        """Return what the recording is, checked, with the changes under way."""
        with self._reading():
            if self._head is not None:
                return self._head
            rows = self._query(f"SELECT {', '.join(Head._fields)} FROM recording LIMIT 2")
            if len(rows) != 1:
                raise DamagedRecordingError(f"expected one row in recording, got {len(rows)}")
            head = Head._make(rows[0])
            head.check()
            return head

    def structural_faults(self) -> list[str]:
        """Return what SQLite's integrity check reports; nothing for a sound file."""
        faults = []
        for (report,) in self._query("PRAGMA integrity_check"):
            for line in report.splitlines():
                if line != "ok" and not line.startswith("***"):  # no headings
                    faults.append(line)
        return faults

    @contextlib.contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Make all changes within together, or none; may be nested. Errors raised within pass unchanged."""
        with self._connected() as database:
            if self._head is not None:
                yield database
                return
            try:
                with files.errors_of(self.path, write=True):
                    database.execute("BEGIN IMMEDIATE")
                    head = self.head().changed()
                    self._head = head
                    self._write_head(database, head)  # first: a journal is known by it
                before = database.total_changes
                yield database
                with files.errors_of(self.path, write=True):
                    if self._head != head or database.total_changes != before:
                        self._write_head(database, self._head)
                        database.commit()
            finally:
                self._head = None
                database.rollback()  # without effect after a commit

    def listing(self) -> list[Row]:
        """Return every capture but its payload, as recorded; DamagedRecordingError if one is lost."""
        statement = f"SELECT {_WITHOUT_PAYLOAD} FROM capture ORDER BY number LIMIT "
        with self._reading():
            head = self.head()
            rows = list(map(Row._make, self._query(f"{statement}{self._most_captures()}")))
            states = _column(self._query(f"SELECT name FROM state LIMIT {_MOST_STATES}"))
        with files.errors_of(self.path, advice=_ADVICE):
            for row in rows:
                row.check(head.id)
            if lost := {row.state for row in rows} - {"", *states}:
                raise DamagedRecordingError(f"expected a row of state {shown(min(lost))}, got none")
            total = head._replace(captures=0, capture_sum=0).with_rows(rows)
            if (total.captures, total.capture_sum) != (head.captures, head.capture_sum):
                expected = f"expected {head.captures} captures as recorded"
                raise DamagedRecordingError(f"{expected}, got {total.captures}, or others")
        return rows

    def rows(self, numbers: Iterable[int] | None = None) -> Iterator[Row]:
        """Yield captures of some numbers as stored, unchecked; by default all, in the order of recording."""
        if numbers is None:
            most = self._most_captures()
            numbers = _column(self._query(f"SELECT number FROM capture ORDER BY number LIMIT {most}"))
        for number in dict.fromkeys(numbers):
            yield from map(Row._make, self._query(f"SELECT {_COLUMNS} FROM capture WHERE number = ?", number))

    def holds(self, request: Request) -> bool:
        """Return whether there is a capture of a request."""
        return bool(self._query("SELECT 1 FROM capture WHERE key = ?", key_of(request)))

    def get(self, request: Request) -> Capture | None:
        """Return the capture of a request, None if there is none; DamagedRecordingError if it is damaged."""
        row = self.get_row(request)
        if row is None:
            return None
        with files.errors_of(self.path, advice=_ADVICE):
            return replace(row.capture(), request=request)

    def get_row(self, request: Request) -> Row | None:
        """Return the capture of a request as stored, all but its payload checked; None if there is none."""
        rows = self._query(f"SELECT {_COLUMNS} FROM capture WHERE key = ?", key_of(request))
        if not rows:
            return None
        with files.errors_of(self.path, advice=_ADVICE):
            row = Row._make(rows[0])
            row.check(self._recording_id())
            return row

    def add(self, capture: Capture) -> None:
        """Write a capture, in place of an earlier one of the same request.

        Raises ArgumentError for provenance that is no JSON, BadReplyError for pixels that do not fit,
        RecordingNotWritableError for a full disk, a too large capture, or a file that cannot be written.
        """
        self.add_row(Row.of(capture))

    def add_row(self, row: Row) -> None:
        """Write a capture as stored in this or another recording, in place of an earlier one of its key."""
        if len(row.payload) + len(row.provenance) > files.LARGEST_BYTES - 10_000:
            expected = f"expected a capture of at most {files.LARGEST_BYTES} bytes"
            raise RecordingNotWritableError(f"{expected}, got {len(row.payload)}", self.path)
        with files.errors_of(self.path, write=True), readable():
            "".join(row[1:7]).encode()
            scene = row.description()[2].get("scene")
        with self._changing() as database:
            head = self.head()
            if scene:
                self._check_named(scene)
            (number,) = database.execute("SELECT coalesce(max(number), 0) + 1 FROM capture").fetchone()
            row = row.in_recording(number, head.id)
            if row.state and self.state(row.state) is None:
                self.set_state(row.state, WorldState())
            replaced = _column(self._query("SELECT checksum FROM capture WHERE key = ?", row.key))
            database.execute("DELETE FROM capture WHERE key = ?", (row.key,))
            database.execute(f"INSERT INTO capture ({_COLUMNS}) VALUES ({', '.join('?' * len(row))})", row)
            self._head = head.with_rows([row], replaced)

    def objects(self) -> ObjectTable:
        """Return the recorded objects and how masks show them; DamagedRecordingError if they are damaged."""
        with self._reading():
            head = self.head()
            columns = "name, red, green, blue, instance"
            rows = self._query(f"SELECT {columns} FROM object ORDER BY name LIMIT {MOST_OBJECTS + 1}")
            table_rows = sorted(rows, key=lambda row: str(row[0]))  # may be NULL
            if (crc := object_checksum(table_rows)) != head.object_checksum:
                expected = f"expected checksum {head.object_checksum} of the object table"
                raise DamagedRecordingError(f"{expected}, got {crc}")
            return object_table(table_rows, head.tolerance)

    def set_objects(self, table: ObjectTable) -> None:
        """Add objects; replace a table that they contradict and no mask needs; else OtherSceneError."""
        with self._changing() as database:
            head = self.head()
            before = self.objects()
            conflict = table_conflict(before, table)
            if conflict and self.has_masks():
                self._refuse(f"the mask colours of its object masks, but {conflict}")
            after = table
            if not conflict:
                colors = {**before.colors, **table.colors}
                ids = {**before.ids, **table.ids}
                after = ObjectTable(colors, table.tolerance, ids)
            strange = before.colors and table.colors and not before.colors.keys() & table.colors.keys()
            if head.captures and strange:
                known = shown(min(before.colors))
                new = shown(min(table.colors))
                self._refuse(f"objects of its scene, such as {known}, got only others, such as {new}")
            table_rows = object_rows(after)
            if after != before:
                database.execute("DELETE FROM object")
                database.executemany("INSERT INTO object VALUES (?, ?, ?, ?, ?)", table_rows)
            crc = object_checksum(table_rows)
            self._head = head._replace(tolerance=after.tolerance, object_checksum=crc)

    def geometry(self) -> SceneGeometry:
        """Return what is known of shapes; DamagedRecordingError if that is not as written."""
        with self._reading():
            rows = self._query("SELECT content, checksum FROM geometry LIMIT 2")
            if len(rows) != 1:
                raise DamagedRecordingError(f"expected one row in geometry, got {len(rows)}")
            return json_of_row("geometry", SceneGeometry.from_dict, *rows[0], self._recording_id())

    def set_geometry(self, geometry: SceneGeometry) -> None:
        """Add boxes, and a room, to what is known of shapes."""
        with self._changing() as database:
            known = self.geometry()
            merged = SceneGeometry({**known.boxes, **geometry.boxes}, geometry.room or known.room)
            if merged.to_dict() != known.to_dict():
                content = checked_json(merged.to_dict(), SceneGeometry.from_dict, self._recording_id())
                database.execute("UPDATE geometry SET content = ?, checksum = ?", content)

    def states(self) -> dict[str, WorldState]:
        """Return what is known of every state that captures show, except the still one."""
        return self._states("")

    def state(self, name: str) -> WorldState | None:
        """Return what is known of a state; None for the still one, and for one that no capture shows."""
        return self._states("WHERE name = ?", name).get(name)

    def set_state(self, name: str, state: WorldState) -> None:
        """Note what is known of the ``state`` of a ``name``."""
        with self._changing() as database:
            read = partial(WorldState.from_dict, name)
            content = checked_json(state.to_dict(), read, self._recording_id(), name)
            database.execute("INSERT OR REPLACE INTO state VALUES (?, ?, ?)", (name, *content))

    def exposure(self) -> Exposure | None:
        """Return the exposure of the last colours; None without any."""
        provenance = self._last_provenance("WHERE mode = 'lit'")
        return None if provenance is None else exposure_from_text(provenance.get("exposure"))

    def origin(self) -> dict[str, Any] | None:
        """Return what the captures are of, as the last one says (:mod:`omniscv.sources.described`); None
        where it says nothing."""
        origin = (self._last_provenance() or {}).get(ORIGIN)
        return origin if isinstance(origin, dict) else None

    def dialect(self) -> object:
        """Return the dialect of the last capture's server; None without one."""
        return (self._last_provenance() or {}).get("dialect")

    def _last_provenance(self, where: str = "") -> dict[str, Any] | None:
        """Return where the last capture came from; None without any."""
        last = f"{where} ORDER BY number DESC LIMIT 1"
        rows = self._query(f"SELECT {_WITHOUT_PAYLOAD} FROM capture {last}")
        with files.errors_of(self.path, advice=_ADVICE):
            for row in rows:
                return dict(Row._make(row).description()[2])
        return None

    def has_masks(self) -> bool:
        """Return whether there is a capture that the object table gives names to."""
        modes = labelled_modes()
        marks = ", ".join("?" * len(modes))
        return bool(self._query(f"SELECT 1 FROM capture WHERE mode IN ({marks}) LIMIT 1", *modes))

    @property
    def scene_identity(self) -> SceneIdentity:
        """The scene that the captures are of."""
        with self._reading():
            return scene_from_json(self.head().scene)

    def set_scene(self, identity: SceneIdentity) -> None:
        """Add what is known of the scene; OtherSceneError if it is another one."""
        known = self.scene_identity
        if known.differs(identity):
            self._refuse(f"captures of the scene {scene_in_words(known)}, got {scene_in_words(identity)}")
        if known.merged(identity) != known:
            with self._changing(), readable():
                scene = scene_to_json(known.merged(identity))
                scene.encode()
                self._head = self.head()._replace(scene=scene)

    def _states(self, where: str, *names: str) -> dict[str, WorldState]:
        statement = f"SELECT name, content, checksum FROM state {where} ORDER BY name LIMIT {_MOST_STATES}"
        states = {}
        with self._reading():
            for name, content, crc in self._query(statement, *names):
                read = partial(WorldState.from_dict, name)
                where_read = f"state {shown(name)}"
                states[name] = json_of_row(where_read, read, content, crc, self._recording_id(), name)
        return states

    def _check_named(self, scene: object) -> None:
        """Raise OtherSceneError if a capture's provenance names another scene than that of an earlier one."""
        last = "instr(provenance, '\"scene\"') ORDER BY number DESC LIMIT 1"
        latest = f"SELECT provenance FROM capture WHERE {last}"
        for (text,) in self._query(latest):
            known = object_from_json(text).get("scene")
            if known and known != scene:
                self._refuse(f"captures of the scene {shown(known)}, got {shown(scene)}")

    def _refuse(self, expected: str) -> NoReturn:
        raise OtherSceneError(f"expected {expected}; record into another file", self.path)

    def _most_captures(self) -> int:
        """Return how many captures the file can hold at most; damaged pages can claim more."""
        return self._file.stat().st_size // _SHORTEST_BYTES

    def _recording_id(self) -> str:
        self._id = self._id or self.head().id
        return self._id

    def _write_head(self, database: sqlite3.Connection, head: Head) -> None:
        columns = ", ".join(f"{name} = ?" for name in Head._fields)
        database.execute(f"UPDATE recording SET {columns}", head.sealed())

    @contextlib.contextmanager
    def _changing(self) -> Iterator[sqlite3.Connection]:
        """A transaction in which errors of SQLite are RecordingNotWritableError."""
        with self.transaction() as database, files.errors_of(self.path, write=True):
            yield database

    def _query(self, statement: str, *values: Any) -> list[Any]:
        with self._reading() as database:
            return database.execute(statement, values).fetchall()

    @contextlib.contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """Let all queries within see one state of the file. Errors within are those of this recording."""
        with files.errors_of(self.path), self._connected() as database:
            if database.in_transaction:
                yield database
                return
            database.execute("BEGIN")
            try:
                yield database
            finally:
                database.rollback()

    @contextlib.contextmanager
    def _connected(self) -> Iterator[sqlite3.Connection]:
        """Yield the connection, for one thread at a time; open it in a forked child."""
        with self._lock:
            if self._closed:
                raise closed_error(str(self.path))
            self._connection = self._connection or self._open()
            yield self._connection

    def _forked(self) -> None:
        super()._forked()
        self._head = None

    def _open(self) -> sqlite3.Connection:
        with files.errors_of(self.path, write=self._write):
            return files.opened(self._file, self._write)
