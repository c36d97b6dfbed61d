"""Few centres instead of thousands: what is sure is right, and what is not sure says so."""

import numpy as np
import pytest
from support.exact import float_source
from support.judged import Errors

import omniscv
from mock_server import load_scene
from mock_server.scene import Scene
from omniscv.cameras import create
from omniscv.chart.truth import traced
from omniscv.geometry import Pose

POSE = Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0)
ROOM = float_source(load_scene("four-wall"))
LOW = create("noncentral-panorama", width=512, height=32, radius=1.0)
CAMERAS = {
    "panorama": LOW,
    "ball": create(
        "noncentral-spherical-mirror", width=128, height=128, mirror_radius=0.3, distance=0.3, fov_deg=280
    ),
    "cone": create("noncentral-conical-mirror", width=128, height=128, half_angle_deg=55.0, distance=0.3),
}
MODES = ("lit", "object_mask", "depth", "normals")


def right(image, truth):
    """Label equal and depth within 1 %."""
    near = np.abs(image.depth - truth.distance) <= 0.01 * truth.distance
    return (image.labels == truth.label) & (near | (np.isinf(image.depth) & np.isinf(truth.distance)))


def test_few_centres_serve_as_well():
    """A twentieth of the paper's views, and no hole."""
    camera, source = LOW, float_source(load_scene("six-wall"))
    truth = traced(source.scene, camera, POSE)
    image = omniscv.render(camera, POSE, source, MODES[1:], strategy="adaptive", face_size=336)
    valid, unsure = image.valid, image.unsure
    centers = len(np.unique(camera.viewpoints().index[valid]))
    assert source.made * 20 <= 6 * centers
    assert (image.depth[valid] > 0).all()
    rightly = right(image, truth)
    assert rightly[valid].mean() >= 0.985
    assert rightly[valid & ~unsure].mean() >= 0.985
    assert unsure[valid].mean() <= 0.005
    assert not unsure[~valid].any()
    flat = valid & (np.linalg.norm(image.normals, axis=-1) > 0)
    assert flat.sum() > 0.99 * valid.sum()


@pytest.mark.parametrize("name", CAMERAS)
def test_what_is_seen_by_no_centre_is_unsure(name):
    """With two centres much is hidden: what comes out wrong must be marked."""
    camera = CAMERAS[name]
    image = omniscv.render(
        camera, POSE, ROOM, ("object_mask", "depth"), strategy="reproject", viewpoints=2, face_size=336
    )
    assert Errors(image, ROOM.scene).uncovered.sum() <= 0.0005 * image.valid.sum()


def test_adaptive_captures_more_where_rays_are_lost():
    """From two centres: the rounds add centres, and what was unsure becomes sure."""
    camera = create("noncentral-panorama", width=256, height=128, radius=2.0)
    source = float_source(load_scene("four-wall"))
    arguments = {"viewpoints": 2, "face_size": 192}
    fixed = omniscv.render(camera, POSE, source, ("depth",), strategy="reproject", **arguments)
    first = source.made
    image = omniscv.render(camera, POSE, source, ("depth",), strategy="adaptive", **arguments)
    assert source.made > first
    assert image.unsure.mean() < 0.5 * fixed.unsure.mean()
    truth = traced(ROOM.scene, camera, POSE).distance
    off = np.abs(image.depth - truth) <= 0.01 * truth
    assert off[~image.unsure].mean() > 0.985


def test_a_replay_is_the_same_and_a_missing_view_is_named(tmp_path):
    """One ray of this camera is captured alone, in the smallest view that the server has."""
    camera = create("noncentral-panorama", width=48, height=24, radius=0.5)
    path = tmp_path / "room.sqlite"
    modes = ("lit", "object_mask", "depth")
    with omniscv.open_source("mock://four-wall") as live, omniscv.record(live, path) as source:
        captured = omniscv.render(camera, POSE, source, modes, strategy="adaptive", face_size=96)
    with omniscv.open_source(path) as replay:
        again = omniscv.render(camera, POSE, replay, modes, strategy="adaptive", face_size=96)
        for layer in ("lit", "object_mask", "labels", "depth"):
            np.testing.assert_array_equal(getattr(captured, layer), getattr(again, layer))
        np.testing.assert_array_equal(captured.unsure, again.unsure)
        elsewhere = Pose.from_angles((0.5, 0.0, 1.5))
        with pytest.raises(omniscv.OmniscvError, match="nearest recorded"):
            omniscv.render(camera, elsewhere, replay, modes, strategy="adaptive", face_size=96)


RED = {"kind": "plain", "colors": [[0.9, 0.1, 0.1]]}


def test_the_sky_is_met_at_infinity():
    post = {"texture": RED, "solids": [{"box": [0.3, 0.3, 4], "at": [2, 0, 1]}]}
    scene = Scene("field", {"sky": [0.5, 0.7, 1.0], "objects": {"Post": post}})
    camera = LOW
    image = omniscv.render(camera, POSE, float_source(scene), MODES, strategy="adaptive", face_size=168)
    truth = traced(scene, camera, POSE)
    sky, sure = np.isinf(truth.distance), ~image.unsure
    assert (np.isinf(image.depth) == sky)[sure].mean() > 0.995
    assert sure.mean() > 0.99


def test_a_tighter_bound_makes_more_rays_unsure():
    """The predicted error is that of float32 depth, so a bound far below it leaves little sure."""
    camera, few = LOW, {"strategy": "reproject", "viewpoints": 4, "face_size": 128}
    loose, tight = (
        omniscv.render(camera, POSE, ROOM, ("depth",), max_error_px=bound, **few).unsure.mean()
        for bound in (0.5, 1e-9)
    )
    assert loose < 0.01 < 0.1 < tight


def test_at_one_centre_few_centres_are_the_central_plan():
    circle = create("noncentral-panorama", width=128, height=64, radius=0.0)
    central = create("equirectangular", width=128, height=64)
    a = omniscv.render(circle, POSE, ROOM, MODES, strategy="adaptive", face_size=96)
    b = omniscv.render(central, POSE, ROOM, MODES, face_size=96)
    np.testing.assert_array_equal(a.lit, b.lit)
    np.testing.assert_array_equal(a.depth, b.depth)
    assert not a.unsure.any()
