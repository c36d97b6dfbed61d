"""Stereo panoramas and cameras that move while they look, judged by turning and moving a camera at rest."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from omniscv.cameras import create, from_dict
from omniscv.cameras.rolling_shutter import as_shutter
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.testing.contracts import check_round_trip

BASE = create("fisheye-equidistant", 48, 36, fov_deg=150)
START = Pose.from_angles((1.0, 2.0, 1.5), yaw_deg=30, pitch_deg=10)
BENT = Pose.from_angles((0, 0, 0), 20, 10, -30).rotation
END = Pose.from_angles((1.3, 1.9, 1.6), yaw_deg=52, pitch_deg=-3, roll_deg=9)
SCANS = {
    "top-to-bottom": lambda u, v: v / 36,
    "bottom-to-top": lambda u, v: 1 - v / 36,
    "left-to-right": lambda u, v: u / 48,
    "right-to-left": lambda u, v: 1 - u / 48,
}


def moving(scan):
    camera = create("rolling-shutter", 48, 36, base=BASE, readout=0.04, scan=scan)
    return camera.on(Trajectory.timed((START, END), (0.0, 0.04)), 0, Pose(np.zeros(3), np.eye(3)))


def pose_between(part):
    turns = Slerp([0, 1], Rotation.from_matrix([START.R_w_c, END.R_w_c]))
    return Pose((1 - part) * START.t_w_c + part * END.t_w_c, turns(part).as_matrix())


@pytest.mark.parametrize(("eye", "side"), [("left", -1), ("right", 1)])
def test_an_eye_of_a_head_that_turns(eye, side):
    """A column is what the eye sees straight ahead once the head has turned to it."""
    camera = create("ods", 24, 12, interpupillary=0.3, eye=eye)
    rays = camera.unproject()
    ahead = create("equirectangular", 24, 12).unproject(np.stack([np.full(12, 12.0), np.arange(0.5, 12)], -1))
    for column in range(24):
        turn = Rotation.from_rotvec([0, (column + 0.5) / 24 * 2 * np.pi - np.pi, 0])
        origins = np.tile(turn.apply([side * 0.15, 0, 0]), (12, 1))
        np.testing.assert_allclose(rays.origins[:, column], origins, atol=1e-15)
        np.testing.assert_allclose(rays.directions[:, column], turn.apply(ahead.directions), atol=1e-15)


def test_vr180_eyes_are_apart_by_the_distance():
    left, right = (create("vr180", 16, 16, interpupillary=0.1, eye=eye) for eye in ("left", "right"))
    np.testing.assert_array_equal(left.viewpoints().centers, [[-0.05, 0, 0]])
    np.testing.assert_array_equal(right.viewpoints().centers, [[0.05, 0, 0]])
    np.testing.assert_array_equal(left.unproject().directions, right.unproject().directions)
    assert not left.project([0.0, 0, -1])[1]
    ahead = create("cylindrical", 16, 16, fov_h_deg=180, fov_v_deg=180).unproject()
    np.testing.assert_array_equal(left.unproject().directions, ahead.directions)


@pytest.mark.parametrize("scan", SCANS)
def test_every_line_is_the_base_at_its_time(scan):
    camera = moving(scan)
    pose = START
    rays = camera.unproject()
    base = BASE.unproject()
    np.testing.assert_array_equal(rays.valid, base.valid)
    for v, u in np.argwhere(rays.valid)[::37]:
        there = pose_between(SCANS[scan](u + 0.5, v + 0.5))
        np.testing.assert_allclose(pose.to_world(rays.origins[v, u]), there.t_w_c, atol=1e-14)
        expected = there.R_w_c @ base.directions[v, u]
        np.testing.assert_allclose(pose.R_w_c @ rays.directions[v, u], expected, atol=1e-14)


@pytest.mark.parametrize("scan", ["top-to-bottom", "right-to-left"])
def test_points_are_seen_in_the_line_that_is_read_just_then(scan):
    camera = moving(scan)
    pose = START
    points_c = np.random.default_rng(2).uniform((-3, -2, -0.5), (3, 2, 4), (60, 3))
    pixels, seen = camera.project(points_c)
    parts = np.linspace(0, 1, 201)
    late, at = np.full((2, len(parts), 60), np.nan)
    for k, part in enumerate(parts):
        tried, valid = BASE.project(pose_between(part).to_camera(pose.to_world(points_c)))
        late[k] = np.where(valid, SCANS[scan](*tried.T) - part, np.nan)
    meets = (late[:-1] >= 0) & (late[1:] <= 0)
    assert 15 < meets.any(axis=0).sum() < 60
    np.testing.assert_array_equal(seen[meets.any(axis=0)], True)
    at = parts[meets.argmax(axis=0)]
    off = np.abs(SCANS[scan](*pixels.T) - at)[meets.any(axis=0)]
    assert off.max() <= 1 / 200
    # Others are seen at the border at most, within the step in which they come into view or go.
    known = np.isfinite(late).any(axis=0) & ~meets.any(axis=0)
    assert (seen & ~meets.any(axis=0)).sum() <= 2, known.sum()


@pytest.mark.parametrize("curve", ["linear", "spline"])
def test_every_line_is_where_the_path_is_at_its_time(curve):
    """On a rig with a lever, over a bend of the path; a scanner's first column fires at the image's time."""
    times = np.arange(0, 1, 0.04)
    poses = [Pose.from_angles((t**2, np.sin(5 * t), 1.5), 200 * t, 20 * np.sin(9 * t)) for t in times]
    path = Trajectory.timed(poses, times, curve)
    mounted = Pose((0.3, 0.1, -0.2), BENT)
    lidar = create("lidar", preset="vlp-16")
    for camera in (create("rolling-shutter", 48, 36, base=BASE, readout=0.03), as_shutter(lidar)):
        moved = camera.on(path, 500_000_000, mounted)
        pose = path.at(500_000_000) @ mounted
        seconds = moved.seconds()
        rays = moved.unproject()
        base = camera.base.unproject()
        for v, u in np.argwhere(rays.valid)[::97]:
            there = path.at(500_000_000 + round(1e9 * seconds[v, u])) @ mounted
            own = there.to_world(base.origins[v, u] if base.origins.ndim > 1 else base.origins)
            np.testing.assert_allclose(pose.to_world(rays.origins[v, u]), own, atol=2e-6)
            found = there.R_w_c.T @ pose.R_w_c @ rays.directions[v, u]
            np.testing.assert_allclose(found, base.directions[v, u], atol=2e-6)
        if camera.base is BASE:
            check_round_trip(moved)
        assert from_dict(moved.to_dict()) == moved
    first = np.unravel_index(seconds.argmin(), seconds.shape)
    np.testing.assert_allclose(seconds, lidar.seconds(), atol=1e-12)
    assert first[1] == 0 == lidar.seconds()[first]
    with pytest.raises(ArgumentError, match=r"^time: expected 0 to 0.96 s, or a step beyond, got 1.0"):
        camera.on(path, 950_000_000, mounted)


@pytest.mark.parametrize("still", [{"readout": 0.0, "velocity": (1, 2, 3)}, {"readout": 0.1}])
def test_no_readout_or_no_motion_is_the_base(still):
    camera = create("rolling-shutter", 48, 36, base=BASE, **still)
    np.testing.assert_array_equal(camera.unproject().directions, BASE.unproject().directions)
    points = np.random.default_rng(3).normal(size=(200, 3))
    for mine, its in zip(camera.project(points), BASE.project(points), strict=True):
        np.testing.assert_array_equal(mine, its)
    np.testing.assert_array_equal(camera.viewpoints().index, BASE.viewpoints().index)
    assert not camera.viewpoints().centers.any()


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"base": {"model": "ods", "interpupillary": 0.1}}, "base: expected a central camera .*, got ods"),
        ({"base": {"model": "rolling-shutter"}}, "base: expected a central camera .*, got rolling-shutter"),
        ({"base": create("pinhole", 64, 36)}, "base: expected 48 x 36 px, got 64 x 36"),
        ({"base": "pinhole"}, "base: expected a camera or a mapping with 'model' in it, got 'pinhole'"),
        ({"base": {"model": "pinhole", "focal": -1}}, "base: focal: expected a finite number > 0, got -1"),
        ({"base": {"model": ["pinhole"]}}, "base: camera: expected one of"),
        (
            {"base": {"model": "push-broom", "travel": (1, 0, 0)}},
            "base: expected a push-broom with a readout",
        ),
        ({"base": {"model": "push-broom", "readout": 0.1}}, "scan: of a push-broom: expected one of left-to"),
        ({"scan": "sideways"}, "scan: expected one of top-to-bottom"),
        ({"velocity": (1, 2)}, "velocity: expected 3 finite numbers"),
        ({"angular_velocity_deg": (0, 1000, 0)}, "angular_velocity_deg: the turn in .* <= 90, got 100"),
        ({"path": [[0, 0, 0, 0, 0, 0, 0, 1]]}, "path: expected 4, 7, 10, ... rows, got 1"),
        ({"velocity": (1, 0, 0), "path": [[0, 0, 0, 0, 0, 0, 0, 1]]}, "path: expected it or velocities"),
    ],
)
def test_wrong_parameters_of_rolling_shutters_are_refused(wrong, says):
    with pytest.raises(ArgumentError, match=says):
        create("rolling-shutter", 48, 36, **{"base": {"model": "pinhole"}, "readout": 0.1, **wrong})


def test_a_push_broom_is_a_row_of_pinholes():
    camera = create("push-broom", 20, 30, travel=(2.0, 0.4, -0.2), fov_deg=80)
    point = np.array([0.3, -0.5, 3.0])
    pixel, seen = camera.project(point)
    assert seen
    place = (pixel[0] / 20 - 0.5) * np.array([2.0, 0.4, -0.2])
    line = create("pinhole", 30, 30, fov_deg=80)
    np.testing.assert_allclose(line.project(point - place)[0], (15, pixel[1]), atol=1e-12)
    assert not camera.project([0.3, 0, -3])[1]
    with pytest.raises(ArgumentError, match=r"travel: expected x > 0, to the right, got \[-1.0, 0.0, 0.0\]"):
        create("push-broom", 20, 30, travel=(-1, 0, 0))


@pytest.mark.parametrize("scan", ["left-to-right", "right-to-left"])
def test_a_push_broom_on_a_straight_even_path_is_the_one_that_travels(scan):
    travel = np.array([2.0, 0.4, -0.2]) * (1 if scan == "left-to-right" else -1)
    known = create("push-broom", 20, 30, travel=np.abs(travel) * np.sign([1, 1, -1]), fov_deg=80)
    line = create("push-broom", 20, 30, readout=0.5, fov_deg=80)
    camera = create("rolling-shutter", 20, 30, base=line, readout=0.5, scan=scan)
    end = Pose(START.to_world(travel), START.rotation)
    moved = camera.on(Trajectory.timed((START, end), (0.0, 0.5)), 0)
    assert from_dict(moved.to_dict()) == moved
    rays = moved.unproject()
    wanted = known.unproject()
    np.testing.assert_allclose(rays.origins, wanted.origins + travel / 2, atol=1e-12)
    np.testing.assert_allclose(rays.directions, wanted.directions, atol=1e-12)
    centers = moved.viewpoints().centers, known.viewpoints().centers + travel / 2
    np.testing.assert_allclose(*(of[np.lexsort(of.T)] for of in centers), atol=1e-12)
    points = np.random.default_rng(4).uniform((-2, -2, -1), (2, 2, 4), (300, 3))
    (pixels, seen) = moved.project(points + travel / 2)
    (known_pixels, known_seen) = known.project(points)
    np.testing.assert_array_equal(seen, known_seen)
    assert 20 < seen.sum() < 280
    np.testing.assert_allclose(pixels[seen], known_pixels[seen], atol=1e-9)
    check_round_trip(moved)


def test_a_push_broom_has_a_travel_or_a_readout():
    for wrong, says in (
        ({"travel": (1, 0, 0), "readout": 1}, "travel: expected it or a readout, of a camera on a path"),
        ({}, r"travel: expected x > 0, to the right, got \[0.0, 0.0, 0.0\]"),
    ):
        with pytest.raises(ArgumentError, match=says):
            create("push-broom", 20, 30, **wrong)


def test_an_orthographic_image_is_a_plan():
    camera = create("orthographic", 40, 20, width_m=4.0)
    pixels, seen = camera.project([[0, 0, 1], [1.5, -0.5, 7], [0, 0, -1], [3, 0, 1]])
    assert seen.tolist() == [True, True, False, False]
    np.testing.assert_allclose(pixels[:2], [[20, 10], [35, 5]])


@pytest.mark.parametrize("count", [None, 1, 7, 200])
def test_orthographic_centres_are_the_middles_of_blocks(count):
    camera = create("orthographic", 31, 20, width_m=3.1)
    views = camera.viewpoints(count)
    origins = camera.unproject().origins
    assert len(views.centers) <= (count or 620)
    assert len(views.centers) >= min(count or 620, 620) / 2
    for k in range(0, len(views.centers), 1 + len(views.centers) // 50):
        own = origins[views.index == k]
        np.testing.assert_allclose(views.centers[k], (own.min(axis=0) + own.max(axis=0)) / 2, atol=1e-12)
    # Neighbours in the list are neighbours in the image.
    steps = np.linalg.norm(np.diff(views.centers, axis=0), axis=1)
    assert np.median(steps, axis=0) <= 1.5 * 3.1 / np.sqrt(len(views.centers)) if len(steps) else True
