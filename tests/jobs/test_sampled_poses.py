"""Sampled poses: positions are free by the scene's own geometry, paths move at one speed."""

from dataclasses import replace

import numpy as np
import pytest

import mock_server
import omniscv
from omniscv.errors import ArgumentError
from omniscv.job import load
from omniscv.job.sampling import GridPoses, PathPoses, RandomPoses, read_sampling
from omniscv.make import capture, costs, run
from omniscv.make.source import sample_poses

ROOM = {"low": (-3.2, -2.7, -0.3), "high": (3.2, 2.7, 3.0)}  # the room, its walls and a little beyond
SCENE = mock_server.load_scene("four-wall")
DIRECTIONS = np.random.default_rng(5).normal(size=(1000, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


@pytest.fixture
def source():
    with omniscv.open_source("scene://four-wall") as source:
        yield source


def clearance(position):
    """The distance to the nearest surface along 1,000 random directions, by exact tracing."""
    return SCENE.trace(np.broadcast_to(position, DIRECTIONS.shape), DIRECTIONS).distance.min()


def inside_the_room(position):
    low, high = np.array([-3, -2.5, 0]), np.array([3, 2.5, 2.8])
    return ((position > low) & (position < high)).all()


def test_random_positions_are_free_and_the_same_every_time(source):
    with pytest.raises(ArgumentError, match=r"2 positions with a clearance of 0\.1 m in the box, got 0"):
        sample_poses(RandomPoses(2, (-2, -2, -1), (2, 2, -0.2), clearance=0.1, start=(0, 0, 1.5)), source)
    wanted = RandomPoses(4, **ROOM, clearance=0.35, start=(0, 0, 1.5), seed=3, pitch_deg=(-10, 10))
    found = sample_poses(wanted, source).poses
    assert len(found) == 4
    for pose in found:
        assert inside_the_room(pose.position)
        assert clearance(pose.position) >= 0.35
        assert abs(pose.angles()[1]) <= 10
    assert len({pose.angles()[0] for pose in found}) == 4
    again = sample_poses(replace(wanted, count=2), source).poses
    for one, other in zip(found[:2], again, strict=True):
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_array_equal(one.rotation, other.rotation)
    other = sample_poses(replace(wanted, count=1, seed=4), source).poses[0]
    assert (other.position != found[0].position).any()


def test_a_grid_leaves_out_occupied_positions(source):
    grid = {"low": (-3.5, -2, 0.45), "high": (3.6, 2.1, 0.45), "step": (2, 1.9, 1), "yaws_deg": (0, 90)}
    every = GridPoses(**grid).poses().poses
    assert len(every) == 4 * 3 * 2
    freed = sample_poses(GridPoses(**grid, clearance=0.3, start=(0, 0, 1.5)), source)
    free = {tuple(pose.position) for pose in freed}
    inside = {tuple(pose.position) for pose in every if inside_the_room(pose.position)}
    expected = {position for position in inside if clearance(position) >= 0.3}
    assert free == expected
    assert 0 < len(free) < 12
    assert [round(pose.angles()[0]) for pose in every[:2]] == [0, 90]


@pytest.mark.parametrize("closed", [False, True])
def test_paths_move_at_one_speed_through_their_waypoints(closed):
    waypoints = np.array([(-2, 0, 1.5), (0, 1, 1.2), (2, 0, 1.5), (0, -1.5, 1.8)])
    path = PathPoses(waypoints, speed=0.8, rate=50, closed=closed).poses()
    positions = np.array([pose.position for pose in path.poses])
    steps = np.diff(positions, axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 0.8 / 50, rtol=1e-3)  # chords of a curve
    np.testing.assert_allclose(np.diff(path.seconds), 1 / 50, rtol=1e-9)
    for waypoint in waypoints:
        assert np.linalg.norm(positions - waypoint, axis=1).min() <= 0.5 * 0.8 / 50 * 1.01
    forward = np.array([pose.R_w_c[:, 2] for pose in path.poses])
    middle = steps[1:] + steps[:-1]
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    np.testing.assert_allclose((forward[1:-1] * middle).sum(axis=1), 1, atol=1e-4)
    if closed:
        assert np.linalg.norm(positions[0] - positions[-1]) <= 0.8 / 50 * 1.01


def test_paths_look_level_or_at_a_point():
    waypoints = [(0, 0, 1), (3, 0, 2)]
    for pose in PathPoses(waypoints, speed=1, rate=2, look="level").poses().poses:
        np.testing.assert_allclose(pose.angles(), (0, 0, 0), atol=1e-9)
    for pose in PathPoses(waypoints, speed=1, rate=2, look=(1, 5, 1)).poses().poses:
        np.testing.assert_allclose(pose.to_camera((1, 5, 1))[:2], 0, atol=1e-12)


def test_wrong_descriptions_are_one_line():
    for value, message in (
        ({}, "expected one of random, grid, path; got"),
        ({"random": {"count": 2}}, "poses.random: missing key 'low'"),
        ({"random": {"count": 1, **ROOM, "low": (4, 0, 0), "clearance": 1}}, "high: expected numbers >= low"),
        ({"random": {"count": 1, **ROOM, "clearance": 1, "yaw_deg": (3, 1)}}, "yaw_deg: expected a number"),
        ({"grid": {"low": (0, 0, 0), "high": (1, 1, 1), "step": 0}}, "step: expected distances > 0"),
        ({"grid": {"low": (0, 0, 0), "high": (1, 1, 1), "step": 1e-3}}, "at most 1000000 poses"),
        ({"path": {"waypoints": [(0, 0, 0)], "speed": 1, "rate": 1}}, "waypoints: expected at least two"),
        ({"path": {"waypoints": np.eye(3), "speed": 1, "rate": 1, "look": "up"}}, "look: expected one of"),
        ({"circle": {}}, "unknown key 'circle'; known keys: random, grid, path"),
    ):
        with pytest.raises(ArgumentError, match=message):
            read_sampling("poses", value)


JOB = """
source: scene://four-wall
cameras: {eye: {model: pinhole, width: 48, height: 32, fov_deg: 80}}
poses: {random: {count: 2, low: [-2, -2, 1], high: [2, 2, 2], clearance: 0.3, start: [0, 0, 1.5]}}
face_size: 64
record: room.sqlite
out: images
"""


def test_a_job_samples_its_poses_when_its_source_is_open(tmp_path):
    path = tmp_path / "job.yaml"
    path.write_text(JOB)
    job = load(path)
    planned = {cost.way: cost.requests for cost in costs(job)}
    assert capture(job, job.record).needed == planned["auto"]
    live = {file.name: file.read_bytes() for file in run(job)}
    assert {"eye-0.lit.png", "eye-1.lit.png"} <= set(live)
    path.write_text(JOB.replace("scene://four-wall", "room.sqlite").replace("record: room.sqlite\n", ""))
    replayed = {file.name: file.read_bytes() for file in run(load(path))}
    assert replayed["eye-1.lit.png"] == live["eye-1.lit.png"]


def test_paths_and_open_grids_need_no_source(tmp_path):
    path = tmp_path / "job.yaml"
    sampled = "poses: {path: {waypoints: [[0, 0, 1], [1, 0, 1]], speed: 1, rate: 4}}"
    path.write_text("\n".join(sampled if line.startswith("poses") else line for line in JOB.splitlines()))
    job = load(path)
    assert job.sampling is None
    assert job.times_ns == tuple(range(0, 10**9 + 1, 250_000_000))
