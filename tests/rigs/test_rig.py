"""Rigs: where their cameras are, standing and moving, and what describes them."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp
from support.cases import cases

from omniscv import Pose, Rig, RigCamera, cameras
from omniscv.errors import ArgumentError
from omniscv.geometry.trajectory import Trajectory, nanoseconds

LENS = cameras.create("fisheye-equidistant", width=24, height=24, fov_deg=190)
angles = st.floats(-180, 180)
places = st.lists(st.floats(-5, 5), min_size=3, max_size=3)
poses = st.builds(Pose.from_angles, places, angles, st.floats(-89, 89), angles)


@cases(15)
@given(poses, poses, places)
def test_camera_poses_are_rig_pose_times_mount(T_w_rig: Pose, T_rig_cam: Pose, p_cam: list[float]) -> None:
    pose = Rig({"a": RigCamera(LENS, T_rig_cam)}).poses(T_w_rig)["a"]
    np.testing.assert_allclose(pose.to_world(p_cam), T_w_rig.to_world(T_rig_cam.to_world(p_cam)), atol=1e-12)


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
@given(poses, poses, st.floats(-1, 1))
def test_rigs_come_back_from_json(one: Pose, other: Pose, offset: float) -> None:
    rig = Rig({"one": RigCamera(LENS, one), "other": RigCamera(LENS, other, offset)})
    again = Rig.from_dict(json.loads(json.dumps(rig.to_dict())))
    assert again.to_dict() == rig.to_dict()


@cases(15)
@given(poses, poses, poses)
def test_seen_from_another_camera_nothing_moves(T_w_rig: Pose, one: Pose, other: Pose) -> None:
    rig = Rig({"one": RigCamera(LENS, one), "other": RigCamera(LENS, other)})
    before = rig.poses(T_w_rig)
    after = rig.seen_from("other").poses(before["other"])
    for name in before:
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
