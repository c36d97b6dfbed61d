"""What one perspective view can hold is captured with one; at the automatic size images are right."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases
from support.drawn import drawn_camera, drawn_pose
from support.exact import by_rays, cameras_at, distance_to_surfaces
from support.plans import plan_of, views_of

import omniscv
from mock_server import load_scene
from omniscv.cameras import create, names
from omniscv.chart import traced
from omniscv.depth.ray_lookup import look_up
from omniscv.geometry import Pose
from omniscv.planning import densities
from omniscv.sources.scene import SceneSource

POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)
ROOM = load_scene("four-wall")
NARROW = {
    "pinhole": {"width": 64, "height": 64, "fov_deg": 25.0},
    "fisheye-equidistant": {"width": 64, "height": 48, "fov_deg": 70.0},
    "catadioptric-planar": {"width": 48, "height": 64, "fov_deg": 60.0},
    "cylindrical": {"width": 80, "height": 40, "fov_h_deg": 90.0, "fov_v_deg": 50.0},
}
WIDE = create("fisheye-equidistant", width=64, height=64, fov_deg=185.0)

angles = st.floats(-180, 180)


@given(st.floats(-6, 2.06), st.integers(1, 300), st.integers(1, 300), angles, st.floats(-90, 90), angles)
@cases(15)
def test_a_pinhole_is_one_view_about_as_large_as_itself(log_fov, width, height, yaw_deg, pitch_deg, roll_deg):
    """From a millionth of a degree on, wherever it looks; its axis is the view's."""
    height = min(height, 2 * width)
    fov_deg = 10**log_fov / max(1, height / width)
    camera = create("pinhole", width=width, height=height, fov_deg=fov_deg)
    pose = Pose.from_angles(POSE.position, yaw_deg, pitch_deg, roll_deg)
    [view] = views_of(plan_of(camera, pose))
    focal_px = width / 2 / np.tan(np.radians(fov_deg) / 2)
    finer = max(1.25, densities.SMALLEST / 2 / focal_px)
    assert view.width <= finer * width + 12
    assert view.height <= finer * height + 12
    lookup = look_up(camera.unproject().directions.reshape(-1, 3), [view], pose.R_w_c)
    assert (lookup.view == 0).all()
    assert lookup.margin >= 2 - 1e-3
    assert view.pose.R_w_c[:, 2] @ pose.R_w_c[:, 2] > 1 - 1e-9


def test_one_view_holds_what_is_narrow_and_faces_hold_the_rest():
    for name, options in NARROW.items():
        assert len(views_of(plan_of(create(name, **options), POSE))) == 1
    cube = views_of(plan_of(WIDE, POSE, strategy="cube"))
    for strategy in ("auto", "exact"):
        faces = views_of(plan_of(WIDE, POSE, strategy=strategy))
        assert set(faces) < set(cube)
        assert len(faces) > 1
    [view] = views_of(plan_of(create("pinhole", width=64, height=64, fov_deg=60.0), POSE, face_size=512))
    assert view.focal_px == pytest.approx(256)


def test_the_middle_of_an_off_centre_image_is_the_axis():
    camera = create("pinhole", width=64, height=64, focal=200.0, center=(-100.0, 150.0))
    [view] = views_of(plan_of(camera, POSE))
    middle = camera.unproject(np.array([32.0, 32.0])).directions @ POSE.R_w_c.T
    assert view.pose.R_w_c[:, 2] @ middle > np.cos(np.radians(2))
    assert view.width < 1.5 * 64 * 192 / 200 + 100


@pytest.mark.parametrize("uri", ["scene://four-wall?traces=0", "mock://four-wall"])
@pytest.mark.parametrize("strategy", ["cube", "auto"])
def test_recordings_of_faces_and_of_the_view_itself_serve_a_narrow_camera(strategy, uri, tmp_path):
    """The mock server captures nothing tall: a square image takes a view one pixel wider there."""
    camera = create("pinhole", width=64, height=64, fov_deg=90.0)
    modes = ("lit", "object_mask", "depth")
    with omniscv.open_source(uri) as live, omniscv.record(live, tmp_path / "room.sqlite") as source:
        captured = omniscv.render(camera, POSE, source, modes, strategy=strategy)
    with omniscv.open_source(tmp_path / "room.sqlite") as replay:
        image = omniscv.render(camera, POSE, replay, modes)
    for layer in captured.layers:
        np.testing.assert_array_equal(image[layer], captured[layer])


ROOMS = "four-wall", "six-wall"
CENTRAL = by_rays(name for name, camera in cameras_at(200).items() if camera.central)
WRONG_LABELS = 0.01
OFF_SURFACE_M = 0.02


def check(camera, pose, scene):
    image = omniscv.render(camera, pose, SceneSource(scene, cached_views=0), ("object_mask", "depth"))
    wrong = (image.labels != traced(scene, camera, pose).label)[image.valid].mean()
    assert wrong <= WRONG_LABELS, (camera, pose)
    assert distance_to_surfaces(scene, image.points()).max() <= OFF_SURFACE_M, (camera, pose)


@pytest.mark.parametrize("name", CENTRAL[::8])
def test_labels_and_points_of_a_drawn_camera(name):
    rng = np.random.default_rng([0, *name.encode()])
    check(drawn_camera(name, rng), drawn_pose(rng), load_scene(ROOMS[names().index(name) % 2]))


@pytest.mark.soak
def test_a_mirror_ball_in_a_corner_of_the_image():
    ball = create("noncentral-spherical-mirror", 80, 80, mirror_radius=0.3, distance=0.25, focal=29)
    pose = Pose.from_angles((-0.18, 0.61, 1.28), yaw_deg=48, pitch_deg=65, roll_deg=62)
    check(ball, pose, load_scene("four-wall"))
