"""Recordings joined and divided: every capture stays as it was recorded, byte for byte."""

import shutil
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from support.faces import face_requests
from support.full_disk import largest_file
from support.recorder import SMALL, STATES
from support.recorder import requests as requests_in
from support.recordings import contents, filled, provenances

import omniscv
from omniscv.errors import ArgumentError, OmniscvError, RecordingError, RecordingNotWritableError
from omniscv.geometry import R_LEVEL
from omniscv.sources.recording import merge, part_file, split
from omniscv.sources.recording.inspection import verify
from omniscv.sources.recording.store import Store

REQUESTS = face_requests(size=16, modes=("lit", "object_mask", "depth"))
REQUESTS += face_requests(size=16, modes=("lit", "depth"), center=(1.5, 0.2, 1.4))
CAMERA = omniscv.cameras.create("equirectangular", width=32, height=16)
PLACES = ((0.0, 0.0, 1.5), (1.5, 0.2, 1.4))


def test_where_there_is_no_space_the_result_is_named(tmp_path):
    room = filled(tmp_path / "room.sqlite", REQUESTS)
    with largest_file(1 << 15), pytest.raises(RecordingNotWritableError) as raised:
        merge(tmp_path / "all.sqlite", [room])
    assert str(raised.value).startswith(f"{tmp_path / 'all.sqlite'}: expected a file that can be written")
    assert list(tmp_path.iterdir()) == [room]


def record_states(path, states):
    with omniscv.open_source("scene://workshop") as scene, omniscv.record(scene, path) as source:
        for instant in states:
            list(source.at(instant).capture(requests_in(SMALL, instant.state)[5:25:6]))
    return path


def known(path):
    with closing(Store(path)) as store:
        states = {name: each.instant and each.instant.to_dict() for name, each in store.states().items()}
        return *contents(path), store.geometry().to_dict(), store.scene_identity, states


def rendered(path, place=PLACES[0]):
    with omniscv.open_source(path) as source:
        image = omniscv.render(CAMERA, omniscv.Pose(place, R_LEVEL), source, ("lit", "depth"), face_size=16)
        return image.lit.tobytes(), image.depth.tobytes(), source.objects()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return filled(tmp_path_factory.mktemp("whole") / "room.sqlite", REQUESTS)


@pytest.mark.parametrize("seed", [0, pytest.param(range(1, 200), marks=pytest.mark.soak)])
def test_any_division_merges_into_what_one_recorder_writes(whole, tmp_path, seed):
    for each in np.atleast_1d(seed):
        draw = np.random.default_rng(each)
        folder = tmp_path / str(each)
        folder.mkdir()
        check_division(whole, folder, draw.integers(0, 3, len(REQUESTS)), draw.permutation(3))


def check_division(whole, folder, owners, order):
    files = [part_file(folder / "room.sqlite", i, 3) for i in range(3)]
    for part, file in enumerate(files):
        filled(file, [each for each, owner in zip(REQUESTS, owners, strict=True) if owner == part])
    out = folder / "room.sqlite"
    assert merge(out, [files[part] for part in order]) == len(REQUESTS)
    assert known(out) == known(whole)
    assert sorted(map(str, provenances(out))) == sorted(map(str, provenances(whole)))
    assert verify(out).ok
    assert rendered(out) == rendered(whole)
    assert merge(out, files) == 0  # what is there stays, and nothing comes twice
    assert known(out) == known(whole)


def test_states_merge(tmp_path):
    first = record_states(tmp_path / "first.sqlite", STATES[:2])
    second = record_states(tmp_path / "second.sqlite", STATES[1:])
    whole = record_states(tmp_path / "whole.sqlite", STATES)
    out = tmp_path / "out.sqlite"
    merge(out, [first, second])
    assert known(out) == known(whole)


def _other_scene(store):
    with omniscv.open_source("scene://six-wall") as scene:
        store.set_scene(scene.scene_identity)
    return "expected captures of the scene 'four-wall'.*, got 'six-wall'"


def _other_dialect(store):
    capture = captured(REQUESTS[0])
    store.add(replace(capture, provenance={**capture.provenance, "dialect": "0.3.10"}))
    return "expected captures of dialect 'scene', as in those before, got '0.3.10'"


def _other_bytes(store):
    capture = captured(REQUESTS[-2])
    store.add(replace(capture, pixels=np.full_like(capture.pixels, 7), payload=None))
    return "expected the bytes that were recorded before of .* at .*; got others"


def _other_objects(store):
    with omniscv.open_source("scene://four-wall") as scene:
        table = scene.objects()
    first, second, *_ = table.names()
    store.set_objects(replace(table, colors={**table.colors, first: table.colors[second], second: (1, 2, 3)}))
    store.add(captured(next(request for request in REQUESTS if request.mode == "object_mask")))
    return "expected the mask colours of its object masks, but "


def _damaged(store):
    store.add(captured(REQUESTS[0]))
    row = next(iter(store.rows()))
    data = store.path.read_bytes()
    place = data.index(row.payload[:40]) + 30
    store.path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
    return "expected checksum "


def _nothing(store):
    store.path.write_bytes(b"no recording at all, but a text" * 100)
    return "expected a recording, got "


def captured(request):
    with omniscv.open_source("scene://four-wall") as scene:
        return next(scene.capture([request]))


@pytest.mark.parametrize(
    "make", [_other_scene, _other_dialect, _other_bytes, _other_objects, _damaged, _nothing]
)
def test_what_does_not_belong_is_refused_and_changes_nothing(make, whole, tmp_path):
    strange = tmp_path / "strange.sqlite"
    with closing(Store(strange, write=True)) as store:
        says = make(store)
    new, there = tmp_path / "new.sqlite", tmp_path / "there.sqlite"
    shutil.copyfile(whole, there)
    for out in (new, there):
        with pytest.raises(RecordingError, match=says) as raised:
            merge(out, [whole, strange])
        assert str(strange) in str(raised.value)
        assert len(str(raised.value)) <= 300
    assert known(there) == known(whole)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["strange.sqlite", "there.sqlite"]


def test_wrong_arguments(whole, tmp_path):
    for out, files in ((tmp_path / "out.sqlite", []), (whole, [whole])):
        with pytest.raises(ArgumentError, match="files: expected recordings"):
            merge(out, files)
    with pytest.raises(OmniscvError, match="nothing there"):
        merge(tmp_path / "out.sqlite", [tmp_path / "missing.sqlite"])


def test_each_place_replays_alone(whole, tmp_path):
    left = tmp_path / "places" / f".split-{'0' * 16}"  # by a process that was killed
    left.mkdir(parents=True)
    made = split(whole, tmp_path / "places")
    assert not left.exists()
    names = [name for name, _ in made]
    assert names == ["room.0.000,0.000,1.500.sqlite", "room.1.500,0.200,1.400.sqlite"]
    assert [count for _, count in made] == [18, 12]
    assert sorted(each.name for each in (tmp_path / "places").iterdir()) == names
    for name, place in zip(names, PLACES, strict=True):
        assert verify(tmp_path / "places" / name).ok
        assert rendered(tmp_path / "places" / name, place) == rendered(whole, place)
    merge(tmp_path / "again.sqlite", [tmp_path / "places" / name for name in names])
    assert known(tmp_path / "again.sqlite") == known(whole)
    with pytest.raises(ArgumentError, match="expected an empty or new folder"):
        split(whole, tmp_path / "places")


def test_near_places_are_one(whole, tmp_path):
    assert split(whole, tmp_path / "far", distance_m=2.0) == [("room.0.000,0.000,1.500.sqlite", 30)]
    assert contents(tmp_path / "far" / "room.0.000,0.000,1.500.sqlite") == contents(whole)


def test_states_stay_with_their_place(tmp_path):
    moving = record_states(tmp_path / "moving.sqlite", STATES)
    ((name, _),) = split(moving, tmp_path / "places")
    assert known(tmp_path / "places" / name) == known(moving)


def test_names_of_parts():
    assert part_file("s3://bucket/rooms/room.sqlite", 0, 2) == "s3://bucket/rooms/room.part-0-of-2.sqlite"
    assert part_file("a.b/room", 1, 2) == "a.b/room.part-1-of-2"
    for index, count in ((2, 2), (-1, 2), (0, 0)):
        with pytest.raises(ArgumentError, match="part: expected a whole number"):
            part_file("room.sqlite", index, count)
