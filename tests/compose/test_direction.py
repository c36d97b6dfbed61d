"""Every pixel shows its own ray, and the automatic size of faces is the smallest that loses no detail."""

import numpy as np
import pytest
from support.exact import FIXED, by_rays, cameras_at, float_source

import omniscv
from mock_server import load_scene
from omniscv.chart import traced_mean
from omniscv.geometry import Pose
from omniscv.planning import ImageRays, densities

POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)
CAMERAS = cameras_at(64)


def error_px(image):
    """The angle between each pixel's ray and the one it shows, in steps between pixels."""
    camera = image.camera
    valid = image.valid
    rays = camera.unproject()
    shown = 2 * image.lit.astype(np.float64) - 1
    wanted = rays.directions @ image.pose.R_w_c.T
    apart = np.linalg.norm(shown / np.linalg.norm(shown, axis=-1, keepdims=True) - wanted, axis=-1)
    steps = densities.steps(rays.directions, rays.origins)
    return (apart / steps)[valid & np.isfinite(steps)]


SOURCE = float_source(load_scene("direction"))


def by_filters():
    """Every model bilinear; some bicubic or by ``area``."""
    for case in by_rays(CAMERAS):
        yield pytest.param(*case.values, "bilinear", marks=case.marks)
    yield from (("equirectangular", "bicubic"), ("cylindrical", "area"), ("noncentral-panorama", "bicubic"))
    yield from (("catadioptric-hyperbolic", "bicubic"), ("fisheye-equidistant", "area"))


@pytest.mark.parametrize(("name", "filter"), [*by_filters()])
def test_pixels_show_their_own_rays(name, filter):
    """With faces of the size that suits the image, 0.006 px on average and 0.018 px at most, everywhere.

    ``area`` shows the mean of what it averages, which is off the pixel's own ray where the image's scale
    changes from pixel to pixel, and one-sided at an image's rim: its worst pixel is not bounded here.
    """
    face_size = "auto" if filter != "area" else 512
    image = omniscv.render(CAMERAS[name], POSE, SOURCE, filter=filter, face_size=face_size)
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


def test_nearest_is_within_half_a_pixel_of_the_face():
    camera = CAMERAS["equirectangular"]
    edge = 512
    image = omniscv.render(camera, POSE, SOURCE, filter="nearest", face_size=edge)
    step_px = 2 * np.pi / camera.width * edge / 2
    assert error_px(image).max() <= np.sqrt(0.5) / step_px * 1.01


POSES = [Pose.from_angles((0.1 + 0.2 * i, -0.2, 1.45), 27.0 + 73 * i, 8.0 - 5 * i, 3 * i) for i in range(3)]
SCENE = load_scene("four-wall")
COARSE = cameras_at(72)


@pytest.mark.parametrize("name", [pytest.param("equirectangular", marks=pytest.mark.soak), "pinhole"])
def test_twice_the_size_gains_less_than_a_tenth(name, monkeypatch):
    """On average over poses: in a single picture, how fine lines fall on the pixels decides as much.

    A quarter loses, though: what a camera's density takes is at the knee, not far beyond it. Only colours
    have a knee; the automatic size is no smaller than the edges in masks and depth take.
    """
    camera = COARSE[name]
    monkeypatch.setattr(densities, "SMALLEST", 8)
    knee = ImageRays(camera).face_size
    square = dict.fromkeys((0.25, 1, 2), 0.0)
    for pose in POSES:
        truth = traced_mean(SCENE, camera, pose, across=3)
        for scale in square:
            given = {"strategy": "exact", "filter": "bilinear", "face_size": round(knee * scale)}
            image = omniscv.render(camera, pose, float_source(SCENE), **given)
            square[scale] += np.nanmean((image.lit - truth) ** 2)
    error = {scale: np.sqrt(total) for scale, total in square.items()}
    assert error[2] > 0.9 * error[1]
    assert error[0.25] > 1.1 * error[1]


def test_face_sizes_follow_from_what_the_camera_sees():
    """A panorama's equator; a pinhole's focal length, at its middle, where the finest step is towards the
    corners, by 1 / cos^2 at most; and what edges take of a small image."""
    panorama, small = (omniscv.cameras.create("equirectangular", 2 * n, n) for n in (1024, 32))
    pinhole = omniscv.cameras.create("pinhole", width=512, height=512, fov_deg=90)
    assert ImageRays(panorama).face_size == pytest.approx(1.2 * 2048 / np.pi, abs=8)
    assert 1.2 * 512 <= ImageRays(pinhole).face_size <= 1.2 * 2 * 512
    assert ImageRays(small).face_size == densities.SMALLEST
