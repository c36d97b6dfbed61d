"""The automatic face size: the smallest that loses no detail against the camera's own densities."""

import numpy as np
import pytest
from support.exact import cameras_at, float_source

import omniscv
from mock_server import load_scene
from omniscv.chart import traced_mean
from omniscv.geometry import Pose
from omniscv.planning import ImageRays, densities

POSES = [Pose.from_angles((0.1 + 0.2 * i, -0.2, 1.45), 27.0 + 73 * i, 8.0 - 5 * i, 3 * i) for i in range(3)]
SCENE = load_scene("four-wall")
CAMERAS = cameras_at(72)


@pytest.mark.parametrize("name", [pytest.param("equirectangular", marks=pytest.mark.soak), "pinhole"])
def test_twice_the_size_gains_less_than_a_tenth(name, monkeypatch):
    """On average over poses: in a single picture, how fine lines fall on the pixels decides as much.

    A quarter loses, though: what a camera's density takes is at the knee, not far beyond it. Only colours
    have a knee; the automatic size is no smaller than the edges in masks and depth take.
    """
    camera = CAMERAS[name]
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


def test_the_density_of_a_panorama_is_that_of_its_equator():
    camera = omniscv.cameras.create("equirectangular", width=2048, height=1024)
    assert ImageRays(camera).face_size == pytest.approx(1.2 * 2048 / np.pi, abs=8)


def test_the_density_of_a_pinhole_is_its_focal_length():
    """At the image's middle a step is 1 / f; the finest is towards the corners, by 1 / cos^2 at most."""
    camera = omniscv.cameras.create("pinhole", width=512, height=512, fov_deg=90)
    assert 1.2 * 512 <= ImageRays(camera).face_size <= 1.2 * 2 * 512


def test_the_size_of_a_small_image_is_what_edges_take():
    camera = omniscv.cameras.create("equirectangular", width=64, height=32)
    assert ImageRays(camera).face_size == densities.SMALLEST
