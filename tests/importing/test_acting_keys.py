"""Keys of files that change what is seen act, or are refused by name; the user's own words come first."""

import json

import numpy as np
import pytest
from PIL import Image

import omniscv
from omniscv import calibration
from omniscv.errors import ArgumentError
from omniscv.importing.posed_frames import Options
from omniscv.importing.sequences import find_sequence

W, H = 64, 48
UPRIGHT = [[0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 0, 1]]
PLAIN = {"w": W, "h": H, "fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24}
ANGLE = 2 * np.arctan(W / 2 / 60)
K = [[60, 0, 32], [0, 60, 24], [0, 0, 1]]


@pytest.fixture
def folder(tmp_path):
    Image.new("RGB", (W, H), (90, 120, 30)).save(tmp_path / "a.png")
    return tmp_path


def frame(folder, shared, options=None, **of_frame):
    entry = {"file_path": "a.png", "transform_matrix": UPRIGHT, **of_frame}
    (folder / "transforms.json").write_text(json.dumps({**shared, "frames": [entry]}))
    return find_sequence(folder, "nerfstudio", options or Options()).frames[0]


REFUSED = {
    "x_fov": ({"x_fov": 70.0}, "camera_angle_x: expected 60, as fl_x says, got 45.7"),
    "y_fov": ({"y_fov": 30.0}, "camera_angle_y: expected 60, as fl_y says"),
    "camera_angle_x": ({"camera_angle_x": 1.01 * ANGLE}, "camera_angle_x: expected 60, as fl_x says"),
    "f-theta": ({"ftheta_p0": 0, "ftheta_p1": 0.001}, "ftheta_p1: expected no such key"),
    "latlong": ({"latlong": True}, "latlong: expected no such key"),
    "equirectangular": ({"equirectangular": True}, "equirectangular: expected no such key"),
    "intrinsic_matrix": ({"intrinsic_matrix": np.diag([61, 60, 1]).tolist()}, "fx of intrinsic_matrix"),
    "K": ({"K": [[60, 0, 33], [0, 60, 24], [0, 0, 1]]}, "cx of K: expected 32, as cx says, got 33"),
    "focal_length": ({"focal_length": 50}, "focal_length: expected no such key"),
    "is_fisheye": ({"is_fisheye": True, "camera_model": "PINHOLE"}, "is_fisheye: expected what camera_model"),
    "camera_convention": ({"camera_convention": "opencv"}, "camera_convention: expected opengl"),
    "from_na": ({"from_na": True}, "from_na: expected no such key"),
    "c2w": ({"c2w": UPRIGHT}, "c2w: expected no such key"),
    "depth_unit": ({"depth_unit_scale_factor": 0.01}, "depth_unit_scale_factor: expected no such key"),
    "width": ({"width": 2 * W}, "width: expected 64, as w says"),
    "another mask": ({"dynamic_mask_path": "m.png"}, "dynamic_mask_path: expected no such key"),
    "time offset": ({"time_offset": 0.1}, "time_offset: expected no such key"),
    "rolling shutter": ({"rolling_shutter": [0, 0, 0.1, 0]}, "rolling_shutter: expected no such key"),
}


@pytest.mark.parametrize("of_frame", [False, True], ids=["of the file", "of a frame"])
@pytest.mark.parametrize(("keys", "says"), REFUSED.values(), ids=REFUSED)
def test_keys_that_contradict_or_do_not_act_are_refused_by_name(keys, says, of_frame, folder):
    shared, own = ({}, PLAIN | keys) if of_frame else (PLAIN | keys, {})
    with pytest.raises(ArgumentError, match=says) as refusal:
        frame(folder, shared, **own)
    assert "\n" not in str(refusal.value)


PASSING = {
    "other statements that agree": {"camera_angle_x": ANGLE, "x_fov": np.degrees(ANGLE), "K": K, "width": W},
    "a word for its own axes": {"camera_convention": "OpenGL"},
    "no fisheye": {"is_fisheye": False, "latlong": False},
    "keys that change nothing": {
        "aabb_scale": 16,
        "scale": 0.33,
        "offset": [0.5, 0.5, 0.5],
        "applied_transform": UPRIGHT[:3],
        "applied_scale": 2.0,
        "orientation_override": "none",
        "ply_file_path": "points.ply",
        "timestamp": 3.5,
        "rotation": 0.0125,
        "colmap_im_id": 3,
        "sharpness": 40.0,
        "train_filenames": ["a.png"],
        "up": [0, 0, 1],
    },
}


@pytest.mark.parametrize("of_frame", [False, True], ids=["of the file", "of a frame"])
@pytest.mark.parametrize("keys", PASSING.values(), ids=PASSING)
def test_keys_that_agree_or_change_nothing_pass(keys, of_frame, folder):
    shared, own = ({}, PLAIN | keys) if of_frame else (PLAIN | keys, {})
    result = frame(folder, shared, **own)
    np.testing.assert_allclose(result.lens[:4], (60, 60, 32, 24))


def test_fields_of_view_in_degrees_act_as_in_instant_ngp(folder):
    lens = frame(folder, {"w": W, "h": H, "x_fov": 90.0, "y_fov": 60.0}).lens
    np.testing.assert_allclose(lens[:2], (W / 2, H / 2 / np.tan(np.radians(30))))


def test_a_frame_with_a_lens_of_its_own_is_not_measured_by_that_of_the_file(folder):
    lens = frame(folder, {"w": W, "h": H, "camera_angle_x": 1.0}, fl_x=60, fl_y=60).lens
    np.testing.assert_allclose(lens[:2], 60)


def test_a_lens_file_of_the_user_comes_before_the_files_own(folder):
    camera = omniscv.cameras.create("pinhole", W, H, fx=50, fy=51, cx=32, cy=24)
    calibration.save(folder / "lens.json", {"cam0": camera}, "json")
    options = Options(intrinsics=folder / "lens.json")
    assert frame(folder, {**PLAIN, "camera_angle_x": 3.0}, options).lens[:2] == (50, 51)
    lines = find_sequence(folder, "nerfstudio", options).lines()
    assert any("lens of lens.json, as --intrinsics says" in line for line in lines)
    with pytest.raises(ArgumentError, match="camera_convention: expected opengl"):
        frame(folder, {**PLAIN, "camera_convention": "opencv"}, options)  # it says nothing of the lens


def test_poses_of_the_user_come_before_the_files_own(folder):
    (folder / "poses.csv").write_text("name,x,y,z,yaw_deg\na.png,1,2,3,90\n")
    scaled = (0.01 * np.array(UPRIGHT)).tolist()  # it would be refused
    options = Options(poses=folder / "poses.csv")
    pose = frame(folder, PLAIN, options, transform_matrix=scaled).pose
    np.testing.assert_allclose(pose.position, (1, 2, 3))
    np.testing.assert_allclose(pose.angles(), (90, 0, 0), atol=1e-9)
    lines = find_sequence(folder, "nerfstudio", options).lines()
    assert any("poses of poses.csv, as --poses says" in line for line in lines)
    (folder / "poses.csv").write_text("name,x,y,z\nb.png,1,2,3\n")
    with pytest.raises(ArgumentError, match=r"poses\.csv: expected a pose of 'a\.png'"):
        frame(folder, PLAIN, options)


KALIBR = """
cam0:
  camera_model: pinhole
  distortion_model: none
  distortion_coeffs: []
  intrinsics: [60, 60, 32, 24]
  resolution: [64, 48]
  rostopic: /cam0
  cam_overlaps: [1]
  T_cam_imu: [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("T_imu_cam: [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]", "two that differ"),
        ("timeshift_imu_cam: 0.02", "timeshift_imu_cam: expected no such key"),
        ("focal_length: 60", "focal_length: expected no such key"),
        ("pose_unit: mm", "pose_unit: expected no such key"),
    ],
)
def test_a_camera_chain_of_kalibr_is_held_to_the_same(line, says):
    assert calibration.loads(KALIBR)["cam0"].fx == 60
    with pytest.raises(ArgumentError, match=says):
        calibration.loads(f"{KALIBR}  {line}\n")


def test_two_poses_of_kalibr_that_agree_pass():
    inverse = "T_imu_cam: [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    assert calibration.loads(f"{KALIBR}  {inverse}\n")["cam0"].fx == 60
