"""Recordings of cubes in any orientation, judged by exact tracing; faces that cannot look straight up."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.plans import plan_of, viewpoints_of

import omniscv
from mock_server import load_scene
from omniscv.cameras import create
from omniscv.chart import traced
from omniscv.errors import MissingCaptureError
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import View
from omniscv.sources.base import Request
from omniscv.sources.recorded_views import RecordedViews
from omniscv.sources.recording import RecordedSource, Recording
from omniscv.sources.scene import open_scene

CENTER = (0.3, -0.2, 1.45)
TURNED = Pose.from_angles((0, 0, 0), yaw_deg=30, pitch_deg=10, roll_deg=5).R_w_c @ cube_rotations()[0][1].T
MODES = ("lit", "object_mask", "depth")
EDGE = 96


def views(R_w_d, turns=(0,) * 6, edge=EDGE):
    """Six faces of a cube in a frame d, each turned clockwise by quarters about its axis."""
    for (_, R_d_c), quarters in zip(cube_rotations(), turns, strict=True):
        R_w_c = R_w_d @ R_d_c @ Rotation.from_euler("z", -90 * quarters, degrees=True).as_matrix()
        yield View(Pose(CENTER, R_w_c), 90, edge, edge)


def recorded(path, *sets):
    with Recording(open_scene("scene://four-wall"), path) as recording:
        list(recording.capture(Request(view, mode) for views in sets for view in views for mode in MODES))
    return RecordedSource(path)


def rendered(source, camera, pose):
    return omniscv.render(camera, pose, source, MODES, filter="nearest")


def judge(image):
    """Labels and depths against what each ray meets, where the image does not say that they may differ.

    A slip of faces of 96 px would be a quarter turn; a thing thinner than their pixels may be lost in one.
    """
    truth = traced(load_scene("four-wall"), image.camera, image.pose)
    marked = image.label_edge | ~image.valid
    # Of the nearest pixel of coarse faces, depth is off by more than 1 % on floors and walls at an angle.
    assert marked.mean() < 0.45
    assert (image.labels == truth.label)[~marked].mean() > 0.999
    off = np.abs(image.depth.astype(np.float64) - truth.distance)
    bound = 2 * image.depth_error.astype(np.float64) + 1e-5
    assert (off <= bound)[~marked & np.isfinite(bound)].mean() > 0.999


TURNS = {
    "turned": (TURNED, (0,) * 6),
    "turned, and each face by quarters": (TURNED, (0, 1, 2, 3, 2, 1)),
    "up and down as in KTX": (np.eye(3), (0, 0, 0, 0, 2, 2)),
    "as in DDS of Unreal": (np.eye(3), (3, 2, 1, 0, 3, 3)),
}


@pytest.mark.parametrize("name", TURNS)
def test_a_cube_serves_in_every_orientation(name, tmp_path):
    pose = Pose.from_angles(CENTER, yaw_deg=70, pitch_deg=-20, roll_deg=15)
    with recorded(tmp_path / "room.sqlite", views(*TURNS[name])) as source:
        assert RecordedViews(source.recorded_views()).centers() == (CENTER,)
        for camera in (
            omniscv.cameras.create("equirectangular", 96, 48),
            omniscv.cameras.create("fisheye-equidistant", 64, 64, fov_deg=150),
        ):
            judge(rendered(source, camera, pose))


def test_the_fuller_and_finer_cube_is_taken(tmp_path):
    aligned = [*views(np.eye(3), edge=2 * EDGE)][:5]
    with recorded(tmp_path / "room.sqlite", aligned, views(TURNED, edge=64), views(TURNED)) as source:
        held = RecordedViews(source.recorded_views())
        six = held.faces(np.array(CENTER), [*views(np.eye(3), edge=80)])
        assert [view.width for view in six] == [EDGE] * 6
        np.testing.assert_allclose(six[4].pose.R_w_c[:, 2], TURNED[:, 2], atol=1e-9)


def test_any_views_that_see_every_direction_serve(tmp_path):
    angles = [(yaw, pitch) for pitch, first in ((-50, 0), (0, 45), (50, 0)) for yaw in range(first, 360, 90)]
    twelve = [View(Pose.from_angles(CENTER, yaw_deg=y, pitch_deg=p), 90, EDGE, EDGE) for y, p in angles]
    camera = omniscv.cameras.create("equirectangular", 96, 48)
    pose = Pose.from_angles(CENTER, yaw_deg=5)
    with recorded(tmp_path / "room.sqlite", twelve) as source:
        judge(rendered(source, camera, pose))
    with recorded(tmp_path / "less.sqlite", twelve[1:]) as source, pytest.raises(MissingCaptureError):
        rendered(source, camera, pose)


def test_a_turned_cube_serves_rays_that_start_beside_its_centre(tmp_path):
    camera = omniscv.cameras.create("noncentral-panorama", 96, 48, radius=0.2)
    with recorded(tmp_path / "room.sqlite", views(TURNED, edge=256)) as source:
        pose = Pose.from_angles(CENTER, yaw_deg=20)
        image = omniscv.render(camera, pose, source, MODES, strategy="exact", viewpoints=1)
    truth = traced(load_scene("four-wall"), camera, pose)
    sure = image.valid & ~image.unsure & ~image.label_edge
    assert sure.mean() > 0.4
    assert (image.labels == truth.label)[sure].mean() > 0.999
    bounded = sure & np.isfinite(image.depth_error)
    assert (np.abs(image.depth - truth.distance) <= 2 * image.depth_error + 1e-5)[bounded].mean() > 0.999


LEANING_AT = np.array([0.3, -0.2, 1.5])
PANORAMA = create("equirectangular", width=64, height=32)


def as_captured(view, fov_deg):
    """What the plugin makes of a view: pitch limited, field of view the window's."""
    yaw, pitch, roll = view.pose.angles()
    pose = Pose.from_angles(view.pose.t_w_c, yaw, np.clip(pitch, -89.9, 89.9), roll)
    return View(pose, fov_deg, view.width, view.height)


def sees(view, points):
    u, v, z = view.project(points).T
    return (z > 0) & (u >= 0) & (u <= view.width) & (v >= 0) & (v <= view.height)


def test_leaning_views_of_90_degrees_see_everything_and_six_faces_would_not():
    """Points in all directions, most of them near the edges of up and down, where views lean away."""
    with omniscv.open_source("mock://four-wall?dialect=0.3.10&size=256x256") as source:
        task = plan_of(PANORAMA, Pose.from_angles(LEANING_AT), source.capabilities, cover=source.cover)
        [viewpoint] = viewpoints_of(task)
    rng = np.random.default_rng(1)
    near_edges = rng.uniform(-1, 1, (30_000, 3)) * (1, 1.003, 1)
    near_edges[:, 0] = rng.choice([-1, 1], 30_000) * rng.uniform(0.996, 1.004, 30_000)
    near_edges[:, 2] = rng.choice([-1, 1], 30_000)
    points = np.concatenate([rng.normal(size=(30_000, 3)), near_edges, near_edges[:, [1, 0, 2]]])
    seen = [sees(as_captured(view, 90.0), LEANING_AT + points) for view in viewpoint.views]
    assert np.any(seen, axis=0).all()
    assert not np.any(seen[:6], axis=0).all()
    [aligned] = viewpoints_of(plan_of(PANORAMA, Pose.from_angles(LEANING_AT, 40, 20), strategy="cube"))
    for view, (_, R_w_c) in zip(aligned.views, cube_rotations(), strict=True):
        np.testing.assert_array_equal(view.pose.R_w_c, R_w_c)  # the world's axes, in every orientation
