"""A bit of a value flipped, or a capture lost: found, and refused. tests/attack flips bits anywhere."""

import sqlite3
from contextlib import closing

import pytest
from support.faces import face_requests

import omniscv
from omniscv.errors import DamagedRecordingError, RecordingError
from omniscv.sources.recording.inspection import verify

REQUESTS = face_requests()


def shown(path):
    """All that images are made of; an error is raised for what is refused."""
    with omniscv.open_source(path) as replay:
        found = [replay.recorded_views(), replay.capabilities, replay.objects(), replay.scene_identity]
        found += [replay.cover(request.view) for request in REQUESTS]
        for capture in replay.capture(REQUESTS):
            pixels = capture.pixels
            found += [capture.view.key(), capture.provenance, pixels.dtype, pixels.shape, pixels.tobytes()]
        return found


def verify_finds(path):
    try:
        return not verify(path).ok
    except RecordingError:
        return True


FIELDS = {
    "capture": ("mode", "asked", "captured", "encoding", "provenance", "payload_checksum", "payload", "key"),
    "object": ("name", "red", "instance"),
    "recording": ("id", "scene", "tolerance", "captures", "capture_sum", "object_checksum"),
}
CASES = [(table, column) for table, columns in FIELDS.items() for column in columns]


@pytest.mark.parametrize(("table", "column"), CASES, ids=[".".join(case) for case in CASES])
def test_a_bit_of_any_value_is_found_by_verify_and_refused(table, column, copy):
    """Through SQLite, which does not see it: field of view 102 to 100, a mask's colour, an encoding."""
    with closing(sqlite3.connect(copy)) as database, database:
        number, value = database.execute(f"SELECT rowid, {column} FROM {table} ORDER BY rowid").fetchone()
        database.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (flipped(value), number))
    assert verify_finds(copy)
    with pytest.raises(RecordingError):
        shown(copy)


def flipped(value):
    if isinstance(value, str):
        return value[:-1] + chr(ord(value[-1]) ^ 1)
    if isinstance(value, bytes):
        return value[:-20] + bytes([value[-20] ^ 1]) + value[-19:]
    return 1 if value is None else value ^ 1


def test_a_lost_capture_is_found(copy):
    with closing(sqlite3.connect(copy)) as database, database:
        database.execute("DELETE FROM capture WHERE number = 7")
    report = verify(copy)
    assert [fault.partition(": ")[2] for fault in report.faults] == [
        "expected 24 captures as recorded, got 23, or others"
    ]
    with pytest.raises(RecordingError, match="expected 24 captures"):
        omniscv.open_source(copy)


def test_text_that_is_none_is_damage(copy):
    with closing(sqlite3.connect(copy)) as database, database:
        database.execute("UPDATE object SET name = CAST(x'41ff' AS TEXT) WHERE rowid = 1")
    assert verify_finds(copy)
    with pytest.raises(DamagedRecordingError, match="expected rows as recorded"):
        shown(copy)
