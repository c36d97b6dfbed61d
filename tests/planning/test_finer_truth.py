"""``truth_scale``: masks, depth and normals from finer captures than colours, with every strategy."""

from functools import cache

import numpy as np
import pytest
from support.exact import FIXED, float_source
from support.plans import plan_of, viewpoints_of, views_of

import omniscv
from mock_server import load_scene
from omniscv import modalities
from omniscv.cameras import create
from omniscv.chart import traced
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)
ROOM = load_scene("four-wall")
RING = create("noncentral-panorama", width=32, height=24, radius=0.3)
SMALL = create("noncentral-panorama", width=12, height=8, radius=0.3)
WIDE = create("fisheye-equidistant", width=96, height=96, fov_deg=180)
NARROW = create("pinhole", width=96, height=96, fov_deg=70)
TRUTH = ("object_mask", "depth")
MODES = ("lit", *TRUTH, "normals")


@cache
def truth_of(camera):
    return traced(ROOM, camera, POSE)


def shown(camera, source, modes=MODES, **options):
    return omniscv.render(camera, POSE, source, modes, face_size=64, **options)


@pytest.mark.parametrize("strategy", ["exact", "cube"])
def test_wrong_labels_fall_in_proportion(strategy):
    """And with them the rims of depth."""
    camera = WIDE if strategy == "cube" else RING
    source, truth = float_source(ROOM), truth_of(camera)
    wrong, off = {}, {}
    for scale in (1, 3):
        image = shown(camera, source, TRUTH, strategy=strategy, truth_scale=scale)
        differs = np.abs(image.depth - truth.distance) > 0.02 * truth.distance
        wrong[scale] = (image.labels != truth.label)[image.valid].mean()
        off[scale] = differs[image.valid].mean()
    assert wrong[3] < wrong[1] / 1.8
    assert off[3] < off[1] / 1.5


@pytest.mark.parametrize("camera", [SMALL, NARROW], ids=["ring", "narrow"])
def test_only_ground_truth_is_finer(camera):
    given = {"face_size": 64, "strategy": "exact"}
    coarse, fine = (plan_of(camera, POSE, truth_scale=scale, **given) for scale in (1, 2))
    assert views_of(coarse) == views_of(fine)
    for viewpoint in viewpoints_of(fine):
        requests = viewpoint.requests(MODES)
        assert len(requests) == len(MODES) * len(viewpoint.views)
        for request in requests:
            finer = 2 if modalities.get(request.mode).truth else 1
            assert request.view in [view.scaled(finer) for view in viewpoint.views]
    source = float_source(ROOM)
    ones, twos = (shown(camera, source, truth_scale=scale, strategy="exact") for scale in (1, 2))
    np.testing.assert_array_equal(ones.lit, twos.lit)
    assert not np.array_equal(ones.labels, twos.labels)


@pytest.mark.parametrize(
    ("strategy", "camera", "size", "modes"),
    [("exact", SMALL, 64, ("lit", "object_mask")), ("exact", WIDE, "auto", TRUTH)],
)
def test_a_recording_replays_with_it(strategy, camera, size, modes, tmp_path):
    """Faces also at the automatic size."""
    path, given = tmp_path / "finer.sqlite", {"strategy": strategy, "truth_scale": 2}
    with omniscv.open_source("scene://four-wall?traces=0") as live, omniscv.record(live, path) as source:
        recorded = omniscv.render(camera, POSE, source, modes, face_size=64, **given)
    with omniscv.open_source(path) as replay:
        replayed = omniscv.render(camera, POSE, replay, modes, face_size=size, **given)
    for mode in modes:
        np.testing.assert_array_equal(getattr(replayed, mode), getattr(recorded, mode))


def test_what_no_source_delivers_is_refused():
    with pytest.raises(ArgumentError, match="cannot set the size"):
        views_of(plan_of(RING, POSE, FIXED, truth_scale=2))
    with pytest.raises(ArgumentError, match="at most 16384 px, got 8 x 4104"):
        views_of(plan_of(NARROW, POSE, truth_scale=8, face_size=4096, strategy="cube"))
