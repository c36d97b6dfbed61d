"""Damaged and hostile recordings: found by a check, refused in one sentence, and never shown."""

import io
import pickle
import sqlite3
from contextlib import closing, suppress

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.faces import face_requests
from support.pictured import put
from support.recorder import SMALL, STATES, requests
from support.recordings import reseal

import omniscv
from omniscv.errors import (
    DamagedRecordingError,
    NewerRecordingError,
    NotARecordingError,
    OmniscvError,
    RecordingError,
    RecordingNotWritableError,
)
from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import ObjectBox, SceneGeometry
from omniscv.importing.importing import import_pictures
from omniscv.sources import Capabilities, Capture, ObjectTable, Request, SceneIdentity, Source, View
from omniscv.sources.recording import world_rows
from omniscv.sources.recording.inspection import info, verify
from omniscv.sources.recording.store import Store

LATER, EMPTIER = STATES[1:]
LONGEST = 300


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    path = tmp_path_factory.mktemp("moving") / "room.sqlite"
    with omniscv.open_source("scene://workshop") as scene, omniscv.record(scene, path) as recording:
        recording.objects()
        for instant in STATES:
            with recording.at(instant) as source:
                list(source.capture(requests(SMALL, source.state)[:2]))
    return path.read_bytes()


def alter(path, statement, *values):
    """Change a recording as its author could: SQLite sees no damage."""
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA ignore_check_constraints = 1")
        if values:
            return database.execute(statement, values).rowcount
        return database.executescript(statement).rowcount


def replay(path):
    with omniscv.open_source(path) as source:
        source.objects()
        for capture in source.capture(face_requests()):
            source.cover(capture.view)
            assert capture.pixels.shape[:2] == (32, 32)


def replay_states(path):
    with omniscv.open_source(path) as source:
        source.objects()
        return [source.at(instant).geometry() for instant in STATES]


def is_found(path):
    try:
        return not verify(path).ok
    except RecordingError:
        return True


COLUMNS = {
    "capture": ("mode", "asked", "captured", "encoding", "provenance", "payload_checksum", "payload", "key"),
    "object": ("name", "red", "instance"),
    "recording": ("id", "scene", "tolerance", "captures", "capture_sum", "object_checksum"),
}


@pytest.mark.parametrize(("table", "column"), [(t, column) for t in COLUMNS for column in COLUMNS[t]])
def test_a_flipped_bit_of_any_value_is_found_and_refused(table, column, copy):
    with closing(sqlite3.connect(copy)) as database:
        number, value = database.execute(f"SELECT rowid, {column} FROM {table} ORDER BY rowid").fetchone()
    alter(copy, f"UPDATE {table} SET {column} = ? WHERE rowid = ?", flipped(value), number)
    assert is_found(copy)
    with pytest.raises(RecordingError):
        replay(copy)


def flipped(value):
    if isinstance(value, str):
        return value[:-1] + chr(ord(value[-1]) ^ 1)
    if isinstance(value, bytes):
        return value[:-20] + bytes([value[-20] ^ 1]) + value[-19:]
    return 1 if value is None else value ^ 1


def test_lost_and_changed_rows_are_found_and_refused(moving, tmp_path):
    for statement, says in (
        ("DELETE FROM capture WHERE number = 2", "expected 6 captures as recorded, got 5, or others"),
        ("UPDATE object SET name = CAST(x'41ff' AS TEXT) WHERE rowid = 1", "expected rows as recorded"),
        ("UPDATE geometry SET content = replace(content, '2.', '3.')", "of geometry, got another"),
        ("DELETE FROM geometry", "expected one row in geometry, got 0"),
        ("UPDATE capture SET state = '' WHERE number = 4", "expected checksum .* of the row"),
        (f"UPDATE capture SET state = '{EMPTIER.state}' WHERE state = '{LATER.state}'", "of the row"),
        (f"DELETE FROM state WHERE name = '{LATER.state}'", f"expected a row of state '{LATER.state}'"),
        ("UPDATE state SET content = replace(content, '0.7', '0.8')", f"'{LATER.state}', got another"),
    ):
        path = tmp_path / "room.sqlite"
        path.write_bytes(moving)
        replay_states(path)
        alter(path, statement)
        assert not verify(path).ok
        with pytest.raises(DamagedRecordingError, match=says) as error:
            replay_states(path)
        assert len(str(error.value)) - len(str(path)) <= LONGEST


class Bomb:
    def __reduce__(self):
        return (open, ("owned", "w"))


def pickled():
    stream = io.BytesIO()
    np.save(stream, np.array([Bomb()], dtype=object), allow_pickle=True)
    return stream.getvalue()


HUGE = (
    '{"position": [0,0,0], "rotation": [[1,0,0],[0,1,0],[0,0,1]], "fov_deg": 90, "width": 1e9, "height": 1e9}'
)
ESCAPES = "\x1b[31m\n" * 10_000
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


@pytest.mark.block_network
@pytest.mark.parametrize("column", VALUES)
def test_any_value_in_any_column(column, recorded, tmp_path, monkeypatch):
    """Checksums are computed anew: the author of the file is the attacker."""
    monkeypatch.chdir(tmp_path)
    for number, value in enumerate(VALUES[column]):
        path = tmp_path / f"{number}.sqlite"
        path.write_bytes(recorded.read_bytes())
        with suppress(sqlite3.DatabaseError, TypeError, AttributeError):  # the schema refuses it
            alter(path, f"UPDATE capture SET {column} = ? WHERE rowid <= 3", value)
            reseal(path)
        lines = []
        for read in (info, verify, replay):
            try:
                report = read(path)
                lines += report.faults if read is verify else []
            except omniscv.OmniscvError as error:  # any other error fails
                lines.append(str(error))
        for line in (line.replace(str(tmp_path), "") for line in lines):
            assert line.isprintable()
            assert len(line) <= LONGEST
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize(
    "change", ["object SET red = 256", "object SET blue = -1", "object SET instance = 65536",
               "recording SET tolerance = 256"],
)  # fmt: skip
def test_values_of_the_object_table_have_bounds(change, copy):
    alter(copy, f"UPDATE {change}")
    reseal(copy)
    with pytest.raises(RecordingError, match="colours, ids and a tolerance"):
        replay(copy)


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
def test_a_schema_with_anything_else_is_refused(statement, copy):
    alter(copy, statement)
    before = copy.read_bytes()
    for use in (info, verify, replay, lambda path: Store(path, write=True)):
        with pytest.raises(NotARecordingError, match=f"only, got .*{SCHEMAS[statement]}"):
            use(copy)
    assert copy.read_bytes() == before


def test_a_recording_of_another_version_is_refused(copy):
    for version, error, says in (
        (7, NewerRecordingError, "expected schema version 4, got version 7; update omniscv"),
        (3, NotARecordingError, "expected schema version 4, got version 3; record it again"),
    ):
        alter(copy, f"PRAGMA user_version = {version}")
        for write in (False, True):
            with pytest.raises(error, match=says):
                Store(copy, write=write)


PIXELS = {
    "lit": np.zeros((2, 2, 3), np.uint8),
    "object_mask": np.ones((2, 2), np.uint16),
    "depth": np.ones((2, 2), np.float32),
}
TEXT = st.text(st.characters(exclude_categories=()), max_size=5) | st.just("\ud800") | st.just("x" * 200)
WHOLE = st.integers(-1, 300) | st.sampled_from([0xFFFF, 1 << 16, 1 << 70, 10**5000])
VALUE = st.recursive(
    st.none() | st.floats() | WHOLE | TEXT, lambda v: st.lists(v, max_size=2) | st.dictionaries(TEXT, v)
)
NAMES = st.sampled_from(["a", "b", "", "\0", "\ud800", "é" * 99])
PROVENANCE = st.dictionaries(TEXT, VALUE, max_size=2) | st.fixed_dictionaries({"scene": NAMES | WHOLE})
TABLE = st.builds(
    ObjectTable, st.dictionaries(NAMES, st.tuples(WHOLE, WHOLE, WHOLE), max_size=3), WHOLE, st.just({})
) | st.builds(ObjectTable, st.just({}), WHOLE, st.dictionaries(NAMES, WHOLE, max_size=3))
NUMBER = st.floats(-1e6, 1e6)


class Says(Source):
    def __init__(self, draw):
        self.draw = draw
        self.name = SceneIdentity(draw(NAMES), draw(NAMES))
        self.table = draw(TABLE)

    capabilities = Capabilities()

    @property
    def scene_identity(self):
        return self.name

    def objects(self):
        return self.table

    def geometry(self):
        box = ObjectBox(np.array([self.draw(NUMBER)] * 3), np.eye(3), np.ones(3), "scene")
        return SceneGeometry(self.draw(st.dictionaries(NAMES, st.just(box), max_size=2)))

    def capture(self, requests):
        for request in requests:
            yield Capture(request, request.view, PIXELS[request.mode], self.draw(PROVENANCE))


@st.composite
def any_request(draw):
    view = View(Pose.from_angles([draw(NUMBER)] * 3, draw(NUMBER)), draw(st.floats(0.01, 179.9)), 2, 2)
    mode = draw(st.sampled_from([*PIXELS]))
    stops = draw(st.none() | st.floats(-20, 20)) if mode == "lit" else None
    return Request(view, mode, stops=stops)


@settings(max_examples=30, deadline=None, suppress_health_check=[*HealthCheck])
@given(st.data())
def test_what_a_recorder_took_is_sound(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("sound") / "a.sqlite"
    for _ in range(2):
        with suppress(OmniscvError):
            source = omniscv.record(Says(data.draw), path)
            with source, suppress(OmniscvError):
                source.objects()
            with source:
                list(source.capture([data.draw(any_request())]))
        if path.exists():
            assert verify(path).faults == []


def test_an_import_of_too_many_objects_leaves_the_recording_as_it_was(tmp_path, monkeypatch):
    """Masks without a list: each colour becomes an object, and 60,000 are known; here of both a hundredth."""
    assert world_rows.MOST_OBJECTS == 65535
    monkeypatch.setattr(world_rows, "MOST_OBJECTS", 655)
    file = tmp_path / "a.sqlite"
    codes = np.arange(600 + 8 * 8)
    colors = np.uint8(np.stack([codes + 1 >> shift & 255 for shift in (16, 8, 0)], axis=-1))
    with closing(Store(file, write=True)) as store:
        store.set_objects(ObjectTable({f"{i}": tuple(rgb) for i, rgb in enumerate(colors[:600].tolist())}))
    for face in ("front", "right", "back", "left", "up", "down"):
        put(tmp_path / f"f/mask/{face}.png", colors[600:].reshape(8, 8, 3))
    before = file.read_bytes()
    with pytest.raises(RecordingNotWritableError, match="expected at most 655 objects, got more"):
        import_pictures(tmp_path / "f", file, "faces")
    assert file.read_bytes() == before
    assert verify(file).ok
