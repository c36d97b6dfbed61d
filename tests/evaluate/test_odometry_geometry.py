"""Geometry of bearings on points that are known: exact bearings give exact poses, all around the camera."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from omniscv.evaluate.odometry.adjustment import Observations, adjust, meeting_points
from omniscv.evaluate.odometry.pose_estimation import absolute_pose, relative_pose
from omniscv.evaluate.odometry.trajectory_errors import trajectory_errors
from omniscv.evaluate.odometry.visual_odometry import Features, estimate
from omniscv.geometry import Pose

LIMIT = np.radians(0.4)
HERE = Pose(np.zeros(3), np.eye(3))


def scene(seed, count=60, turn_deg=30.0):
    """Points around two cameras, the second one's pose in the first, and what they see."""
    draw = np.random.default_rng(seed)
    points = draw.normal(size=(count, 3)) * 2
    points = points[np.linalg.norm(points, axis=1) > 0.8]
    axis, u = draw.normal(size=(2, 3)) / 2
    T_1_2 = Pose(u / np.linalg.norm(u), Rotation.from_rotvec(np.radians(turn_deg) * axis).as_matrix())
    points = points[np.linalg.norm(points - T_1_2.position, axis=1) > 0.8]
    return points, T_1_2, seen(HERE, points), seen(T_1_2, points)


def seen(pose, points):
    p_c = pose.to_camera(points)
    return p_c / np.linalg.norm(p_c, axis=1, keepdims=True)


def turned_deg(a, b):
    return np.degrees(Rotation.from_matrix(a.R_w_c.T @ b.R_w_c).magnitude())


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.floats(0, 170))
def test_exact_bearings_give_the_exact_motion(seed, turn_deg):
    _, T_1_2, first, second = scene(seed, turn_deg=turn_deg)
    found, agree = relative_pose(first, second, LIMIT)
    assert agree.all()
    np.testing.assert_allclose(found.position / np.linalg.norm(found.position), T_1_2.position, atol=1e-8)
    np.testing.assert_allclose(found.rotation, T_1_2.rotation, atol=1e-8)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_wrong_pairs_do_not_count(seed):
    points, T_1_2, first, second = scene(seed, count=150)
    draw = np.random.default_rng(seed)
    wrong = draw.random(len(second)) < 0.4
    second[wrong] = seen(HERE, draw.normal(size=(wrong.sum(), 3)))
    for found, agree in (relative_pose(first, second, LIMIT), absolute_pose(points, second, LIMIT)):
        assert agree[~wrong].all()
        assert agree[wrong].mean() < 0.1
        assert turned_deg(found, T_1_2) < 1e-6
        assert np.linalg.norm(found.position - T_1_2.position) < 1e-8


def test_too_few_bearings_give_no_pose():
    points, _, first, second = scene(0)
    assert relative_pose(first[:3], second[:3], LIMIT) is None
    assert absolute_pose(points[:2], second[:2], LIMIT) is None


def test_rays_meet_in_the_point_that_they_come_from():
    draw = np.random.default_rng(2)
    points, origins = draw.normal(size=(4, 3)), draw.normal(size=(20, 3))
    index = np.arange(20) % 4
    directions = points[index] - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(meeting_points(origins, directions, index, 4), points, atol=1e-9)


def loop(count=7):
    poses = [
        Pose.from_angles((np.cos(a), np.sin(a), 1.5 + 0.2 * np.sin(2 * a)), yaw_deg=np.degrees(a) + 90)
        for a in 2 * np.pi * np.arange(count) / count
    ]
    return [poses[0].inverse() @ pose for pose in poses]


def test_adjustment_of_exact_bearings_ends_at_the_truth():
    poses, points = loop(5), np.random.default_rng(6).normal(size=(40, 3)) * 2 + (0, 0, 1)
    camera, point = (each.ravel() for each in np.meshgrid(np.arange(5), np.arange(40), indexing="ij"))
    observed = Observations(camera, point, np.concatenate([seen(pose, points) for pose in poses]))
    draw = np.random.default_rng(7)
    off = [
        pose @ Pose(0.03 * v, Rotation.from_rotvec(0.03 * w).as_matrix())
        for pose, v, w in zip(poses[2:], *draw.normal(size=(2, 3, 3)), strict=True)
    ]
    found, placed = adjust(
        poses[:2] + off, points + 0.05 * draw.normal(size=points.shape), observed, LIMIT, fixed=2
    )
    np.testing.assert_allclose(placed, points, atol=1e-6)
    for a, b in zip(found, poses, strict=True):
        assert turned_deg(a, b) < 1e-5
        np.testing.assert_allclose(a.position, b.position, atol=1e-6)


def world(poses, seed=8, count=120, noise=0.0):
    """Features of points in a room, each with a descriptor of its own, in an order of their own."""
    draw = np.random.default_rng(seed)
    points = draw.normal(size=(count, 3))
    points *= (draw.uniform(2.5, 4, count) / np.linalg.norm(points, axis=1))[:, None]
    descriptors = draw.normal(size=(count, 128))
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    found = []
    for pose in poses:
        order = draw.permutation(count)
        bearings = seen(pose, points[order])
        bearings += noise * draw.normal(size=bearings.shape)
        bearings /= np.linalg.norm(bearings, axis=1, keepdims=True)
        found.append(Features(bearings, descriptors[order].astype(np.float32)))
    return found


@pytest.mark.parametrize("still", [0, 3])
def test_a_trajectory_of_exact_bearings_is_exact(still):
    """Also one that stands still at first."""
    poses = loop()[:1] * still + loop()
    errors = trajectory_errors(poses, estimate(world(poses), LIMIT))
    assert errors.frames == list(range(len(poses)))
    assert errors.position_m.max() < 1e-6
    assert errors.eps_theta_deg.max() < 1e-5


def test_noise_of_a_tenth_of_a_degree():
    poses = loop()
    errors = trajectory_errors(poses, estimate(world(poses, noise=np.radians(0.1)), LIMIT))
    assert 1e-4 < errors.position_m.max() < 0.02
    assert errors.eps_theta_deg.max() < 0.3


def test_a_sequence_ends_where_nothing_is_seen_again():
    poses = loop()
    features = world(poses)
    features[5] = world([poses[5]], seed=99)[0]
    assert list(estimate(features, LIMIT)) == list(range(5))


@pytest.mark.parametrize("features", [[], world(loop()[:1]), world([HERE] * 3)])
def test_without_motion_there_is_no_scale_and_no_trajectory(features):
    assert len(estimate(features, LIMIT)) <= 1
