"""Motions of objects: exact at waypoints, of the speeds that their curves promise, at rest beyond them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mock_server.scene_file import turned
from omniscv import Pose
from omniscv.errors import ArgumentError
from omniscv.geometry.instant import Motion, object_pose
from omniscv.geometry.trajectory import Trajectory, nanoseconds

TIMES = (0.0, 0.7, 1.5, 2.0, 3.1)


def motion(curve, seed=3):
    draw = np.random.default_rng(seed)
    turns = Rotation.random(len(TIMES), random_state=seed).as_matrix()
    poses = tuple(Pose(draw.uniform(-2, 2, 3), R) for R in turns)
    return Motion(Trajectory.timed(poses, TIMES), curve)


def apart(one, other):
    return np.abs(one.position - other.position).max() + np.abs(one.rotation - other.rotation).max()


@pytest.mark.parametrize("curve", ["linear", "spline"])
def test_an_object_is_at_its_waypoints_and_rests_beyond_them(curve):
    moving = motion(curve)
    for time, pose in zip(TIMES, moving.waypoints, strict=True):
        assert apart(moving.at(nanoseconds(time)), pose) < 1e-12
    assert apart(moving.at(nanoseconds(-5)), moving.waypoints[0]) < 1e-12
    assert apart(moving.at(nanoseconds(99)), moving.waypoints[-1]) < 1e-12
    for time in np.linspace(0, 3.1, 20):
        found = moving.at(nanoseconds(time))
        assert np.abs(found.rotation @ found.rotation.T - np.eye(3)).max() < 1e-12


def test_straight_ways_and_the_shortest_turns_at_constant_speed():
    """Half of a turn done twice is the whole turn; slerp by quaternions, written out, agrees."""
    moving = motion("linear")
    for i in range(len(TIMES) - 1):
        start, end = moving.waypoints[i], moving.waypoints[i + 1]
        p, q = (Rotation.from_matrix(pose.rotation).as_quat() for pose in (start, end))
        q = q if p @ q > 0 else -q
        angle = np.arccos(p @ q)
        for share in (0.25, 0.5, 0.9):
            found = moving.at(nanoseconds(TIMES[i] + share * (TIMES[i + 1] - TIMES[i])))
            between = (np.sin((1 - share) * angle) * p + np.sin(share * angle) * q) / np.sin(angle)
            assert np.abs(found.rotation - Rotation.from_quat(between).as_matrix()).max() < 1e-9
            np.testing.assert_allclose(found.position, (1 - share) * start.position + share * end.position)


def test_splines_follow_cubic_ways_and_even_turns():
    axis = np.array([0.6, 0.0, 0.8])

    def pose(time):
        place = (0.2 * time**3 - time**2 + 1, 0.5 * time**2, 2 - time)
        return Pose(np.array(place), Rotation.from_rotvec(0.8 * time * axis).as_matrix())

    moving = Motion(Trajectory.timed(tuple(map(pose, TIMES)), TIMES), "spline")
    for time in np.round(np.linspace(0, 3.1, 23), 9):
        assert apart(moving.at(nanoseconds(time)), pose(time)) < 1e-9

    # whose velocities do not jump
    moving = motion("spline")
    step = 1e-5
    for time in TIMES[1:-1]:
        before, at, after = (moving.at(nanoseconds(time + i * step)) for i in (-1, 0, 1))
        for kind in ("position", "rotation"):
            steps = (before, at), (at, after)
            first, second = ((getattr(b, kind) - getattr(a, kind)) / step for a, b in steps)
            assert np.abs(first).max() > 0.1
            assert np.abs(first - second).max() < 1e-3 * np.abs(first).max() + 1e-3


def test_angles_of_objects_turn_them_from_the_axes_of_the_world():
    assert np.array_equal(object_pose((1, 2, 3)).rotation, np.eye(3))
    for yaw in (-130, 20, 90):
        np.testing.assert_allclose(object_pose((0, 0, 0), yaw).rotation, turned(yaw), atol=1e-12)
    nose = object_pose((0, 0, 0), 0, 90).rotation @ [1, 0, 0]
    right = object_pose((0, 0, 0), 0, 0, 90).rotation @ [0, -1, 0]
    np.testing.assert_allclose([nose, right], [(0, 0, 1), (0, 0, -1)], atol=1e-12)


def test_one_waypoint_is_where_the_object_always_is_and_what_cannot_be_a_motion_is_refused():
    poses = (object_pose((0, 0, 0), 40), object_pose((1, 0, 0)))
    for known in (Trajectory(poses[:1]), Trajectory.timed(poses[:1], (5.0,))):
        still = Motion(known)
        assert still.span_ns is None
        assert still.at(None) is still.at(nanoseconds(-3.0)) is poses[0]
    with pytest.raises(ArgumentError, match="waypoints: expected times, got 2 poses without"):
        Motion(Trajectory(poses))
    with pytest.raises(ArgumentError, match="curve: expected one of linear, spline"):
        Motion(Trajectory(poses, (0, 1)), "cubic")
    with pytest.raises(ArgumentError, match="time: expected one for an object that moves"):
        Motion(Trajectory(poses, (0, 1))).at(None)
