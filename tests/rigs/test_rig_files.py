"""Rigs in files, read back by ours and by a reader of Kalibr's chains that shares nothing with ours."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases
from support.same_rays import assert_same_rays

from omniscv import Pose, Rig, RigCamera, calibration, cameras
from omniscv.calibration import colmap
from omniscv.calibration.files import loads_rig
from omniscv.calibration.kalibr import KALIBR
from omniscv.errors import ArgumentError

LENS = cameras.create("kannala-brandt", width=80, height=60, fx=25.0, fy=26.0, k=(0.01, -0.002, 0.0, 0.0))
SPHERE = cameras.create("equirectangular", width=64, height=32)
angles = st.floats(-180, 180)
places = st.lists(st.floats(-2, 2), min_size=3, max_size=3)
poses = st.builds(Pose.from_angles, places, angles, st.floats(-89, 89), angles)
chains = st.lists(st.tuples(poses, st.floats(-0.1, 0.1)), min_size=1, max_size=4)


def rig_of(mounts: list[tuple[Pose, float]], lens: cameras.Camera = LENS) -> Rig:
    rig = Rig({f"cam{i}": RigCamera(lens, pose, late) for i, (pose, late) in enumerate(mounts)})
    return rig.seen_from("cam0")


def kalibr_point(chain: dict, name: str, p_0: np.ndarray) -> np.ndarray:
    """A point of cam0's frame in another camera's, by the definition of ``T_cn_cnm1`` in Kalibr's reader."""
    p = np.append(p_0, 1.0)
    for i in range(1, int(name.removeprefix("cam")) + 1):
        p = np.array(chain[f"cam{i}"]["T_cn_cnm1"]) @ p
    return p[:3]


def assert_same(again: Rig, rig: Rig) -> None:
    assert list(again.cameras) == list(rig.cameras)
    for name, mounted in rig.cameras.items():
        assert_same_rays(again.cameras[name].camera, mounted.camera)
        assert again.cameras[name].time_offset == mounted.time_offset
        np.testing.assert_allclose(again.cameras[name].pose.position, mounted.pose.position, atol=1e-12)
        np.testing.assert_allclose(again.cameras[name].pose.rotation, mounted.pose.rotation, atol=1e-12)


@cases(15)
@given(chains, places)
def test_a_chain_has_the_rigs_points_and_comes_back(
    mounts: list[tuple[Pose, float]], p_0: list[float]
) -> None:
    rig = rig_of(mounts)
    text = KALIBR.write(rig.cameras, rig=True)
    chain = yaml.safe_load(text)
    assert_same(loads_rig(text), rig)
    assert list(chain) == list(rig.cameras)
    assert "T_cn_cnm1" not in chain["cam0"]
    for name, mounted in rig.cameras.items():
        theirs = kalibr_point(chain, name, np.array(p_0))
        np.testing.assert_allclose(theirs, mounted.pose.to_camera(p_0), rtol=0, atol=1e-12)
        assert chain[name].get("timeshift_cam_imu", 0.0) == mounted.time_offset


def test_a_rig_comes_back_from_colmaps_files(tmp_path: Path) -> None:
    """That pycolmap reads them, ``tests/dataset/test_colmap_model.py`` tests."""
    mounted = {name: RigCamera.turned(LENS, (0.02 * int(name), 0, 0), 90 * int(name)) for name in "1234"}
    rig = Rig({**mounted, "5": RigCamera.turned(SPHERE, (0, -0.1, 0), 45, 10, 5)}).seen_from("1")
    calibration.save_rig(tmp_path, rig, "colmap")
    assert_same(calibration.load_rig(tmp_path), rig)


ONE = "1 PINHOLE 8 6 5 5 4 3\n2 PINHOLE 8 6 5 5 4 3\n"


@pytest.mark.parametrize(
    ("rigs", "says"),
    [
        ("", "expected one line"),
        ("1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 0 0 0\n2 1 CAMERA 1\n", "expected one line"),
        ("1 2 CAMERA 1 CAMERA 2 0\n", "expected HAS_POSE 1"),
        ("1 2 CAMERA 1 IMU 2 1 1 0 0 0 0 0 0\n", "expected each sensor a CAMERA"),
        ("1 2 CAMERA 1 CAMERA 2 1 0 0 0 0 0 0 0\n", "quaternion: expected one of length 1"),
        ("1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 0 0\n", "expected 7 finite"),
        ("1 3 CAMERA 1 CAMERA 2 1 1 0 0 0 0 0 0\n", "NUM_SENSORS: expected 2"),
    ],
)
def test_a_wrong_rigs_txt_is_refused(rigs: str, says: str) -> None:
    with pytest.raises(ArgumentError, match=says):
        colmap.rig_from_colmap(ONE, rigs)


def test_poses_and_times_that_a_format_lacks_are_refused() -> None:
    elsewhere = Rig({"cam0": RigCamera.turned(LENS, yaw_deg=10)})
    with pytest.raises(ArgumentError, match=r"save rig.seen_from\('cam0'\)"):
        KALIBR.write(elsewhere.cameras, rig=True)
    with pytest.raises(ArgumentError, match=r"name: expected cam0, cam1"):
        KALIBR.write({"left": RigCamera(LENS)}, rig=True)
    with pytest.raises(ArgumentError, match="2: time_offset: expected 0"):
        colmap.rig_to_colmap(Rig({"1": RigCamera(LENS), "2": RigCamera(LENS, time_offset=0.1)}))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("T_cn_cnm1", "T_cm_cnm1", "cam1: expected the pose of every camera"),
        ("[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0, 2.0]", "cam1.T_cn_cnm1: expected .* last row"),
        ("timeshift_cam_imu: 0.01", "timeshift_cam_imu: no", "cam1: timeshift_cam_imu: expected a finite"),
        ("cam1:", "cam2:", "cam2: expected the pose of every camera"),
    ],
)
def test_a_wrong_chain_is_refused(old: str, new: str, says: str) -> None:
    rig = rig_of([(Pose.from_angles((0, 0, 0)), 0.0), (Pose.from_angles((0.1, 0, 0), 20), 0.01)])
    text = KALIBR.write(rig.cameras, rig=True)
    assert old in text
    with pytest.raises(ArgumentError, match=says):
        loads_rig(text.replace(old, new))
