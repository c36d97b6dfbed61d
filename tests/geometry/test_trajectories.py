"""Trajectory files of SLAM benchmarks, as the poses of a job."""

import numpy as np
import pytest

from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import read_trajectory
from omniscv.jobs import load


def test_quaternions_turn_camera_to_world(tmp_path):
    """Worked by hand: (0.5, -0.5, 0.5, -0.5) takes a camera's z to X, x to -Y and y to -Z: level, ahead."""
    path = tmp_path / "path.txt"
    path.write_text(
        "# time tx ty tz qx qy qz qw\n\n0.1 1 2 3 0.5 -0.5 0.5 -0.5  # level\n0.2 0 0 0 0 0 0 1\n"
    )
    level, plain = read_trajectory(path).poses
    ahead = Pose.from_angles((1, 2, 3))
    np.testing.assert_allclose(level.t_w_c, ahead.t_w_c, atol=1e-12)
    np.testing.assert_allclose(level.R_w_c, ahead.R_w_c, atol=1e-12)
    np.testing.assert_array_equal(plain.R_w_c, np.eye(3))


def test_a_job_takes_its_poses_from_a_file_beside_it(tmp_path):
    (tmp_path / "path.txt").write_text("0 1 0 1.5 0.5 -0.5 0.5 -0.5\n1 2 0 1.5 0.5 -0.5 0.5 -0.5\n")
    job = tmp_path / "job.yaml"
    job.write_text(
        "source: mock://four-wall\ncameras: {p: {model: pinhole, width: 8, height: 8}}\nposes: path.txt\n"
    )
    assert [pose.t_w_c.tolist() for pose in load(job).poses] == [[1, 0, 1.5], [2, 0, 1.5]]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "got none"),
        ("0 1 2 3 0 0 0\n", "line 1: expected"),
        ("0 0 0 0 0 0 0 1\n0 1 2 3 0 0 0 0\n", "line 2: expected"),
        ("0 1 2 nan 0 0 0 1\n", "line 1: expected"),
        ("time x y z\n", "line 1: expected"),
    ],
)
def test_a_wrong_line_is_named(text, says, tmp_path):
    path = tmp_path / "path.txt"
    path.write_text(text)
    with pytest.raises(ArgumentError, match=says):
        read_trajectory(path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ArgumentError, match="expected a trajectory file"):
        read_trajectory(tmp_path / "none.txt")
