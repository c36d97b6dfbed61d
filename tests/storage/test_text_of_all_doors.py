"""Text comes in as editors and spreadsheets save it, at every door: UTF-8, or UTF-16 with a mark."""

import json

import numpy as np
import pytest
from PIL import Image

from omniscv import calibration
from omniscv.geometry.trajectory_files import read_trajectory
from omniscv.importing.folders import import_folder
from omniscv.importing.posed_frames import Options, objects_of
from omniscv.importing.sequences import find_sequence
from omniscv.job import load

ENCODINGS = ["utf-8", "utf-8-sig", "utf-16", "utf-16-be with a mark"]
VIEW = {"position": [1, 2, 3], "fov_deg": 90, "width": 4, "height": 4}
LENS = {
    "fl_x": 60,
    "w": 8,
    "h": 4,
    "frames": [{"file_path": "é.png", "transform_matrix": np.eye(4).tolist()}],
}
MINE = "pictures: latlong\nplace: '(?P<i>.+)\\.png'\nlit: '{i}.png'\nposition: [1, 2, 3]\n"
CHAIN = "cam0:\n  camera_model: pinhole\n  intrinsics: [60, 60, 32, 24]\n  distortion_model: none\n" \
        "  distortion_coeffs: []\n  resolution: [64, 48]\n"  # fmt: skip
JOB = "source: scene://four-wall\ncameras: {a: {model: equirectangular, width: 8, height: 4}}\n" \
      "poses: [{position: [1, 2, 3], place: é}]\nout: out\n"  # fmt: skip


@pytest.fixture(params=ENCODINGS)
def write(request, tmp_path):
    """A function that saves a text in a folder beside a picture."""
    Image.new("RGB", (8, 4)).save(tmp_path / "é.png")

    def save(name, text):
        if request.param == "utf-16-be with a mark":
            data = b"\xfe\xff" + text.encode("utf-16-be")
        else:
            data = text.encode(request.param)
        (tmp_path / name).write_bytes(data)
        return tmp_path / name

    return save


def of_poses(file):
    (frame,) = find_sequence(file.parent, "latlong", Options(poses=file)).frames
    return frame.pose.position


def test_poses(write):
    rows = "name,x,y,z\né.png,1,2,3\n"
    np.testing.assert_array_equal(of_poses(write("p.csv", rows)), (1, 2, 3))
    np.testing.assert_array_equal(of_poses(write("p.json", '{"é.png": {"position": [1, 2, 3]}}')), (1, 2, 3))


def test_trajectories(write):
    for text in ("x,y,z\n1,2,3\n", "0 1 2 3 0 0 0 1\n"):
        np.testing.assert_array_equal(read_trajectory(write("p.txt", text))[0].position, (1, 2, 3))


def test_names_of_objects(write):
    assert objects_of(write("names.json", '["nothing", "Café"]')).ids["Café"] == 1


def test_layouts_and_transforms(write, tmp_path):
    layout = write("my.yaml", MINE)
    assert len(find_sequence(tmp_path, str(layout), Options()).frames) == 1
    write("transforms.json", json.dumps(LENS, ensure_ascii=False))
    assert len(find_sequence(tmp_path, "nerfstudio", Options()).frames) == 1


def test_captures(write, tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((4, 4, 3), np.uint8))
    write("captures.json", json.dumps([{"file": "a.npy", "mode": "lit", "view": VIEW}]))
    assert import_folder(tmp_path, tmp_path / "a.sqlite") == 1


def test_lens_files_and_jobs(write):
    assert calibration.load(write("chain.yaml", CHAIN))["cam0"].fx == 60
    np.testing.assert_array_equal(load(write("job.yaml", JOB)).poses[0].position, (1, 2, 3))
