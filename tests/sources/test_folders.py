"""Recordings as folders and back; folders that other tools made; folders that are wrong."""

import json
import os

import numpy as np
import pytest
from support.faces import face_requests
from support.full_disk import largest_file
from support.recordings import contents

import omniscv
from omniscv.errors import ArgumentError, RecordingNotWritableError
from omniscv.geometry import Pose
from omniscv.sources.recording.folders import export, import_folder
from omniscv.sources.recording.store import Store


def test_there_and_back_loses_nothing(recorded, tmp_path):
    assert export(recorded, tmp_path / "faces") == 24
    assert import_folder(tmp_path / "faces", tmp_path / "again.sqlite") == 24
    assert contents(tmp_path / "again.sqlite") == contents(recorded)


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
    with (
        omniscv.open_source("scene://four-wall?masks=ids") as scene,
        omniscv.record(scene, tmp_path / "room.sqlite") as source,
    ):
        source.objects()
        list(source.capture(face_requests(modes=("object_mask",))))
    export(tmp_path / "room.sqlite", tmp_path / "faces")
    import_folder(tmp_path / "faces", tmp_path / "again.sqlite")
    before, after = contents(tmp_path / "room.sqlite"), contents(tmp_path / "again.sqlite")
    assert before == after
    assert (after[1].tolerance, len(after[1].ids)) == (0, 20)


def test_a_recording_with_other_mask_colours_is_not_added_to(recorded, copy, tmp_path):
    export(recorded, tmp_path / "faces")
    colors = json.loads((tmp_path / "faces" / "objects.json").read_text())
    colors["Sofa"] = [9, 9, 9]
    (tmp_path / "faces" / "objects.json").write_text(json.dumps(colors))
    before = contents(copy)
    with pytest.raises(RecordingNotWritableError, match=r"'Sofa' is \(9, 9, 9\) and was \("):
        import_folder(tmp_path / "faces", copy)
    assert contents(copy) == before


def test_a_folder_that_holds_something_is_not_touched(recorded, tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(ArgumentError, match="empty or new folder"):
        export(recorded, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_faces_of_another_tool_can_be_composed(tmp_path):
    """Six float faces whose colour is the ray, written by hand as the documentation says."""
    folder, size = tmp_path / "faces", 64
    folder.mkdir()
    entries = []
    for i, (yaw, pitch) in enumerate([(0, 0), (90, 0), (180, 0), (270, 0), (0, 90), (0, -90)]):
        x = (np.arange(size) + 0.5) / (size / 2) - 1
        rays_c = np.stack([*np.meshgrid(x, x), np.ones((size, size))], axis=-1)
        R_w_c = Pose.from_angles((0, 0, 0), yaw_deg=yaw, pitch_deg=pitch).R_w_c
        colors = rays_c @ R_w_c.T / np.linalg.norm(rays_c, axis=-1, keepdims=True)
        np.save(folder / f"{i}.npy", colors.astype(np.float32))
        view = {"position": [1, 2, 3], "yaw_deg": yaw, "pitch_deg": pitch, "fov_deg": 90}
        entries.append({"file": f"{i}.npy", "mode": "lit", "view": {**view, "width": size, "height": size}})
    (folder / "captures.json").write_text(json.dumps(entries))
    import_folder(folder, tmp_path / "mine.sqlite")
    camera = omniscv.cameras.create("equirectangular", width=64, height=32)
    pose = Pose.from_angles((1, 2, 3), yaw_deg=33, pitch_deg=20)
    with omniscv.open_source(tmp_path / "mine.sqlite") as source:
        image = omniscv.render(camera, pose, source, face_size=size, filter="bilinear")
    rays_w = camera.unproject().directions @ pose.R_w_c.T
    # 64 px faces, bilinear: half a pixel is 1/64; a curve of the sphere within a pixel is 1/8 of its square
    assert np.abs(image.lit - rays_w).max() < 1 / 64


GOOD = {
    "file": "a.png",
    "mode": "lit",
    "view": {"position": [0, 0, 0], "fov_deg": 90, "width": 4, "height": 4},
}


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ([], r"captures\.json\[1\]: expected a mapping with file, mode, view"),
        ({**GOOD, "file": "../a.png"}, "file in the folder"),
        ({**GOOD, "file": "a.tiff"}, ".png or .npy"),
        ({**GOOD, "mode": "beauty"}, "mode: expected one of lit.*got 'beauty'"),
        ({**GOOD, "view": {**GOOD["view"], "width": 4.0}}, "whole number"),
        ({**GOOD, "view": {"position": [0, 0]}}, r"captures\.json\[1\]\.view: missing key 'fov_deg'"),
        ({**GOOD, "view": {**GOOD["view"], "fov_deg": 180}}, "fov_deg"),
        ({**GOOD, "view": {**GOOD["view"], "width": 8}}, "expected a PNG of 8 x 4, got 8-bit 4 x 4"),
        ({**GOOD, "file": "none.png"}, "expected an image that can be read, got 'none.png'"),
        ({**GOOD, "mode": "depth"}, "depth"),
        ({**GOOD, "encoding": "pickle"}, "expected one of png"),
    ],
)
def test_a_wrong_entry_is_named_and_nothing_is_written(entry, says, tmp_path):
    import cv2

    folder = tmp_path / "faces"
    folder.mkdir()
    cv2.imwrite(str(folder / "a.png"), np.zeros((4, 4, 3), np.uint8))
    (folder / "captures.json").write_text(json.dumps([GOOD, entry]))
    with pytest.raises(omniscv.OmniscvError, match=says):
        import_folder(folder, tmp_path / "out.sqlite")
    assert not (tmp_path / "out.sqlite").exists()


def test_an_import_is_all_or_nothing(recorded, copy, tmp_path):
    """The last entry is wrong: neither an old file is changed nor a new one created."""
    folder = tmp_path / "faces"
    export(recorded, folder)
    entries = json.loads((folder / "captures.json").read_text())
    entries[-1]["view"]["width"] = 8.0
    (folder / "captures.json").write_text(json.dumps(entries))
    before = copy.read_bytes()
    for path in (copy, tmp_path / "new" / "room.sqlite"):
        with pytest.raises(ArgumentError, match="whole number"):
            import_folder(folder, path)
    assert copy.read_bytes() == before
    assert not (tmp_path / "new").exists()


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
        ({"scene": {}}, r"expected the mask colours of its object masks|tolerance"),
        ({"scene": {}, "objects": None}, r"expected object masks with an object table both in"),
    ],
)
def test_masks_of_another_scene_are_not_added(changes, says, copy, tmp_path):
    """They would take the names of this scene's objects."""
    other = tmp_path / "other.sqlite"
    with omniscv.open_source("mock://six-wall") as live, omniscv.record(live, other) as source:
        list(source.capture(face_requests(modes=("object_mask",), center=(0.3, 0.0, 1.5))))
    before = contents(copy)
    with pytest.raises(RecordingNotWritableError, match=says) as error:
        import_folder(folder_of(other, tmp_path, **changes), copy)
    assert len(str(error.value).splitlines()) == 1
    assert contents(copy) == before


def test_masks_without_names_do_not_take_those_of_a_recording(recorded, tmp_path):
    """The recording has no masks yet, but a table."""
    path = tmp_path / "room.sqlite"
    with omniscv.open_source("mock://four-wall") as live, omniscv.record(live, path) as source:
        source.objects()
        list(source.capture(face_requests(modes=("lit",))))
    with pytest.raises(
        RecordingNotWritableError, match=r"expected object masks with an object table both in"
    ):
        import_folder(folder_of(recorded, tmp_path, objects=None), path)


def test_what_is_no_regular_file_is_left_alone(recorded, tmp_path):
    """A FIFO, a folder, a link to a device; a link to a file, or to none yet, is followed."""
    folder, fifo, null = folder_of(recorded, tmp_path), tmp_path / "fifo", tmp_path / "null"
    os.mkfifo(fifo)
    null.symlink_to(os.devnull)
    for path, what in ((fifo, "a device, a FIFO"), (tmp_path, "a folder"), (null, "a device")):
        kind = path.stat().st_mode
        for write in (lambda path: import_folder(folder, path), lambda path: Store(path, write=True)):
            with pytest.raises(
                RecordingNotWritableError, match=f"expected a file or a free name, got {what}"
            ):
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


@pytest.mark.parametrize(
    ("file", "data"),
    [
        ("captures", [{**GOOD, "provenance": "me"}]),
        ("captures", [{**GOOD, "provenance": {"time": float("nan")}}]),
        ("captures", [{**GOOD, "file": "\ud800.png"}]),
        ("captures", [{**GOOD, "mode": "\x1b[31m" * 1000}]),
        ("captures", [{**GOOD, "view": {**GOOD["view"], "position": [1e999, 0, 0]}}]),
        ("objects", {"a": [1, 2, 300]}),
        ("masks", {"tolerance": 3, "ids": {"a": 70000}}),
        ("masks", {"tolerance": 3, "ids": {"b": 7}}),
        ("scene", {"title": "x"}),
    ],
)
def test_anything_wrong_in_a_folder_is_one_short_line(file, data, tmp_path):
    import cv2

    folder = tmp_path / "f"
    folder.mkdir()
    cv2.imwrite(str(folder / "a.png"), np.zeros((4, 4, 3), np.uint8))
    files = {"captures": [GOOD], "objects": {"a": [1, 2, 3]}, file: data}
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    with pytest.raises(omniscv.OmniscvError) as error:
        import_folder(folder, tmp_path / "out.sqlite")
    text = str(error.value).replace(str(tmp_path), "")
    assert text.isprintable()
    assert len(text) <= 300
    assert sorted(path.name for path in tmp_path.iterdir()) == ["f"]


@pytest.mark.parametrize("index", [None, "{}", "[", "\xff"])
def test_a_folder_without_a_good_index_is_refused(index, tmp_path):
    if index is not None:
        (tmp_path / "captures.json").write_text(index, encoding="latin-1")
    with pytest.raises(ArgumentError, match=r"captures\.json: expected"):
        import_folder(tmp_path, tmp_path / "out.sqlite")
    assert not (tmp_path / "out.sqlite").exists()
