"""Every pixel shows its own ray: the colour of the scene is the direction, captured in floats."""

import numpy as np
import pytest
from support.exact import FIXED, by_rays, cameras_at, float_source

import omniscv
from mock_server import load_scene
from omniscv.geometry import Pose
from omniscv.planning import densities

POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)
CAMERAS = cameras_at(64)


def error_px(image):
    """The angle between each pixel's ray and the one it shows, in steps between pixels."""
    camera, valid = image.camera, image.valid
    rays = camera.unproject()
    shown = 2 * image.lit.astype(np.float64) - 1
    wanted = rays.directions @ image.pose.R_w_c.T
    apart = np.linalg.norm(shown / np.linalg.norm(shown, axis=-1, keepdims=True) - wanted, axis=-1)
    steps = densities.steps(rays.directions, rays.origins)
    return (apart / steps)[valid & np.isfinite(steps)]


@pytest.fixture(scope="module")
def source():
    return float_source(load_scene("direction"))


def by_filters():
    """Every model bilinear; some bicubic or by ``area``."""
    for case in by_rays(CAMERAS):
        yield pytest.param(*case.values, "bilinear", marks=case.marks)
    yield from (("equirectangular", "bicubic"), ("cylindrical", "area"), ("noncentral-panorama", "bicubic"))
    yield from (("catadioptric-hyperbolic", "bicubic"), ("fisheye-equidistant", "area"))


@pytest.mark.parametrize(("name", "filter"), [*by_filters()])
def test_pixels_show_their_own_rays(name, filter, source):
    """With faces of the size that suits the image, 0.006 px on average and 0.018 px at most, everywhere.

    ``area`` shows the mean of what it averages, which is off the pixel's own ray where the image's scale
    changes from pixel to pixel, and one-sided at an image's rim: its worst pixel is not bounded here.
    """
    face_size = "auto" if filter != "area" else 512
    image = omniscv.render(CAMERAS[name], POSE, source, filter=filter, face_size=face_size)
    error = error_px(image)
    assert error.mean() <= (0.006 if filter != "area" else 0.04)
    if filter != "area":
        assert error.max() <= 0.018


def test_faces_without_overscan_serve_as_well():
    """A server that cannot set size or field of view: what lies beyond an edge comes from the next face."""
    fixed = float_source(load_scene("direction"), FIXED)
    error = error_px(omniscv.render(CAMERAS["catadioptric-hyperbolic"], POSE, fixed, filter="bilinear"))
    assert error.mean() <= 0.006
    assert error.max() <= 0.018


def test_nearest_is_within_half_a_pixel_of_the_face(source):
    camera = CAMERAS["equirectangular"]
    edge = 512
    image = omniscv.render(camera, POSE, source, filter="nearest", face_size=edge)
    step_px = 2 * np.pi / camera.width * edge / 2
    assert error_px(image).max() <= np.sqrt(0.5) / step_px * 1.01
