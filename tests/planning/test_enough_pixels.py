"""At the automatic size an image is right nearly everywhere, whatever the camera and where it looks."""

import numpy as np
import pytest
from support.drawn import drawn_camera, drawn_pose
from support.exact import by_rays, cameras_at, distance_to_surfaces

import omniscv
from mock_server import load_scene
from omniscv.cameras import create, names
from omniscv.chart import traced
from omniscv.geometry import Pose
from omniscv.sources.scene import SceneSource

ROOMS = "four-wall", "six-wall"
CENTRAL = by_rays(name for name, camera in cameras_at(200).items() if camera.central)
WRONG_LABELS, OFF_SURFACE_M = 0.01, 0.02


def check(camera, pose, scene):
    image = omniscv.render(camera, pose, SceneSource(scene, cached_views=0), ("object_mask", "depth"))
    wrong = (image.labels != traced(scene, camera, pose).label)[image.valid].mean()
    assert wrong <= WRONG_LABELS, (camera, pose)
    assert distance_to_surfaces(scene, image.points()).max() <= OFF_SURFACE_M, (camera, pose)


@pytest.mark.parametrize("name", CENTRAL[::6])
def test_labels_and_points_of_a_drawn_camera(name):
    """Of another room for every sixth model; the ball below is a non-central one. ``scripts/judge`` draws of
    all models."""
    rng = np.random.default_rng([0, *name.encode()])
    check(drawn_camera(name, rng), drawn_pose(rng), load_scene(ROOMS[names().index(name) % 2]))


def test_a_mirror_ball_in_a_corner_of_the_image():
    """A ball that shows the whole room: 2.1 % of its labels were wrong."""
    ball = create("noncentral-spherical-mirror", 80, 80, mirror_radius=0.3, distance=0.25, focal=29)
    pose = Pose.from_angles((-0.18, 0.61, 1.28), yaw_deg=48, pitch_deg=65, roll_deg=62)
    check(ball, pose, load_scene("four-wall"))
