"""Orthographic cameras, and cameras that could move and do not."""

import numpy as np
from support.exact import float_source

import omniscv
from mock_server import load_scene
from omniscv.cameras import create
from omniscv.chart import traced
from omniscv.geometry import Pose

DOWN = Pose.from_angles((0.1, -0.2, 1.5), yaw_deg=27.0, pitch_deg=-80.0)
SOURCE = float_source(load_scene("four-wall"))
MODES = ("lit", "object_mask", "depth")


def test_a_plan_of_the_room():
    """Few captures for four thousand centres: what is wrong lies at edges, and is marked."""
    camera = create("orthographic", 48, 48, width_m=2.0)
    image = omniscv.render(camera, DOWN, SOURCE, MODES, face_size=256)
    truth = traced(SOURCE.scene, camera, DOWN)
    wrong = image.labels != truth.label
    assert wrong.mean() <= 0.02
    assert not (wrong & ~image.label_edge & ~image.unsure).any()
    off = np.abs(image.depth - truth.distance)
    assert np.median(off) <= 1e-5
    assert (off > image.depth_error).mean() <= 0.001
    pixels, _ = image.camera.project(DOWN.to_camera(image.points()))
    np.testing.assert_allclose(pixels[:, 0] % 1, 0.5, atol=1e-4)


def test_a_pixel_whose_own_centre_is_the_cameras():
    """The middle ray of an orthographic image of odd size starts where the camera is: nothing is between."""
    camera = create("orthographic", width=33, height=17, width_m=1.0)
    rays = camera.unproject()
    assert (rays.origins[8, 16] == 0).all()
    source = float_source(load_scene("four-wall"))
    image = omniscv.render(camera, Pose.from_angles((0, 0, 1.5)), source, ("depth",))
    assert image.valid.all()
    assert not image.occluded[8, 16]
