"""Bounds and marks in fine relief, judged by an exact tracer; structures that one size of captures hides."""

from itertools import product

import numpy as np
import pytest
from support import relief
from support.judged import Errors
from support.relief import FLOATS, HALF_FLOATS, MILLIMETRES, MODES, VIEW, captured, judge, world

import mock_server
import omniscv
from omniscv.cameras import create
from omniscv.cli import run
from omniscv.depth.depth_shell import depth_shell, distances
from omniscv.depth.nearest import boundaries
from omniscv.depth.relief import planar_errors, planar_relief
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.geometry import Pose
from omniscv.sources import Capture, Request, View, codecs
from omniscv.sources.base import Capabilities
from omniscv.sources.recording import RecordedSource, Recording
from omniscv.sources.scene import SceneSource, open_scene

MOST = {1.4: 0.01, 2.0: 0.006, 3.0: 0.003, 4.5: 0.002, 8.0: 0.002}
"""Share of the pixels on a structure that may be wrong and unmarked, by captured px of a feature."""


@pytest.mark.parametrize(
    ("kind", "px", "encoding", "objects"),
    [
        ("logs", 3.0, FLOATS, 200), ("saw 20", 2.0, FLOATS, 200), ("bars", 1.4, FLOATS, 200),
        ("stairs", 1.4, HALF_FLOATS, 200),
        ("leaves", 4.5, FLOATS, 1),  # one bush, through which the wall shows
    ],
)  # fmt: skip
def test_relief_is_bounded_or_marked(kind, px, encoding, objects):
    judged = judge(kind, px, 22 - (objects == 1), encoding, camera_px=120, objects=objects)
    assert judged.depth <= MOST[px], judged
    assert judged.labels <= MOST[px], judged


@pytest.mark.parametrize(("kind", "px"), [("half-open louver", 1.7), ("shingles", 4.0)])
def test_no_label_is_sure_where_depth_may_be_of_another_surface(kind, px):
    """The surface that a bound above 1 % admits has a label of its own: some are wrong, by the tracer."""
    scene = world(kind, px, 101, objects=3)
    camera = create("fisheye-equidistant", 200, 200, fov_deg=70)
    image = omniscv.render(camera, AHEAD, relief.Traced(scene), MODES)
    _, label = scene.trace(camera.unproject().directions[image.valid] @ image.pose.R_w_c.T)
    may_be_another = (image.depth_error > 0.01 * image.depth)[image.valid]
    assert 0.1 < may_be_another.mean() < 1
    assert image.label_edge[image.valid][may_be_another].all()
    wrong = (image.labels[image.valid] != label) & ~image.label_edge[image.valid]
    assert wrong.mean() <= 3e-4


def test_a_sky_and_a_bound_that_depth_keeps_mark_no_label():
    with omniscv.open_source("scene://open?traces=0") as source:
        image = omniscv.render(PANORAMA, POSE, source, MODES)
        alone = omniscv.render(PANORAMA, POSE, source, ("object_mask",))
    exact = image.depth_error <= 0.01 * image.depth
    np.testing.assert_array_equal(image.label_edge[exact], alone.label_edge[exact])
    assert np.isinf(image.depth).mean() > 0.3
    assert not image.label_edge[np.isinf(image.depth) & ~alone.label_edge].any()


def test_what_rays_are_marched_through_knows_its_relief():
    scene = world("logs", 1.4, 11)
    rng = np.random.default_rng(0)
    shell = depth_shell(np.zeros(3), [captured(scene, VIEW)["depth"]], cube=False)
    rays = np.concatenate([rng.uniform(-0.6, 0.6, (2000, 2)), np.ones((2000, 1))], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance, label = scene.trace(rays)
    least, most = distances(shell, rays)
    wrong = (least > distance * (1 + 1e-6)) | (distance > most * (1 + 1e-6))
    assert wrong[label > 1].mean() <= MOST[1.4]


@pytest.mark.soak
def test_finer_depth_of_a_ring_corrects_rays_that_were_not_in_doubt(tmp_path):
    """Bars of one and a twentieth pixel of the faces that are captured first: they show a smooth wall."""
    path = relief.scene_of_bars(tmp_path, 0.0547)
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
    scene = relief.World(
        np.array([[-20 - 9 * tilt, -20, 4.5 - 20 * tilt, 40, 0, 40 * tilt, 0, 40, 0.1]]),
        np.array([[0.5, 0.3, 3, 0.8]]),
        np.array([[-1.5, -9, 3, -1, 9, 3 + tilt, 0.3]]),
        tuple(np.array([label]) for label in (1, 2, 3)),
    )
    found = planar_relief(captured(scene, VIEW, encoding)["depth"])
    assert found is None or (found > 0).mean() < 0.003, "along the outlines, floats have as much"


def test_labels_of_one_row_or_column_have_boundaries():
    for shape in ((1, 3), (3, 1)):
        marks = boundaries([np.array([5, 5, 7], np.uint8).reshape(shape)])
        assert marks.ravel().tolist() == [0, 1, 1]


@pytest.mark.soak
@pytest.mark.parametrize("kind", relief.KINDS)
def test_every_kind_is_bounded_or_marked(kind):
    for px, encoding in product(MOST, (FLOATS, HALF_FLOATS, MILLIMETRES)):
        depth, labels = np.mean([judge(kind, px, seed, encoding) for seed in (21, 22)], axis=0)
        assert max(depth, labels) <= MOST[px], (px, encoding, depth, labels)


def test_where_one_capture_says_its_error_the_others_have_one_of_zero():
    view = View(Pose(np.zeros(3), np.eye(3)), 90.0, 4, 4)
    depth = np.ones((4, 4), np.float32)
    request = Request(view, "depth")
    payload, _ = codecs.encode(np.stack([depth, 0.01 * view.ray_lengths().astype(np.float32)], axis=-1))
    said = Capture(request, view, depth, payload=payload, encoding=codecs.BOUNDED)
    exact, bounded = planar_errors([Capture(request, view, depth, encoding="npy"), said])
    np.testing.assert_allclose([exact, bounded], [0 * depth, 0.01 * depth], rtol=1e-6)
    assert planar_errors([Capture(request, view, depth, encoding="npy")]) == []


POSE = Pose.from_angles((0.13, -0.21, 1.47), yaw_deg=20)
AHEAD = Pose(np.zeros(3), Pose.from_angles((0, 0, 0)).R_w_c.T @ Pose.from_angles((0, 0, 0), 0.7).R_w_c)
PANORAMA = create("equirectangular", 128, 64)
RING = create("noncentral-panorama", 32, 16, radius=0.3)


def test_a_beat_is_marked():
    """Logs of 1.05 px of the faces."""
    scene = world("logs", 2.1, 21, 0.0)
    camera = create("fisheye-equidistant", 60, 60, fov_deg=70)

    def unmarked(checks):
        image = omniscv.render(camera, AHEAD, relief.Traced(scene), MODES, face_size=192, checks=checks)
        return relief.judged(image, scene)

    assert max(unmarked("none")) > 0.2
    assert max(unmarked("beat")) <= 0.005


@pytest.mark.soak
def test_a_beat_that_is_found_is_captured_finer(tmp_path):
    path = relief.scene_of_bars(tmp_path, 0.0521)  # a pixel of the faces: they show a smooth wall
    scene = mock_server.load_scene(path)
    wrong = {}
    doubtful = {}
    with omniscv.open_source(f"scene://{path}?traces=0") as source:
        for checks in ("none", "beat"):
            image = omniscv.render(PANORAMA, POSE, source, MODES, face_size=96, checks=checks, accuracy=0.03)
            wrong[checks] = Errors(image, scene).uncovered[image.valid].mean()
            doubtful[checks] = image.doubtful
    assert wrong["none"] > 0.01
    assert wrong["beat"] <= 0.001
    assert doubtful["beat"] <= 0.03


@pytest.mark.parametrize(
    ("scene", "camera"),
    [pytest.param("fence", PANORAMA, marks=pytest.mark.soak), ("six-wall", PANORAMA), ("four-wall", RING)],
)
def test_rooms_are_hardly_marked_more(scene, camera):
    with omniscv.open_source(f"scene://{scene}?traces=0") as source:
        modes = ("lit", *MODES)
        once, twice = (omniscv.render(camera, POSE, source, modes, checks=way) for way in ("none", "beat"))
    assert twice.doubtful <= once.doubtful + 0.003
    if camera.central:  # each of two truths twice, the second time with 1.37 times the pixels each way
        assert twice.effort.captures == once.effort.captures * 5 / 3
        wanted = once.effort.megapixels * (1 + 2 / 3 * 1.37**2)
        assert twice.effort.megapixels == pytest.approx(wanted, rel=0.01)


def test_a_recording_replays_what_it_was_made_with(tmp_path):
    room = "scene://six-wall?traces=0"
    small = ["--position", "0.13,-0.21,1.47", "--set", "face_size=64"]
    for name in ("beat", "none"):
        out = str(tmp_path / f"{name}.sqlite")
        assert run(["record", "--source", room, *small, "--set", f"checks={name}", "--out", out]) == 0
    live = omniscv.render(PANORAMA, POSE, open_scene(room), MODES, face_size=64, checks="beat")
    with RecordedSource(tmp_path / "beat.sqlite") as source:
        replayed = omniscv.render(PANORAMA, POSE, source, MODES, checks="beat")
        plain = omniscv.render(PANORAMA, POSE, source, ("lit", *MODES))
    for layer in ("depth_error", "label_edge"):
        np.testing.assert_array_equal(replayed[layer], live[layer])
    assert plain.effort.captures == 18, "the second size is no image's own"
    says = "second size for 'beat', got one size; record with checks=beat"
    with RecordedSource(tmp_path / "none.sqlite") as source, pytest.raises(MissingCaptureError, match=says):
        omniscv.render(PANORAMA, POSE, source, MODES, checks="beat")


def test_a_recording_replays_finer_captures_of_a_ring(tmp_path):
    """Views that were planned and not captured are not asked for."""
    images = []
    path = tmp_path / "ring.sqlite"
    for opened in (lambda: Recording(open_scene("scene://four-wall"), path), lambda: RecordedSource(path)):
        with opened() as source:
            images.append(omniscv.render(RING, POSE, source, MODES, accuracy=0.02, checks="beat"))
    for layer in ("depth_error", "label_edge"):
        np.testing.assert_array_equal(images[0][layer], images[1][layer])


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(ArgumentError, match="checks: beat expects depth or object_mask in modes, got lit"):
        omniscv.render(PANORAMA, POSE, open_scene("scene://six-wall?traces=0"), checks="beat")
    fixed = Capabilities(frozenset(MODES), can_set_size=False, image_size=(64, 64))
    source = SceneSource(open_scene("scene://six-wall").scene, fixed)
    with pytest.raises(ArgumentError, match="checks: expected none or light of a source of one size"):
        omniscv.render(PANORAMA, POSE, source, MODES, checks="beat")
