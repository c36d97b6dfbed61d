"""Recordings as folders and back; folders that other tools made; folders that are wrong."""

import json

import numpy as np
import pytest
from support.faces import face_requests
from support.recordings import contents

import omniscv
from omniscv.errors import ArgumentError, RecordingNotWritableError
from omniscv.geometry import Pose
from omniscv.sources.recording.folders import export, import_folder


def test_there_and_back_loses_nothing(recorded, tmp_path):
    assert export(recorded, tmp_path / "faces") == 24
    assert import_folder(tmp_path / "faces", tmp_path / "again.sqlite") == 24
    assert contents(tmp_path / "again.sqlite") == contents(recorded)


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
        ([], "expected 'file', 'mode' and 'view'"),
        ({**GOOD, "file": "../a.png"}, "file in the folder"),
        ({**GOOD, "file": "a.tiff"}, ".png or .npy"),
        ({**GOOD, "mode": "beauty"}, "mode: expected one of lit.*got 'beauty'"),
        ({**GOOD, "view": {**GOOD["view"], "width": 4.0}}, "whole numbers"),
        ({**GOOD, "view": {"position": [0, 0]}}, "expected a view"),
        ({**GOOD, "view": {**GOOD["view"], "fov_deg": 180}}, "fov_deg"),
        ({**GOOD, "view": {**GOOD["view"], "width": 8}}, "expected an 8-bit PNG of 8 x 4, got 8-bit 4 x 4"),
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


@pytest.mark.parametrize("index", [None, "{}", "[", "\xff"])
def test_a_folder_without_a_good_index_is_refused(index, tmp_path):
    if index is not None:
        (tmp_path / "captures.json").write_text(index, encoding="latin-1")
    with pytest.raises(ArgumentError, match=r"captures\.json: expected"):
        import_folder(tmp_path, tmp_path / "out.sqlite")
    assert not (tmp_path / "out.sqlite").exists()
