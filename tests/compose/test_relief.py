"""Bounds and marks in fine relief, judged by the tracer of tests/support/relief.py."""

import numpy as np
import pytest
from support.judged import Errors
from support.relief import (
    EDGE_PX,
    FLOATS,
    HALF_FLOATS,
    KINDS,
    MILLIMETRES,
    World,
    captured,
    judge,
    scene_of_bars,
    world,
)

import mock_server
import omniscv
from omniscv.cameras import create
from omniscv.compose.nearest import boundaries
from omniscv.geometry import Pose
from omniscv.planning.depth_shell import depth_shell, distances
from omniscv.planning.relief import planar_errors, planar_relief
from omniscv.sources import Capture, Request, View, codecs

MOST = {1.4: 0.01, 2.0: 0.006, 3.0: 0.003, 4.5: 0.002, 8.0: 0.002}
"""Share of the pixels on a structure that may be wrong and unmarked, by captured px of a feature."""


@pytest.mark.parametrize(
    ("kind", "px", "encoding"),
    [("logs", 3.0, FLOATS), ("saw 20", 2.0, FLOATS), ("bars", 1.4, FLOATS), ("stairs", 1.4, HALF_FLOATS)],
)
def test_relief_is_bounded_or_marked(kind, px, encoding):
    judged = judge(kind, px, 22, encoding, camera_px=120)
    assert judged.depth <= MOST[px], judged
    assert judged.labels <= MOST[px], judged


def test_where_depth_is_in_doubt_labels_among_many_that_stand_alone_are():
    """One bush: between its leaves the wall shows. Without this, .32 % of the labels are wrong, unmarked."""
    assert judge("leaves", 4.5, 21, camera_px=140, objects=1).labels <= MOST[4.5]


def test_what_rays_are_marched_through_knows_its_relief():
    scene, rng = world("logs", 1.4, 11), np.random.default_rng(0)
    view = View(Pose(np.zeros(3), np.eye(3)), 90.0, EDGE_PX, EDGE_PX)
    shell = depth_shell(np.zeros(3), [captured(scene, view)["depth"]], cube=False)
    rays = np.concatenate([rng.uniform(-0.6, 0.6, (2000, 2)), np.ones((2000, 1))], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance, label = scene.trace(rays)
    least, most = distances(shell, rays)
    wrong = (least > distance * (1 + 1e-6)) | (distance > most * (1 + 1e-6))
    assert wrong[label > 1].mean() <= MOST[1.4]


def test_finer_depth_of_a_ring_corrects_rays_that_were_not_in_doubt(tmp_path):
    """Bars of one and a twentieth pixel of the faces that are captured first: they show a smooth wall."""
    path = scene_of_bars(tmp_path, 0.0547)
    ring = create("noncentral-panorama", width=64, height=32, radius=0.4)
    pose = Pose.from_angles((0.13, -0.21, 1.47), yaw_deg=20)
    with omniscv.open_source(f"scene://{path}?traces=0") as source:
        image = omniscv.render(ring, pose, source, ("object_mask", "depth"), face_size=96, accuracy=0.01)
    # Of 2 to 3 % without the correction. A few rays are shown by no finer view.
    assert Errors(image, mock_server.load_scene(path)).uncovered[image.valid].mean() <= 0.005
    assert image.doubtful <= 0.03, "all that is doubtful is not marked, but captured finer"


@pytest.mark.parametrize("encoding", [HALF_FLOATS, MILLIMETRES])
@pytest.mark.parametrize("tilt", [0, 0.02, 2.0])
def test_what_rounding_makes_of_smooth_surfaces_is_no_relief(tilt, encoding):
    """Rounded depth of a wall, of a ball before it, and of a rod, at rest and tilted."""
    scene = World(
        np.array([[-20 - 9 * tilt, -20, 4.5 - 20 * tilt, 40, 0, 40 * tilt, 0, 40, 0.1]]),
        np.array([[0.5, 0.3, 3, 0.8]]),
        np.array([[-1.5, -9, 3, -1, 9, 3 + tilt, 0.3]]),
        tuple(np.array([label]) for label in (1, 2, 3)),
    )
    view = View(Pose(np.zeros(3), np.eye(3)), 90.0, EDGE_PX, EDGE_PX)
    relief = planar_relief(captured(scene, view, encoding)["depth"])
    assert relief is None or (relief > 0).mean() < 0.003, "along the outlines, floats have as much"


def test_labels_of_one_row_or_column_have_boundaries():
    for shape in ((1, 3), (3, 1)):
        marks = boundaries([np.array([5, 5, 7], np.uint8).reshape(shape)])
        assert marks.ravel().tolist() == [0, 1, 1]


@pytest.mark.soak
@pytest.mark.parametrize("encoding", [FLOATS, HALF_FLOATS, MILLIMETRES])
@pytest.mark.parametrize("px", MOST)
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_bounded_or_marked(kind, px, encoding):
    judged = [judge(kind, px, seed, encoding) for seed in (21, 22)]
    assert np.mean([each.depth for each in judged]) <= MOST[px], judged
    assert np.mean([each.labels for each in judged]) <= MOST[px], judged


def test_where_one_capture_says_its_error_the_others_have_one_of_zero():
    view = View(Pose(np.zeros(3), np.eye(3)), 90.0, 4, 4)
    depth, request = np.ones((4, 4), np.float32), Request(view, "depth")
    payload, _ = codecs.encode(np.stack([depth, 0.01 * view.ray_lengths().astype(np.float32)], axis=-1))
    said = Capture(request, view, depth, payload=payload, encoding=codecs.BOUNDED)
    exact, bounded = planar_errors([Capture(request, view, depth, encoding="npy"), said])
    np.testing.assert_allclose([exact, bounded], [0 * depth, 0.01 * depth], rtol=1e-6)
    assert planar_errors([Capture(request, view, depth, encoding="npy")]) == []
