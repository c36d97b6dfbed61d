"""Normals: unit, right within a degree away from edges, 0 where unknown. Orthographic cameras."""

import itertools

import numpy as np
import pytest
from support.exact import float_source

import omniscv
from mock_server import load_scene
from omniscv.cameras import create
from omniscv.chart import traced
from omniscv.geometry import Pose

POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)


@pytest.mark.parametrize(("name", "filter"), [("equirectangular", "auto"), ("fisheye-equisolid", "nearest")])
def test_normals_of_an_8_bit_server(name, filter):
    camera = create(name, width=96, height=48, **({"fov_deg": 220} if "fish" in name else {}))
    with omniscv.open_source("mock://four-wall") as live:
        image = omniscv.render(camera, POSE, live, ("normals",), filter=filter)
    truth = traced(load_scene("four-wall"), camera, POSE)
    wanted = truth.normal @ POSE.R_w_c
    length = np.linalg.norm(image.normals, axis=-1)
    known = length > 0
    assert np.abs(length[known] - 1).max() < 1e-6
    assert not known[~image.valid].any()
    # Away from edges: within two pixels all is one flat surface.
    same = image.valid.copy()
    for step in itertools.product(range(-2, 3), repeat=2):
        moved = np.roll(truth.normal, step, axis=(0, 1))
        same &= np.roll(truth.label, step, axis=(0, 1)) == truth.label
        same &= (moved == truth.normal).all(axis=-1)
    assert same.sum() > 0.3 * image.valid.sum()
    cosine = np.clip((image.normals * wanted).sum(axis=-1)[same], -1, 1)
    assert np.degrees(np.arccos(cosine)).max() < 1.0


def test_the_sky_has_no_normal():
    camera = create("equirectangular", width=64, height=32)
    with omniscv.open_source("mock://direction") as live:
        image = omniscv.render(camera, POSE, live, ("normals",))
    assert (image.normals == 0).all()


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
    assert (camera.unproject().origins[8, 16] == 0).all()
    image = omniscv.render(camera, Pose.from_angles((0, 0, 1.5)), SOURCE, ("depth",))
    assert image.valid.all()
    assert not image.occluded[8, 16]
