"""A recording is data only: whatever is written in one, it is replayed or refused in one sentence."""

import contextlib
import io
import pickle
import sqlite3
import struct

import numpy as np
import pytest
from support.faces import face_requests
from support.recordings import reseal

import omniscv
from omniscv.errors import NotARecordingError, RecordingError
from omniscv.sources.recording.inspection import info, verify
from omniscv.sources.recording.store import Store


class Bomb:
    """Runs when it is unpickled."""

    def __reduce__(self):
        return (open, ("owned", "w"))


def pickled():
    stream = io.BytesIO()
    np.save(stream, np.array([Bomb()], dtype=object), allow_pickle=True)
    return stream.getvalue()


HUGE = (
    '{"position": [0,0,0], "rotation": [[1,0,0],[0,1,0],[0,0,1]], "fov_deg": 90, "width": 1e9, "height": 1e9}'
)
ESCAPES, LONGEST = "\x1b[31m\n" * 10_000, 300
TEXTS = [ESCAPES, "", "{", "[]", None]
VALUES = {
    "payload": [b"", pickle.dumps(Bomb()), pickled(), b"\x89PNG\r\n\x1a\n" + b"\0" * 40, "text", None, 3],
    "encoding": [ESCAPES, "pickle", "../../etc/passwd", None, 7],
    "captured": [*TEXTS, HUGE, '{"position": "__import__(\'os\')"}'],
    "asked": [*TEXTS, '{"position": [1e400, 0, 0]}'],
    "provenance": [*TEXTS, "!!python/object/apply:os.system [true]", "[" * 2000, '{"time": 1e300}'],
    "mode": [ESCAPES, "lit; DROP TABLE capture", None],
    "key": [ESCAPES, "x", None],
}
CASES = [(column, value) for column, values in VALUES.items() for value in values]


@pytest.fixture
def spoilt(copy, tmp_path, monkeypatch):
    """A recording that a test may spoil; call it with statements, and it is sealed anew."""
    monkeypatch.chdir(tmp_path)

    def spoil(statement, *values):
        with contextlib.closing(sqlite3.connect(copy, isolation_level=None)) as database:
            database.execute("PRAGMA ignore_check_constraints = 1")
            with contextlib.suppress(sqlite3.IntegrityError):  # the schema refuses it
                if values:
                    database.execute(statement, values)
                else:
                    database.executescript(statement)
        if values:
            with contextlib.suppress(sqlite3.DatabaseError, TypeError, AttributeError):
                reseal(copy)
        return copy

    return spoil


@pytest.mark.block_network
@pytest.mark.parametrize(
    ("column", "value"), CASES, ids=[f"{column}-{i}" for i, (column, _) in enumerate(CASES)]
)
def test_any_value_in_any_column(column, value, spoilt, tmp_path):
    """Checksums are computed anew: the author of the file is the attacker."""
    path = spoilt(f"UPDATE capture SET {column} = ? WHERE rowid <= 3", value)
    said = []
    for read in (info, verify, replay):
        try:
            found = read(path)
            said += found.faults if read is verify else []
        except omniscv.OmniscvError as error:  # any other error fails
            said.append(str(error))
    for text in (text.replace(str(tmp_path), "") for text in said):
        assert text.isprintable()
        assert len(text) <= LONGEST
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE object SET red = 256",
        "UPDATE object SET blue = -1",
        "UPDATE object SET instance = 65536",
        "UPDATE recording SET tolerance = 256",
    ],
)
def test_values_of_the_object_table_have_bounds(statement, spoilt):
    path = spoilt(statement)
    reseal(path)
    with (
        pytest.raises(RecordingError, match="colours, ids and a tolerance"),
        omniscv.open_source(path) as replay,
    ):
        replay.objects()


ENDLESS = """
CREATE VIEW capture AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)
    SELECT i AS number, '' AS key FROM n
"""
SCHEMAS = {
    f"DROP TABLE capture; {ENDLESS}": "the view 'capture'",
    "CREATE VIEW more AS SELECT 1": "the view 'more'",
    "CREATE TRIGGER quiet BEFORE INSERT ON capture BEGIN SELECT raise(ignore); END": "the trigger 'quiet'",
    "CREATE TABLE more (x)": "the table 'more'",
    'CREATE TABLE "\x1b[31mred" (x)': r"the table '\\x1b\[31mred'",
    "CREATE INDEX more ON capture (mode)": "the index 'more'",
    "CREATE VIRTUAL TABLE more USING fts4(x)": "more",
    "DROP TABLE object": "some of them only",
    "ALTER TABLE object ADD COLUMN more BLOB AS (zeroblob(900000000))": "object",
    "DROP TABLE capture; CREATE TABLE capture (key TEXT)": "capture",
}


@pytest.mark.parametrize("statement", SCHEMAS, ids=range(len(SCHEMAS)))
def test_a_schema_with_anything_else_is_refused(statement, spoilt):
    """Neither read, which may take for ever, nor written, which may do nothing."""
    path = spoilt(statement)
    before = path.read_bytes()
    for use in (info, verify, replay, lambda path: Store(path, write=True)):
        with pytest.raises(NotARecordingError, match=f"only, got .*{SCHEMAS[statement]}"):
            use(path)
    assert path.read_bytes() == before


def test_a_tree_of_pages_that_never_ends_is_refused(spoilt):
    """All entries of a page of the tree point to that page's first child: rows without end."""
    path = spoilt("SELECT 1")
    data = bytearray(path.read_bytes())
    size = int.from_bytes(data[16:18], "big")
    with contextlib.closing(sqlite3.connect(path)) as database:
        ((root,),) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'capture'")
    for _ in range(2):  # the root becomes a page of pointers to itself
        start = (root - 1) * size
        cells = [start + size - 6 * (i + 1) for i in range(300)]
        data[start : start + 12] = struct.pack(">BHHHBI", 5, 0, 300, size - 1800, 0, root)
        for i, cell in enumerate(cells):
            data[start + 12 + 2 * i : start + 14 + 2 * i] = (cell - start).to_bytes(2, "big")
            data[cell : cell + 5] = root.to_bytes(4, "big") + bytes([min(i, 127)])
    path.write_bytes(data)
    for use in (info, replay):
        with pytest.raises(RecordingError):
            use(path)
    with contextlib.suppress(RecordingError):
        assert not verify(path).ok


def replay(path):
    with omniscv.open_source(path) as source:
        for capture in source.capture(face_requests()):
            assert capture.pixels.shape[:2] == (32, 32)
