"""Trajectories of datasets, as evo reads them."""

import numpy as np
import pytest
from evo.tools import file_interface
from support.traced_frames import black_frame

from omniscv import Pose, cameras
from omniscv.dataset import get
from omniscv.errors import ArgumentError

CAMERA = cameras.create("equirectangular", width=4, height=2)
POSES = [Pose.from_angles((i, 0.1 * i, 1.5), 10 * i, i, -i) for i in range(4)]


def frames(folder, names=("left", "right"), times=None):
    return [
        black_frame(folder, CAMERA, pose, name, f"{name}-{i}", time=times and times[i])
        for i, pose in enumerate(POSES) for name in names
    ]  # fmt: skip


def matrices(poses):
    return [np.vstack([np.column_stack([p.rotation, p.position]), [0, 0, 0, 1]]) for p in poses]


def test_each_camera_has_a_trajectory_in_every_format(tmp_path):
    times = [0.5, 1.0, 1.25, 3.0]
    written = get("poses").export(frames(tmp_path, times=times), tmp_path, {})
    assert len(written) == 2 * 5
    for name in ("left", "right"):
        tum = file_interface.read_tum_trajectory_file(tmp_path / f"{name}.tum")
        euroc = file_interface.read_euroc_csv_trajectory(tmp_path / f"{name}.euroc")
        for read in (tum, euroc):
            np.testing.assert_allclose(read.poses_se3, matrices(POSES), atol=1e-12)
            np.testing.assert_allclose(read.timestamps, times, atol=1e-12)
        kitti = file_interface.read_kitti_poses_file(tmp_path / f"{name}.kitti")
        first = np.linalg.inv(matrices(POSES)[0])
        np.testing.assert_allclose(kitti.poses_se3, [first @ each for each in matrices(POSES)], atol=1e-12)
        assert np.loadtxt(tmp_path / f"{name}.times").tolist() == times
        assert (tmp_path / f"{name}.keys").read_text().split() == [f"{name}-{i}" for i in range(4)]


def test_frames_are_in_the_order_of_their_times(tmp_path):
    get("poses").export(frames(tmp_path, ("cam",), [3.0, 1.0, 2.0, 0.0]), tmp_path, {})
    assert (tmp_path / "cam.keys").read_text().split() == ["cam-3", "cam-1", "cam-2", "cam-0"]
    assert np.loadtxt(tmp_path / "cam.tum")[:, 0].tolist() == [0, 1, 2, 3]


def test_two_frames_at_one_time_are_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"cam: times: expected increasing"):
        get("poses").export(frames(tmp_path, ("cam",), [1.0, 1.0, 2.0, 3.0]), tmp_path, {})
