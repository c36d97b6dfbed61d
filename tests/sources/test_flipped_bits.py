"""A recording with one bit flipped: refused, or the same views, pixels and labels as before."""

import random
import sqlite3
import time
from contextlib import closing

import pytest
from support.faces import face_requests

import omniscv
from omniscv.errors import RecordingError
from omniscv.sources.recording.inspection import verify

FLIPS, SOAK_FLIPS = 50, 10_000
REQUESTS = face_requests(size=8)
LONGEST_S = 60  # no flip makes a reader hang


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("small") / "small.sqlite"
    with omniscv.open_source("mock://four-wall") as live, omniscv.record(live, path) as source:
        source.objects()
        list(source.capture(REQUESTS))
    return path


def shown(path):
    """All that images are made of; an error is raised for what is refused."""
    with omniscv.open_source(path) as replay:
        found = [replay.recorded_views(), replay.capabilities, replay.objects(), replay.scene_identity]
        found += [replay.cover(request.view) for request in REQUESTS]
        for capture in replay.capture(REQUESTS):
            pixels = capture.pixels
            found += [capture.view.key(), capture.provenance, pixels.dtype, pixels.shape, pixels.tobytes()]
        return found


@pytest.mark.parametrize(
    "flips", [FLIPS, pytest.param(SOAK_FLIPS, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]
)
def test_single_bits(flips, small, tmp_path):
    wanted, data = shown(small), bytearray(small.read_bytes())
    bits = random.Random(flips)
    path, refused, missed = tmp_path / "flipped.sqlite", 0, []
    for _ in range(flips):
        bit = bits.randrange(8 * len(data))
        data[bit // 8] ^= 1 << bit % 8
        path.write_bytes(data)
        data[bit // 8] ^= 1 << bit % 8
        started = time.monotonic()
        try:
            assert shown(path) == wanted, f"bit {bit}"
        except RecordingError as error:
            refused += 1
            if not verify_finds(path) or "\n" in str(error):
                missed.append(bit)
        assert time.monotonic() - started < LONGEST_S
    print(f"{flips} flips of {len(data)} bytes: {refused} refused, the others changed nothing")
    assert refused > flips / 4  # else the flips are not where the data is
    assert missed == []


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
def test_a_bit_of_any_value_is_found_by_verify_and_refused(table, column, small, tmp_path):
    """Through SQLite, which does not see it: field of view 102 to 100, a mask's colour, an encoding."""
    path = tmp_path / "flipped.sqlite"
    path.write_bytes(small.read_bytes())
    with closing(sqlite3.connect(path)) as database, database:
        number, value = database.execute(f"SELECT rowid, {column} FROM {table} ORDER BY rowid").fetchone()
        database.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (flipped(value), number))
    assert verify_finds(path)
    with pytest.raises(RecordingError):
        shown(path)


def flipped(value):
    if isinstance(value, str):
        return value[:-1] + chr(ord(value[-1]) ^ 1)
    if isinstance(value, bytes):
        return value[:-20] + bytes([value[-20] ^ 1]) + value[-19:]
    return 1 if value is None else value ^ 1


def test_a_lost_capture_is_found(small, tmp_path):
    path = tmp_path / "lost.sqlite"
    path.write_bytes(small.read_bytes())
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("DELETE FROM capture WHERE number = 7")
    report = verify(path)
    assert [fault.partition(": ")[2] for fault in report.faults] == [
        "expected 24 captures as recorded, got 23, or others"
    ]
    with pytest.raises(RecordingError, match="expected 24 captures"):
        omniscv.open_source(path)
