"""``checks: beat``: structures that one size of captures hides are marked, and ordinary rooms hardly more."""

import numpy as np
import pytest
from support.judged import Errors
from support.relief import MODES, Traced, judged, scene_of_bars, world

import mock_server
import omniscv
from omniscv.cameras import create
from omniscv.cli import run
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.geometry import Pose
from omniscv.sources.base import Capabilities
from omniscv.sources.recording import RecordedSource, Recording
from omniscv.sources.scene import SceneSource, open_scene

POSE = Pose.from_angles((0.13, -0.21, 1.47), yaw_deg=20)
LEVEL = Pose.from_angles((0, 0, 0)).R_w_c
AHEAD = Pose(np.zeros(3), LEVEL.T @ Pose.from_angles((0, 0, 0), yaw_deg=0.7).R_w_c)
PANORAMA = create("equirectangular", 128, 64)
RING = create("noncentral-panorama", 48, 24, radius=0.3)


def test_a_beat_is_marked():
    scene, camera = world("logs", 1.05, 21, 0.0), create("fisheye-equidistant", 120, 120, fov_deg=70)

    def unmarked(checks):
        image = omniscv.render(camera, AHEAD, Traced(scene), MODES, face_size=384, checks=checks)
        return judged(image, scene)[:2]

    assert max(unmarked("none")) > 0.2
    assert max(unmarked("beat")) <= 0.005


@pytest.mark.soak
def test_a_beat_that_is_found_is_captured_finer(tmp_path):
    path = scene_of_bars(tmp_path, 0.0521)  # a pixel of the faces: they show a smooth wall
    scene, wrong, doubtful = mock_server.load_scene(path), {}, {}
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
        once, twice = (
            omniscv.render(camera, POSE, source, ("lit", *MODES), checks=checks)
            for checks in ("none", "beat")
        )
    assert twice.doubtful <= once.doubtful + 0.003
    if camera.central:  # each of two truths twice, the second time with 1.37 times the pixels each way
        assert twice.effort.captures == once.effort.captures * 5 / 3
        wanted = once.effort.megapixels * (1 + 2 / 3 * 1.37**2)
        assert twice.effort.megapixels == pytest.approx(wanted, rel=0.01)


def test_a_recording_replays_what_it_was_made_with(tmp_path):
    record = ["record", "--source", "scene://six-wall?traces=0", "--position", "0.13,-0.21,1.47"]
    for name in ("beat", "none"):
        out = str(tmp_path / f"{name}.sqlite")
        assert run([*record, "--set", "face_size=64", "--set", f"checks={name}", "--out", out]) == 0
    live = omniscv.render(
        PANORAMA, POSE, open_scene("scene://six-wall?traces=0"), MODES, face_size=64, checks="beat"
    )
    with RecordedSource(tmp_path / "beat.sqlite") as source:
        replayed = omniscv.render(PANORAMA, POSE, source, MODES, checks="beat")
        plain = omniscv.render(PANORAMA, POSE, source, ("lit", *MODES))
    for layer in ("depth_error", "label_edge"):
        np.testing.assert_array_equal(replayed[layer], live[layer])
    assert plain.effort.captures == 18, "the second size is no image's own"
    with (
        RecordedSource(tmp_path / "none.sqlite") as source,
        pytest.raises(
            MissingCaptureError, match="second size for 'beat', got one size; record with checks=beat"
        ),
    ):
        omniscv.render(PANORAMA, POSE, source, MODES, checks="beat")


def test_a_recording_replays_finer_captures_of_a_ring(tmp_path):
    """Views that were planned and not captured are not asked for."""
    images, path = [], tmp_path / "ring.sqlite"
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
