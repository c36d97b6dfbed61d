"""The file of a recording: whole or refused, never half."""

import threading

import pytest
from support.faces import face_requests
from support.full_disk import largest_file
from support.permissions import read_only
from support.recordings import contents

import omniscv
from omniscv.errors import RecordingNotWritableError
from omniscv.sources.recording.inspection import info, verify
from omniscv.sources.recording.store import Store


def test_info_counts_what_is_there(recorded):
    found = info(recorded)
    assert found.captures == {"depth": 6, "lit": 6, "normals": 6, "object_mask": 6}
    assert (found.centers, found.sizes, found.scenes) == (1, {"32x32": 24}, ["four-wall"])
    assert found.objects > 0
    assert found.first <= found.last


def test_a_read_only_folder_is_one_clear_error(open_folder):
    with (
        read_only(open_folder),
        pytest.raises(RecordingNotWritableError, match=r"new\.sqlite: expected a file that can be written"),
    ):
        Store(open_folder / "new.sqlite", write=True)
    assert list(open_folder.iterdir()) == []


def test_a_full_disk_is_a_clear_error_and_keeps_what_came_before(copy):
    before = contents(copy)[0]
    says = r"copy\.sqlite: expected a file that can be written, got: .*; what it held is intact$"
    requests = face_requests(size=256, modes=("depth",), center=(0.5, 0.0, 1.5))
    with (
        omniscv.record(omniscv.open_source("scene://four-wall"), copy) as source,
        largest_file(1 << 17),
        pytest.raises(RecordingNotWritableError, match=says),
    ):
        list(source.capture(requests))
    assert before.items() <= contents(copy)[0].items()
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
    with omniscv.open_source("mock://four-wall") as live, omniscv.record(live, copy) as source:
        for reader in readers:
            reader.start()
        try:
            for step in range(1, 5):
                list(source.capture(face_requests(center=(0.1 * step, 0.0, 1.5), modes=("lit", "depth"))))
        finally:
            stop.set()
            for reader in readers:
                reader.join()
    assert faults == []
    assert min(rounds) >= 24
    report = verify(copy)
    assert (report.ok, report.captures) == (True, 24 + 4 * 12)
