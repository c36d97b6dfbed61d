"""Images from as many optical centres as the options give: searched live, and composed from recordings.

The truth is the exact trace of the scene.
"""

from pathlib import Path

import numpy as np
import pytest
from support import recorded_room
from support.judged import Errors

import mock_server
import omniscv
from omniscv.cameras import create
from omniscv.geometry import Pose
from omniscv.planning import tuned

MODES = ("lit", "object_mask", "depth")
RING = create("noncentral-panorama", width=96, height=48, radius=0.8)
MIRROR = create("noncentral-spherical-mirror", 64, 64, mirror_radius=0.3, distance=0.3, fov_deg=280)
POSE = Pose.from_angles((0.2, 0.3, 1.4), 25, 4, -3)
CASES = [
    ("exact", 48),
    pytest.param("exact", 65, marks=pytest.mark.soak),
    pytest.param("auto", 128, marks=pytest.mark.soak),
]
"""Strategies and sizes of faces, px: those of 65 px are as large as pictures around the camera."""
KEPT = Path(__file__).parents[2] / "captures"


def rendered(source, camera=RING, strategy="exact", count=4, **options):
    with omniscv.open_source(source) as opened:
        options = {"strategy": strategy, "viewpoints": count, **options}
        return omniscv.render(camera, POSE, opened, MODES, **options)


@pytest.mark.parametrize("strategy", ["auto", "exact"])
@pytest.mark.parametrize("camera", [RING, MIRROR], ids=["ring", "mirror"])
def test_a_search_from_few_centres_leaves_little_in_doubt_and_marks_what_is_wrong(camera, strategy):
    image = rendered("scene://four-wall?traces=0", camera, strategy)
    assert image.doubtful <= tuned.DEFAULT_DOUBT_SHARE
    assert Errors(image, mock_server.load_scene("four-wall")).uncovered.sum() == 0


@pytest.mark.parametrize("count", [1, pytest.param(12, marks=pytest.mark.soak)])
def test_any_number_of_centres_is_searched_from(count):
    image = rendered("scene://four-wall?traces=0", count=count)
    assert image.doubtful <= tuned.DEFAULT_DOUBT_SHARE
    assert image.effort.stopped


@pytest.mark.parametrize(("strategy", "face_size"), CASES)
def test_a_recording_of_a_search_gives_the_image_of_its_source(tmp_path, strategy, face_size):
    path = tmp_path / "search.sqlite"
    options = {"strategy": strategy, "viewpoints": 4, "face_size": face_size}
    with (
        omniscv.open_source("mock://four-wall") as live,
        omniscv.record(live, path) as recorder,
    ):
        image = omniscv.render(RING, POSE, recorder, MODES, **options)
    replay = rendered(path, strategy=strategy, face_size=face_size)
    for layer in image.layers:
        np.testing.assert_array_equal(replay[layer], image[layer], err_msg=layer)


def test_recordings_from_before_the_search_are_composed_as_they_were_made():
    """The kept room was recorded at four centres, without a search: none of it is missing."""
    with omniscv.open_source(KEPT / "living-room.sqlite") as source:
        assert recorded_room.noncentral(source).effort.stopped == ""
