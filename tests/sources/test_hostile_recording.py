"""A recording is data only: whatever is written in one, it is replayed or refused in one sentence."""

import contextlib
import io
import pickle
import sqlite3
import zlib

import numpy as np
import pytest
from support.faces import face_requests

import omniscv
from omniscv.errors import RecordingError
from omniscv.sources.recording.inspection import info, verify


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
VALUES = {
    "payload": [b"", pickle.dumps(Bomb()), pickled(), b"\x89PNG\r\n\x1a\n" + b"\0" * 40, "text", None, 3],
    "encoding": ["pickle", "", "../../etc/passwd", None, 7],
    "captured": ["", "{", "[]", "null", HUGE, '{"position": "__import__(\'os\')"}', None],
    "asked": ["", "{", "[]", "null", '{"position": [1e400, 0, 0]}', None],
    "provenance": ["", "{", "!!python/object/apply:os.system [true]", None, "[" * 2000, '{"time": 1e300}'],
    "mode": ["", "lit; DROP TABLE capture", None],
    "key": ["", "x", None],
}
CASES = [(column, value) for column, values in VALUES.items() for value in values]


@pytest.mark.block_network
@pytest.mark.parametrize(
    ("column", "value"), CASES, ids=[f"{column}-{i}" for i, (column, _) in enumerate(CASES)]
)
def test_any_value_in_any_column(column, value, copy, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    database = sqlite3.connect(copy)
    with database:
        database.execute("PRAGMA ignore_check_constraints = 1")
        try:
            database.execute(f"UPDATE capture SET {column} = ? WHERE rowid <= 3", (value,))
        except sqlite3.IntegrityError:  # the schema refuses it: one key for one row, nothing missing
            database.execute(f"UPDATE capture SET {column} = ? WHERE rowid = 1", (value or "",))
        if column == "payload" and isinstance(value, bytes):
            database.execute("UPDATE capture SET checksum = ? WHERE rowid <= 3", (zlib.crc32(value),))
    database.close()
    for read in (info, verify, replay):
        with contextlib.suppress(omniscv.OmniscvError):  # any other error fails
            read(copy)
    assert not (tmp_path / "owned").exists()


OBJECTS = {
    "UPDATE object SET red = 'x'": "colours, ids and a tolerance",
    "UPDATE object SET blue = NULL": "colours, ids and a tolerance",
    "CREATE TABLE mask (tolerance, ids); INSERT INTO mask VALUES ('x', '{}')": "colours, ids and a tolerance",
    "CREATE TABLE mask (tolerance, ids); INSERT INTO mask VALUES (0, '[]')": "JSON object",
    "CREATE TABLE mask (tolerance, ids); INSERT INTO mask VALUES (0, '{\"Sofa\": 1.5}')": "colours, ids",
    "CREATE TABLE mask (tolerance, ids)": "JSON",
    "CREATE TABLE mask (other)": "recording",
    "DROP TABLE object": "recording",
}


@pytest.mark.parametrize(("statement", "says"), OBJECTS.items(), ids=range(len(OBJECTS)))
def test_a_damaged_object_table_is_refused(statement, says, copy):
    database = sqlite3.connect(copy)
    database.executescript(statement)
    database.close()
    with omniscv.open_source(copy) as replay, pytest.raises(RecordingError, match=says):
        replay.objects()


def replay(path):
    with omniscv.open_source(path) as source:
        for capture in source.capture(face_requests()):
            assert capture.pixels.shape[:2] == (32, 32)
