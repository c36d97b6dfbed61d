"""A recording is read and decoded once for all images at a place, within the renderer's bound; a live source
is captured anew for each."""

import numpy as np
import pytest
from support.recordings import CountingSource

import omniscv
from omniscv.compose.cache import HeldCaptures
from omniscv.geometry import Pose
from omniscv.sources.base import Request, View

CAMERA = omniscv.cameras.create("equirectangular", width=16, height=8)
HERE, THERE = (0, 0, 1.5), (0.2, 0.1, 1.4)
MODES = ("lit", "object_mask", "depth")
OPTIONS = omniscv.RenderOptions(strategy="cube", face_size=16)
ALL = 6 * len(MODES)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("places") / "room.sqlite"
    with omniscv.record(omniscv.open_source("scene://four-wall"), path) as source:
        for place in (HERE, THERE):
            omniscv.render(CAMERA, Pose.from_angles(place), source, MODES, strategy="cube", face_size=16)
    return path


def reads(renderer, place, yaw_deg):
    """Return how many captures an image takes, and the image."""
    renderer.source.requests.clear()
    image = renderer.render(CAMERA, Pose.from_angles(place, yaw_deg=yaw_deg), MODES, OPTIONS)
    return len(renderer.source.requests), image


def test_a_place_is_decoded_once_until_another_one_comes(recording):
    """And images of held captures are those of new ones."""
    fresh = omniscv.open_source("scene://four-wall?traces=0")
    counts = []
    with CountingSource(omniscv.open_source(recording)) as source:
        renderer = omniscv.Renderer(source)
        for place, yaw_deg in ((HERE, 0), (HERE, 30), (THERE, 30), (THERE, 60), (HERE, 60)):
            count, image = reads(renderer, place, yaw_deg)
            counts.append(count)
            pose = Pose.from_angles(place, yaw_deg=yaw_deg)
            other = omniscv.Renderer(fresh).render(CAMERA, pose, MODES, OPTIONS)
            assert all(np.array_equal(image[name], other[name]) for name in other.layers)
    assert counts == [ALL, 0, ALL, 0, ALL]


@pytest.mark.parametrize("limit", [0, 1 << 15])
def test_what_does_not_fit_is_read_again(recording, limit):
    with CountingSource(omniscv.open_source(recording)) as source:
        renderer = omniscv.Renderer(source, cache_bytes=limit)
        counts = [reads(renderer, HERE, yaw_deg)[0] for yaw_deg in (0, 30)]
        assert renderer.nbytes <= limit
    assert counts == [ALL, ALL] if limit == 0 else counts[0] == ALL and 0 < counts[1] < ALL


def test_a_live_source_is_captured_anew():
    with CountingSource(omniscv.open_source("scene://four-wall?traces=0")) as source:
        renderer = omniscv.Renderer(source)
        assert [reads(renderer, HERE, 0)[0], reads(renderer, HERE, 30)[0]] == [ALL, ALL]


def test_what_images_share_is_released_after_the_last_of_them():
    request = Request(View(Pose.from_angles(HERE), 90.0, 16, 16), "lit")
    with CountingSource(omniscv.open_source("scene://four-wall?traces=0")) as source:
        shared = HeldCaptures(source, {request: 2})
        counts = []
        for _ in range(4):
            list(shared.capture([request]))
            counts.append(len(source.requests))
    assert counts == [1, 1, 2, 3]
