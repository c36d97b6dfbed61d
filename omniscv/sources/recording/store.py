"""The file of a recording: one SQLite database, one row per capture, described in docs/recording-format.md.

Each capture is a transaction: whatever kills the process, a capture is in the file whole or not at all. What
a killed process left half-written is undone from the journal beside the file when it is next opened.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, NoReturn

from omniscv.arguments import shown
from omniscv.errors import DamagedRecordingError, RecordingNotWritableError
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import Capture, ObjectTable, Request, SceneIdentity
from omniscv.sources.recording import geometry_table, object_tables, schema, state_table
from omniscv.sources.recording.database import Database
from omniscv.sources.recording.rows import (
    Row,
    insert,
    keys,
    scene_in_words,
    scene_to_json,
    the_scene,
)
from omniscv.sources.recording.state_table import HeldState
from omniscv.sources.recording.upgrade import COLUMNS_1

ADVICE = "; run 'omniscv captures verify'"  # at the end of errors about damage

_ALL, _STILL = (", ".join(columns) for columns in (Row._fields, (*Row._fields[:-1], "''")))
_COLUMNS = {1: COLUMNS_1, 2: _STILL, 3: _STILL, 4: _ALL}


class Store(Database):
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

    def rows(self, numbers: Iterable[int] | None = None, *, payload: bool = True) -> Iterator[Row]:
        """Every capture as stored, unchecked, in the order of recording; without its payload if so wanted.

        Args:
            numbers: of those that are wanted, in their order; all if not given.
            payload: whether it is read.
        """
        if not payload:
            yield from self._rows()
            return
        if numbers is None:
            most = schema.most_captures(self._place)
            every = self._query(f"SELECT rowid FROM capture ORDER BY rowid LIMIT {most}")
            numbers = (number for (number,) in every)
        for number in dict.fromkeys(numbers):
            found = self._query(f"SELECT {_COLUMNS[self.version]} FROM capture WHERE rowid = ?", number)
            yield from map(Row._make, found)

    def holds(self, request: Request) -> bool:
        """Whether there is a capture of a request."""
        return bool(self._find("1", request))

    def get(self, request: Request) -> Capture | None:
        """The capture of a request, None if there is none; DamagedRecordingError as :meth:`Row.capture`."""
        row = self.get_row(request)
        if row is None:
            return None
        with self._named(ADVICE):
            return replace(row.capture(), request=request)

    def get_row(self, request: Request) -> Row | None:
        """The capture of a request as it is stored, all but its payload checked; None if there is none."""
        found = self._find(_COLUMNS[self.version], request)
        if not found:
            return None
        with self._named(ADVICE):
            row = Row._make(found[0])
            row.check(self._recording_id())
            return row

    def add(self, capture: Capture) -> None:
        """Write a capture, in place of an earlier one of the same request.

        Raises:
            ArgumentError: provenance that is no JSON.
            BadReplyError: pixels that do not fit the modality or the view.
            RecordingNotWritableError: the disk is full, the capture is too large, or the file cannot be
                written.
        """
        self.add_row(Row.of(capture, 1, ""), capture.request)

    def add_row(self, row: Row, request: Request) -> None:
        """Write a capture as it is stored, of this or another recording, in place of an earlier one.

        Raises:
            RecordingNotWritableError: as :meth:`add`.
        """
        with self.transaction() as database:
            assert self._head is not None  # there is a transaction
            known = keys(request)
            where = f"FROM capture WHERE key IN ({', '.join('?' * len(known))})"
            (number,) = database.execute("SELECT coalesce(max(number), 0) + 1 FROM capture").fetchone()
            row = row._replace(number=number)
            row = row._replace(checksum=row.own_checksum(self._head.id))
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

    def _rows(self) -> list[Row]:
        columns = _COLUMNS[self.version].replace(", payload,", ", x'',")
        most = schema.most_captures(self._place)
        return [*map(Row._make, self._query(f"SELECT {columns} FROM capture ORDER BY rowid LIMIT {most}"))]

    def _find(self, columns: str, request: Request) -> list[Any]:
        known = keys(request)
        marks = ", ".join("?" * len(known))
        statement = f"SELECT {columns} FROM capture WHERE key IN ({marks}) ORDER BY key = ? DESC LIMIT 1"
        return self._query(statement, *known, known[0])

    def _refuse(self, expected: str) -> NoReturn:
        raise RecordingNotWritableError(f"{self.path}: expected {expected}; record into another file")
