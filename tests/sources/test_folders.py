"""Recordings as folders and back; folders that other tools made; folders that are wrong."""

import json
import os

import numpy as np
import pytest
from support.faces import face_requests
from support.full_disk import largest_file
from support.recordings import contents, filled

import omniscv
from omniscv.errors import ArgumentError, BadReplyError, RecordingNotWritableError
from omniscv.pictures import png
from omniscv.sources.base import Request
from omniscv.sources.recording.folders import export, import_folder
from omniscv.sources.recording.store import Store


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


def test_instance_ids_and_tolerance_come_along(tmp_path):
    filled(tmp_path / "room.sqlite", face_requests(modes=("object_mask",)), "scene://four-wall?masks=ids")
    export(tmp_path / "room.sqlite", tmp_path / "faces")
    import_folder(tmp_path / "faces", tmp_path / "again.sqlite")
    before, after = contents(tmp_path / "room.sqlite"), contents(tmp_path / "again.sqlite")
    assert before == after
    assert (after[1].tolerance, len(after[1].ids)) == (0, 20)


def test_a_folder_that_holds_something_is_not_touched(recorded, tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(ArgumentError, match="empty or new folder"):
        export(recorded, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_depth_of_another_tool_that_is_no_surface(tmp_path):
    """0, NaN, 65504 and 1e10 m in captures.json, as in the pictures of other imports."""
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
    ("captures", "\xff", r"captures\.json: expected JSON"),
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
    """They would take the names of this scene's objects."""
    before = contents(copy)
    with pytest.raises(RecordingNotWritableError, match=says) as error:
        import_folder(folder_of(other, tmp_path, **changes), copy)
    assert len(str(error.value).splitlines()) == 1
    assert contents(copy) == before


def test_what_is_no_regular_file_is_left_alone(recorded, tmp_path):
    """A FIFO, a folder, a link to a device; a link to a file, or to none yet, is followed."""
    folder, fifo, null = folder_of(recorded, tmp_path), tmp_path / "fifo", tmp_path / "null"
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
