"""Rigs: where their cameras are, standing and moving; files, read by a reader of Kalibr's chains, too."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp
from support.cases import cases
from support.same_rays import assert_same_rig

from omniscv import Pose, Rig, RigCamera, calibration, cameras
from omniscv.calibration import colmap
from omniscv.calibration.files import loads_rig
from omniscv.calibration.kalibr import KALIBR
from omniscv.errors import ArgumentError
from omniscv.geometry.trajectory import Trajectory, nanoseconds

LENS = cameras.create("fisheye-equidistant", width=24, height=24, fov_deg=190)
angles = st.floats(-180, 180)
places = st.lists(st.floats(-5, 5), min_size=3, max_size=3)
poses = st.builds(Pose.from_angles, places, angles, st.floats(-89, 89), angles)


def test_angles_turn_a_camera_from_where_the_rig_looks() -> None:
    left = RigCamera.turned(LENS, position=(0, 0, 2), yaw_deg=90)
    rig = Rig({"ahead": RigCamera.turned(LENS), "left": left, "up": RigCamera.turned(LENS, pitch_deg=90)})
    level = rig.poses(Pose.from_angles((1, 2, 3)))  # looks along +X; left of it is +Y
    np.testing.assert_allclose(level["ahead"].R_w_c[:, 2], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(level["left"].R_w_c[:, 2], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(level["left"].t_w_c, [3, 2, 3], atol=1e-12)
    np.testing.assert_allclose(level["up"].R_w_c[:, 2], [0, 0, 1], atol=1e-12)


@cases(15)
@given(st.floats(-0.3, 0.3), st.floats(0, 2))
def test_time_offsets_move_cameras_along_the_trajectory(offset: float, time: float) -> None:
    turned = [Pose.from_angles((0, 0, 1.5)), Pose.from_angles((2, 0, 1.5), yaw_deg=90, pitch_deg=30)]
    turned.append(Pose.from_angles((2, 1, 1.5), yaw_deg=60))
    trajectory = Trajectory.timed(tuple(turned), (0.0, 1.0, 2.0))
    rig = Rig({"late": RigCamera(LENS, time_offset=offset), "prompt": RigCamera(LENS)})
    poses_now = rig.poses(trajectory, nanoseconds(time))
    slerp = Slerp([0, 1, 2], Rotation.from_matrix([pose.R_w_c for pose in turned]))
    for name, at in (("late", time + offset), ("prompt", time)):
        if 0 <= at <= 2:
            expected = [np.interp(at, [0, 1, 2], [pose.t_w_c[i] for pose in turned]) for i in range(3)]
            np.testing.assert_allclose(poses_now[name].t_w_c, expected, atol=5e-9)
            np.testing.assert_allclose(poses_now[name].R_w_c, slerp(at).as_matrix(), atol=5e-9)


def test_times_are_extrapolated_by_one_step_at_most() -> None:
    way = Trajectory.timed((Pose.from_angles((0, 0, 1)), Pose.from_angles((1, 0, 1))), (0.0, 1.0))
    late = Rig({"late": RigCamera(LENS, time_offset=0.25)})
    np.testing.assert_allclose(late.poses(way, 10**9)["late"].t_w_c, [1.25, 0, 1])
    with pytest.raises(ArgumentError, match=r"late: time: expected 0 to 1 s, or a step beyond, got 3.25"):
        late.poses(way, 3 * 10**9)
    with pytest.raises(ArgumentError, match="late: trajectory: expected poses with times"):
        late.poses(Trajectory(way.poses), 0)
    with pytest.raises(ArgumentError, match=r"late: time_ns: expected a whole number .* got None"):
        late.poses(way)


@cases(15)
@given(poses, poses, poses, st.floats(-1, 1))
def test_rigs_come_back_from_json_and_seen_from_another_camera_nothing_moves(
    T_w_rig: Pose, one: Pose, other: Pose, offset: float
) -> None:
    late = Rig({"one": RigCamera(LENS, one), "other": RigCamera(LENS, other, offset)})
    assert Rig.from_dict(json.loads(json.dumps(late.to_dict()))).to_dict() == late.to_dict()
    rig = Rig({"one": RigCamera(LENS, one), "other": RigCamera(LENS, other)})
    before = rig.poses(T_w_rig)
    after = rig.seen_from("other").poses(before["other"])
    for name, mount in (("one", one), ("other", other)):
        p_w = T_w_rig.to_world(mount.to_world((1, 2, 3)))
        np.testing.assert_allclose(before[name].to_world((1, 2, 3)), p_w, atol=1e-12)
        np.testing.assert_allclose(after[name].t_w_c, before[name].t_w_c, atol=1e-12)
        np.testing.assert_allclose(after[name].R_w_c, before[name].R_w_c, atol=1e-12)


CAMERA = {"model": "pinhole", "width": 4, "height": 3}


@pytest.mark.parametrize(
    ("data", "says"),
    [
        ({}, "missing key 'cameras'"),
        ({"cameras": {}}, "cameras: expected cameras by name"),
        ({"cameras": {"a": {}}}, r"cameras.a: missing key 'camera'"),
        ({"cameras": {"a": {"camera": {"model": "no"}}}}, r"cameras.a.camera: camera: expected one of"),
        ({"cameras": {"a": {"camera": CAMERA, "position": [1, 2]}}}, "position: expected 3 finite"),
        ({"cameras": {"a": {"camera": CAMERA, "rotation": [[1, 0, 0]] * 3}}}, "rotation: expected a right-"),
        ({"cameras": {"a": {"camera": CAMERA, "rotation": np.eye(3).tolist(), "yaw_deg": 1}}}, "got both"),
        ({"cameras": {"a": {"camera": CAMERA, "time_offset": "nan"}}}, "time_offset: expected a finite"),
        ({"cameras": {"a/b": {"camera": CAMERA}}}, "cameras: expected the start of a file name"),
    ],
)
def test_a_wrong_description_is_refused_in_one_line(data: dict[str, Any], says: str) -> None:
    with pytest.raises(ArgumentError, match=says) as caught:
        Rig.from_dict(data)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) <= 1000


FISHEYE = cameras.create("kannala-brandt", width=80, height=60, fx=25.0, fy=26.0, k=(0.01, -0.002, 0.0, 0.0))
SPHERE = cameras.create("equirectangular", width=64, height=32)
chains = st.lists(st.tuples(poses, st.floats(-0.1, 0.1)), min_size=1, max_size=4)


def rig_of(mounts: list[tuple[Pose, float]], lens: cameras.Camera = FISHEYE) -> Rig:
    rig = Rig({f"cam{i}": RigCamera(lens, pose, late) for i, (pose, late) in enumerate(mounts)})
    return rig.seen_from("cam0")


def kalibr_point(chain: dict, name: str, p_0: np.ndarray) -> np.ndarray:
    """A point of cam0's frame in another camera's, by the definition of ``T_cn_cnm1`` in Kalibr's reader."""
    p = np.append(p_0, 1.0)
    for i in range(1, int(name.removeprefix("cam")) + 1):
        p = np.array(chain[f"cam{i}"]["T_cn_cnm1"]) @ p
    return p[:3]


@cases(15)
@given(chains, places)
def test_a_chain_has_the_rigs_points_and_comes_back(
    mounts: list[tuple[Pose, float]], p_0: list[float]
) -> None:
    rig = rig_of(mounts)
    text = KALIBR.write(rig.cameras, rig=True)
    chain = yaml.safe_load(text)
    assert_same_rig(loads_rig(text), rig)
    assert list(chain) == list(rig.cameras)
    assert "T_cn_cnm1" not in chain["cam0"]
    for name, mounted in rig.cameras.items():
        theirs = kalibr_point(chain, name, np.array(p_0))
        np.testing.assert_allclose(theirs, mounted.pose.to_camera(p_0), rtol=0, atol=1e-12)
        assert chain[name].get("timeshift_cam_imu", 0.0) == mounted.time_offset


def test_a_rig_comes_back_from_colmaps_files(tmp_path: Path) -> None:
    mounted = {name: RigCamera.turned(FISHEYE, (0.02 * int(name), 0, 0), 90 * int(name)) for name in "1234"}
    rig = Rig({**mounted, "5": RigCamera.turned(SPHERE, (0, -0.1, 0), 45, 10, 5)}).seen_from("1")
    calibration.save_rig(tmp_path, rig, "colmap")
    assert_same_rig(calibration.load_rig(tmp_path), rig)


def test_what_rigs_txt_cannot_be_and_what_a_format_lacks_is_refused() -> None:
    two = "1 PINHOLE 8 6 5 5 4 3\n2 PINHOLE 8 6 5 5 4 3\n"
    for rigs, says in (
        ("1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 0 0 0\n2 1 CAMERA 1\n", "expected one line"),
        ("1 2 CAMERA 1 CAMERA 2 0\n", "expected HAS_POSE 1"),
        ("1 2 CAMERA 1 IMU 2 1 1 0 0 0 0 0 0\n", "expected each sensor a CAMERA"),
        ("1 2 CAMERA 1 CAMERA 2 1 0 0 0 0 0 0 0\n", "quaternion: expected one of length 1"),
        ("1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 0 0\n", "expected 7 finite"),
        ("1 3 CAMERA 1 CAMERA 2 1 1 0 0 0 0 0 0\n", "NUM_SENSORS: expected 2"),
    ):
        with pytest.raises(ArgumentError, match=says):
            colmap.rig_from_colmap(two, rigs)
    elsewhere = Rig({"cam0": RigCamera.turned(FISHEYE, yaw_deg=10)})
    with pytest.raises(ArgumentError, match=r"save rig.seen_from\('cam0'\)"):
        KALIBR.write(elsewhere.cameras, rig=True)
    with pytest.raises(ArgumentError, match=r"name: expected cam0, cam1"):
        KALIBR.write({"left": RigCamera(FISHEYE)}, rig=True)
    with pytest.raises(ArgumentError, match="2: time_offset: expected 0"):
        colmap.rig_to_colmap(Rig({"1": RigCamera(FISHEYE), "2": RigCamera(FISHEYE, time_offset=0.1)}))


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
