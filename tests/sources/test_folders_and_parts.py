"""Recordings joined and divided, and as folders: every capture stays as it was recorded, byte for byte."""

import json
import os
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
from omniscv.errors import (
    ArgumentError,
    BadReplyError,
    OmniscvError,
    RecordingError,
    RecordingNotWritableError,
)
from omniscv.geometry import R_LEVEL
from omniscv.importing.folders import export, import_folder
from omniscv.pictures import png
from omniscv.sources.base import Request
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
    new = tmp_path / "new.sqlite"
    there = tmp_path / "there.sqlite"
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


def test_a_folder_appears_whole_or_not_at_all(recorded, tmp_path):
    wanted = r"faces: expected to read or write it, got: File too large; free space there, and run again"
    with largest_file(2000), pytest.raises(RecordingNotWritableError, match=wanted):
        export(recorded, tmp_path / "faces")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "faces").mkdir()  # an empty one, in which somebody may be
    before = (tmp_path / "faces").stat().st_ino
    assert export(recorded, tmp_path / "faces") == 24
    assert (tmp_path / "faces").stat().st_ino == before
    assert list(tmp_path.iterdir()) == [tmp_path / "faces"]
    held = {path: path.stat() for path in (tmp_path / "faces").iterdir()}
    with pytest.raises(ArgumentError, match="empty or new folder"):
        export(recorded, tmp_path / "faces")
    assert {path: path.stat() for path in (tmp_path / "faces").iterdir()} == held


def test_instance_ids_and_tolerance_come_along(tmp_path):
    filled(tmp_path / "room.sqlite", face_requests(modes=("object_mask",)), "scene://four-wall?masks=ids")
    export(tmp_path / "room.sqlite", tmp_path / "faces")
    import_folder(tmp_path / "faces", tmp_path / "again.sqlite")
    before = contents(tmp_path / "room.sqlite")
    after = contents(tmp_path / "again.sqlite")
    assert before == after
    assert (after[1].tolerance, len(after[1].ids)) == (0, 20)


def test_depth_of_another_tool_that_is_no_surface(tmp_path):
    stored = np.array([[0, 1, np.nan, np.inf], [65504, 1e10, 0.5, 9]], np.float32)
    np.save(tmp_path / "a.npy", stored)
    view = {"position": [0, 0, 0], "fov_deg": 90, "width": 4, "height": 2}
    (tmp_path / "captures.json").write_text(json.dumps([{"file": "a.npy", "mode": "depth", "view": view}]))
    import_folder(tmp_path, tmp_path / "mine.sqlite")
    with omniscv.open_source(tmp_path / "mine.sqlite") as source:
        (capture,) = source.capture([Request(source.recorded_views()[0], "depth")])
    np.testing.assert_array_equal(capture.pixels, np.where(np.isin(stored, [1, 0.5, 9]), stored, np.inf))
    stored[1, 3] = -1
    np.save(tmp_path / "a.npy", stored)
    with pytest.raises(BadReplyError, match="expected depth of 0 or more, got 1 of 8"):
        import_folder(tmp_path, tmp_path / "other.sqlite")


VIEW = {"position": [0, 0, 0], "fov_deg": 90, "width": 4, "height": 4}
GOOD = {"file": "a.png", "mode": "lit", "view": VIEW}
REFUSED = [
    ("captures", None, r"captures\.json: expected"),
    ("captures", {}, r"captures\.json: expected a JSON list"),
    ("captures", [GOOD, []], r"captures\.json\[1\]: expected a mapping with file, mode, view"),
    ("captures", [GOOD | {"file": "../a.png"}], "file in the folder"),
    ("captures", [GOOD | {"file": "a.tiff"}], ".png or .npy"),
    ("captures", [GOOD | {"file": "none.png"}], "expected an image that can be read, got 'none.png'"),
    ("captures", [GOOD | {"file": "\ud800.png"}], r"captures\.json: expected texts of Unicode"),
    ("captures", [GOOD | {"mode": "beauty"}], "mode: expected one of lit.*got 'beauty'"),
    ("captures", [GOOD | {"mode": "depth"}], "depth"),
    ("captures", [GOOD | {"encoding": "pickle"}], "expected one of png"),
    ("captures", [GOOD | {"provenance": {"time": float("nan")}}], "expected JSON, got: 'NaN, which JSON"),
    ("captures", [GOOD, GOOD | {"view": {"position": [0, 0, 0]}}], r"\[1\]\.view: missing key 'fov_deg'"),
    ("captures", [GOOD | {"view": VIEW | {"width": 4.0}}], "whole number"),
    ("captures", [GOOD | {"view": VIEW | {"fov_deg": 180}}], "fov_deg"),
    ("captures", [GOOD | {"view": VIEW | {"width": 8}}], "expected a PNG of 8 x 4, got 8-bit 4 x 4"),
    ("captures", [GOOD | {"view": VIEW | {"position": [1e999, 0, 0]}}], "got: 'Infinity, which JSON"),
    ("captures", [GOOD | {"view": VIEW | {"yaw_deg": 9, "rotation": [[1, 0, 0]] * 3}}], "and angles"),
    ("captures", "[", r"captures\.json: expected JSON"),
    ("captures", "\xff", r"captures\.json: .*not UTF-8"),
    ("objects", {"a": [1, 2, 300]}, "a.*<= 255, got 300"),
    ("masks", {"tolerance": 3, "ids": {"a": 70000}}, "<= 65535, got 70000"),
    ("masks", {"tolerance": 3, "ids": {"b": 7}}, "expected objects of objects.json, got 'b'"),
]


@pytest.mark.parametrize(("file", "content", "says"), REFUSED)
def test_what_is_wrong_in_a_folder_is_one_short_line_and_nothing_is_written(file, content, says, tmp_path):
    folder = tmp_path / "f"
    folder.mkdir()
    (folder / "a.png").write_bytes(png.encode(np.zeros((4, 4, 3), np.uint8)))
    for name, data in {"captures": [GOOD], "objects": {"a": [1, 2, 3]}, file: content}.items():
        if data is not None:
            text = data if isinstance(data, str) else json.dumps(data)
            (folder / f"{name}.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(omniscv.OmniscvError, match=says) as error:
        import_folder(folder, tmp_path / "out.sqlite")
    text = str(error.value).replace(str(tmp_path), "")
    assert text.isprintable()
    assert len(text) <= 310
    assert [path.name for path in tmp_path.iterdir()] == ["f"]


def folder_of(path, tmp_path, **changes):
    """A recording as a folder, with other files in it; None removes one."""
    folder = tmp_path / f"folder-{path.stem}"
    export(path, folder)
    for name, data in changes.items():
        file = folder / f"{name}.json"
        file.unlink() if data is None else file.write_text(json.dumps(data))
    return folder


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({}, r"scene 'four-wall'.*got 'six-wall'"),
        ({"scene": {}}, r"expected the mask colours of its object masks, but .* is \("),
        ({"scene": {}, "objects": None}, r"expected object masks with an object table both in"),
    ],
)
def test_masks_of_another_scene_are_not_added(changes, says, other, copy, tmp_path):
    before = contents(copy)
    with pytest.raises(RecordingNotWritableError, match=says) as error:
        import_folder(folder_of(other, tmp_path, **changes), copy)
    assert len(str(error.value).splitlines()) == 1
    assert contents(copy) == before


def test_what_is_no_regular_file_is_left_alone(recorded, tmp_path):
    folder = folder_of(recorded, tmp_path)
    fifo = tmp_path / "fifo"
    null = tmp_path / "null"
    os.mkfifo(fifo)
    null.symlink_to(os.devnull)
    for path, what in ((fifo, "a device, a FIFO"), (tmp_path, "a folder"), (null, "a device")):
        kind = path.stat().st_mode
        for write in (lambda path: import_folder(folder, path), lambda path: Store(path, write=True)):
            with pytest.raises(RecordingNotWritableError, match=f"or a free name, got {what}"):
                write(path)
        assert path.stat().st_mode == kind
    assert null.is_symlink()
    for name, target in (("empty", tmp_path / "empty.sqlite"), ("dangling", tmp_path / "none.sqlite")):
        if name == "empty":
            target.touch()
        (tmp_path / name).symlink_to(target)
        import_folder(folder, tmp_path / name)
        assert (tmp_path / name).is_symlink()
        assert contents(target) == contents(recorded)
