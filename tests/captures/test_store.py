"""The recorded file: whole or refused, never half."""

import sqlite3
import threading

import numpy as np
import pytest
from faces import face_requests
from permissions import as_somebody_who_may_only_read

import omniscv
from omniscv.captures.inspection import info, verify
from omniscv.captures.source import ObjectTable
from omniscv.captures.store import Store
from omniscv.errors import DamagedRecord, MissingCapture, NewerRecord, NotARecord, RecordNotWritable


def contents(path):
    """Everything in a record that a replay can show."""
    store = Store(path)
    try:
        return {row.key: row for row in store.rows()}, store.objects()
    finally:
        store.close()


@pytest.mark.block_network
def test_a_replay_gives_the_bytes_that_came(recorded):
    with omniscv.open_source(recorded) as replay:
        for request, capture in zip(face_requests(), replay.capture(face_requests()), strict=True):
            assert capture.request == request
            assert capture.pixels.shape[:2] == (32, 32)
            assert not capture.pixels.flags.writeable


def test_info_counts_what_is_there(recorded):
    found = info(recorded)
    assert found.captures == {"depth": 6, "lit": 6, "normal": 6, "object_mask": 6}
    assert (found.centers, found.sizes, found.scenes) == (1, {"32x32": 24}, ["four-wall"])
    assert found.objects > 0
    assert found.first <= found.last


def test_a_sound_record_verifies(recorded):
    report = verify(recorded)
    assert report.ok
    assert report.captures == 24


def test_flipped_bits_are_found_and_refused(copy):
    """One bit in each payload in turn: SQLite does not see it, the checksum does."""
    with sqlite3.connect(copy) as database:
        rows = database.execute("SELECT key, payload FROM capture").fetchall()
        for i, (key, payload) in enumerate(rows):
            spoiled = bytearray(payload)
            spoiled[len(spoiled) * i // len(rows)] ^= 1 << (i % 8)
            database.execute("UPDATE capture SET payload = ? WHERE key = ?", (bytes(spoiled), key))
    database.close()
    report = verify(copy)
    assert len(report.faults) == len(rows)
    with omniscv.open_source(copy) as replay:
        for request in face_requests():
            with pytest.raises(DamagedRecord, match="checksum"):
                next(replay.capture([request]))


def test_noise_anywhere_in_the_file_is_found(recorded, tmp_path):
    """Bytes of the file itself, pages of SQLite's own included: found, or nothing that is shown changed."""
    original, random = recorded.read_bytes(), np.random.default_rng(0)
    wanted = contents(recorded)
    path = tmp_path / "noisy.sqlite"
    for place in random.integers(100, len(original), 60):
        noisy = bytearray(original)
        noisy[place] ^= 0xFF
        path.write_bytes(noisy)
        try:
            found = not verify(path).ok
        except omniscv.errors.RecordError:
            found = True
        if not found:
            rows, _ = contents(path)
            same = {key: (r.payload, r.encoding, r.mode) for key, r in rows.items()}
            assert same == {key: (r.payload, r.encoding, r.mode) for key, r in wanted[0].items()}


def test_a_newer_record_says_which_version_it_needs(copy):
    with sqlite3.connect(copy) as database:
        database.execute("PRAGMA user_version = 7")
    database.close()
    for write in (False, True):
        with pytest.raises(NewerRecord, match="version 7"):
            Store(copy, write=write)


def test_another_database_is_left_alone(tmp_path):
    path = tmp_path / "photos.sqlite"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE photo (name TEXT)")
    database.close()
    before = path.read_bytes()
    for write in (False, True):
        with pytest.raises(NotARecord, match="another SQLite database"):
            Store(path, write=write)
    assert path.read_bytes() == before


def test_a_missing_view_names_the_nearest(recorded):
    wanted = face_requests(center=(1.0, 0.0, 1.5))[0]
    with (
        omniscv.open_source(recorded) as replay,
        pytest.raises(MissingCapture, match=r"nearest recorded is .* which differs in position"),
    ):
        next(replay.capture([wanted]))


def test_recording_again_asks_for_nothing_twice(copy, tmp_path):
    before = contents(copy)
    server = omniscv.open_source("mock://four-wall")
    asked = []
    inner = server.capture
    server.capture = lambda requests: inner(asked.append(r) or r for r in requests)
    new = face_requests(center=(0.5, 0.0, 1.5), modes=("lit",))
    with omniscv.record(server, copy) as source:
        list(source.capture([*face_requests(), *new, *new]))
    assert asked == new
    after = contents(copy)
    assert {key: after[0][key] for key in before[0]} == before[0]
    assert len(after[0]) == len(before[0]) + len(new)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"Sofa": (9, 9, 9)}, r"Sofa is \(9, 9, 9\) and was \("),
        ({"Cat": "Sofa"}, r"Cat is \(.*\), which was Sofa"),
    ],
)
def test_other_mask_colours_are_refused(change, says, copy):
    """They would turn one object's recorded pixels into another's."""
    live = omniscv.open_source("mock://four-wall")
    colors = live.objects().colors
    changed = {name: colors.get(color, color) for name, color in change.items()}
    live.objects = lambda: ObjectTable({**colors, **changed})
    before = contents(copy)
    with omniscv.record(live, copy) as source, pytest.raises(RecordNotWritable, match=says):
        source.objects()
    assert contents(copy) == before


def test_a_read_only_folder_is_one_clear_error(open_folder):
    with (
        as_somebody_who_may_only_read(open_folder),
        pytest.raises(RecordNotWritable, match=r"new\.sqlite: expected a file that can be written"),
    ):
        Store(open_folder / "new.sqlite", write=True)
    assert list(open_folder.iterdir()) == []


def test_a_full_disk_is_a_clear_error_and_keeps_what_came_before(copy, monkeypatch):
    """SQLite's own page limit stands in for the disk: it fails in the same way, SQLITE_FULL."""
    before = contents(copy)[0]
    store = Store(copy, write=True)
    pages = store._database.execute("PRAGMA page_count").fetchone()[0]
    store._database.execute(f"PRAGMA max_page_count = {pages + 4}")
    with omniscv.open_source("mock://four-wall") as live:
        [capture] = live.capture(face_requests(size=256, modes=("depth",))[:1])
    with pytest.raises(RecordNotWritable, match="full"):
        store.add(capture)
    store.close()
    assert contents(copy)[0] == before
    assert verify(copy).ok


def test_two_readers_and_a_writer_at_once(copy):
    """Readers see whole captures while a writer adds to the file."""
    stop, faults, rounds = threading.Event(), [], [0, 0]

    def read(who):
        while not stop.is_set():
            try:
                with omniscv.open_source(copy) as replay:
                    rounds[who] += sum(1 for _ in replay.capture(face_requests()))
            except omniscv.OmniscvError as fault:
                faults.append(fault)

    readers = [threading.Thread(target=read, args=(who,)) for who in range(2)]
    with (
        omniscv.open_source("mock://four-wall") as live,
        omniscv.record(live, copy) as source,
    ):
        for reader in readers:
            reader.start()
        try:
            for step in range(1, 9):
                list(source.capture(face_requests(center=(0.1 * step, 0.0, 1.5), modes=("lit", "depth"))))
        finally:
            stop.set()
            for reader in readers:
                reader.join()
    assert faults == []
    assert min(rounds) >= 24
    report = verify(copy)
    assert (report.ok, report.captures) == (True, 24 + 8 * 12)
