"""The file of a recording: whole or refused; what it replays, and what of it is stale."""

import sys
import threading
from collections import Counter
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from support.faces import CENTER, face_requests
from support.full_disk import largest_file
from support.permissions import read_only
from support.recordings import contents, filled

import omniscv
from omniscv.errors import MissingCaptureError, RecordingNotWritableError
from omniscv.geometry import Pose
from omniscv.sources import Request, View
from omniscv.sources.recording.inspection import info, verify
from omniscv.sources.recording.replay import in_words
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
    stop = threading.Event()
    faults = []
    rounds = [0, 0]

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


POSE = Pose.from_angles((0.0, 0.0, 1.5))
VIEW = View(POSE, 90.0, 32, 32)


NEAR = {
    "position by 0.001 m: (0, 0, 1.5) recorded, (0.001, 0, 1.5) requested": View(
        Pose((0.001, 0, 1.5), POSE.rotation), 90.0, 32, 32
    ),
    "position by 1e-06 m: (0, 0, 1.5) recorded, (0, 0, 1.500001) requested": View(
        Pose((0, 0, 1.500001), POSE.rotation), 90.0, 32, 32
    ),
    "orientation by 0.0001 deg of yaw, pitch, roll: (0, 0, 0) recorded, (0.0001, 0, 0) requested": View(
        Pose.from_angles((0, 0, 1.5), yaw_deg=1e-4), 90.0, 32, 32
    ),
    "field of view by 2e-06 deg: (90) recorded, (90.000002) requested": View(POSE, 90.000002, 32, 32),
    "size: 32 x 32 recorded, 32 x 31 px requested": View(POSE, 90.0, 32, 31),
}


@pytest.mark.parametrize("says", NEAR)
def test_a_missing_view_says_by_how_much_the_nearest_differs(says, recorded):
    with omniscv.open_source(recorded) as replay, pytest.raises(MissingCaptureError) as error:
        next(replay.capture([Request(NEAR[says], "lit")]))
    assert f"; the nearest recorded view differs in {says}; 'omniscv recording places " in str(error.value)


def test_views_turned_about_the_axis_cover_a_view(tmp_path):
    """As plugin 0.3.10 is recorded straight up and down; recorded in fewer modes they do not."""
    up = View(Pose.from_angles((0, 0, 1.5), pitch_deg=90), 90.0, 16, 16)
    half = View(Pose(up.pose.position, up.pose.rotation @ np.diag([-1.0, -1.0, 1.0])), 90.0, 16, 16)
    others = [
        View(Pose((0, 0.1, 1.5), half.pose.rotation), 90.0, 16, 16),
        View(half.pose, 91.0, 16, 16),
        View(half.pose, 90.0, 16, 8),
        View(Pose.from_angles((0, 0, 1.5), pitch_deg=89.99), 90.0, 16, 16),
    ]
    path = filled(tmp_path / "room.sqlite", [Request(view, "lit") for view in (up, half, *others)])
    with omniscv.open_source(path) as replay:
        assert replay.cover(up) == (up, half)
        assert replay.cover(half) == (half, up)
        assert replay.cover(others[0]) == (others[0],)
        assert replay.cover(VIEW) == (VIEW,)
    filled(path, [Request(up, "depth")])
    with omniscv.open_source(path) as replay:
        assert replay.cover(up) == (up,)


def calls_to_open(path):
    calls = Counter()
    sys.setprofile(lambda frame, event, _: calls.update([event]))
    try:
        source = omniscv.open_source(path)
    finally:
        sys.setprofile(None)
    source.close()
    return calls["call"]


def test_opening_reads_no_views(tmp_path):
    """A recording of 20,000 captures opens at once: a row costs its checksum, and nothing else."""
    path = filled(tmp_path / "room.sqlite", face_requests(4, ("lit",)))
    few = [calls_to_open(path) for _ in range(2)][-1]
    many = face_requests(4, ("lit",), (0.5, 0.0, 1.5)) + face_requests(4, ("lit",), (0.0, 0.5, 1.5))
    filled(path, many)
    assert calls_to_open(path) - few < 30 * len(many)


MODES = ("depth", "object_mask")
REQUESTS = [each for center in (CENTER, (-0.9, 0.4, 1.2)) for each in face_requests(64, MODES, center)]


def halved(capture):
    if capture.mode != "depth":
        return capture
    return replace(capture, pixels=capture.pixels.astype(np.float16).astype(np.float32), payload=None)


def record(scene, path, *stale):
    """Record twelve faces; of each stale request, the picture of the one before it."""
    with omniscv.open_source(f"scene://{scene}") as source, closing(Store(path, write=True)) as store:
        store.set_objects(source.objects())
        before = None
        for capture in map(halved, source.capture(REQUESTS)):
            old = capture.request in stale
            store.add(replace(capture, pixels=before.pixels, payload=None) if old else capture)
            before = capture
    return path


@pytest.mark.parametrize("scene", ["six-wall", "fence", "open"])
def test_captures_of_sound_scenes_do_not_contradict(scene, tmp_path):
    """Also where several views show nothing but sky, and half floats round depth."""
    assert verify(record(scene, tmp_path / "sound.sqlite")).faults == []


@pytest.mark.parametrize("mode", MODES)
def test_a_picture_from_before_is_a_fault(mode, tmp_path):
    """Not that of the first face of a centre, before which there is one of the other mode."""
    of_mode = [each for each in REQUESTS if each.mode == mode]
    faults = verify(record("four-wall", tmp_path / "stale.sqlite", of_mode[2], of_mode[9])).faults
    for fault, i in zip(faults, (2, 9), strict=True):
        own, before = (in_words(of_mode[j].view) for j in (i, i - 1))
        assert fault.endswith(f": {mode} of {own}: expected its own picture, got that of {before}")
