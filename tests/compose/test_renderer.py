"""The renderer: what it keeps, also of the captures of a place, what it refuses, and threads."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest
from support.recordings import CountingSource

import omniscv
from mock_server import load_scene
from omniscv.cameras import create
from omniscv.compose.cache import HeldCaptures
from omniscv.compose.samplers import Sampler
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose, arrays
from omniscv.sources.base import Request, View
from omniscv.sources.scene import SceneSource

ROOM = load_scene("four-wall")
SOURCE = SceneSource(ROOM, lit="float32", cached_views=5000)  # each view is traced once for all tests
POSES = [Pose.from_angles((0.1 * i, 0, 1.5), yaw_deg=17.0 * (i % 2)) for i in range(3)]
CAMERAS = {
    "equirectangular": create("equirectangular", width=48, height=24),
    "fisheye": create("fisheye-equidistant", width=32, height=32, fov_deg=190),
    "panorama": create("noncentral-panorama", width=12, height=8, radius=0.4),
    "coarse": create("pinhole", width=24, height=24, fov_deg=70),
}
MODES = ("lit", "object_mask", "depth", "normals")
SMALL = omniscv.RenderOptions(face_size=64)
GOOD = CAMERAS["fisheye"], POSES[0], SOURCE

pytestmark = pytest.mark.usefixtures("all_cores")


def same(a, b):
    return a.layers.keys() == b.layers.keys() and all(np.array_equal(a[name], b[name]) for name in a.layers)


@cache
def reference(camera, pose, filter="auto"):
    return omniscv.render(camera, pose, SOURCE, MODES, face_size=64, filter=filter)


@pytest.mark.parametrize("filter", ["auto", "area"])
def test_images_of_a_kept_renderer_are_those_of_a_new_one_within_its_bound(filter):
    limit = 1 << 30 if filter == "auto" else 1 << 20
    renderer = omniscv.Renderer(SOURCE, cache_bytes=limit)
    for pose in (*POSES[:2], *POSES[:2]):
        for camera in CAMERAS.values():
            kept = renderer.render(camera, pose, MODES, omniscv.RenderOptions(filter=filter, face_size=64))
            assert same(kept, reference(camera, pose, filter))
            assert 0 < renderer.nbytes <= limit


def test_lookups_of_several_cameras_are_made_once_pose_by_pose():
    """A job's order: all cameras at a pose, then the next pose with the same orientation."""
    made = []

    def sampler(*arguments):
        made.append(arguments)
        return Sampler(*arguments)

    renderer = omniscv.Renderer(SOURCE, sampler=sampler)
    cameras = [camera for camera in CAMERAS.values() if camera.central]
    counts = []
    for x in np.linspace(-1, 1, 5):
        for camera in cameras:
            renderer.render(camera, Pose.from_angles((x, 0, 1.5), yaw_deg=20.0), ("lit", "depth"), SMALL)
        counts.append(len(made))
    assert counts[1:] == [2 * len(cameras)] * 4  # kept when they come a second time


def test_one_renderer_in_several_threads():
    renderer = omniscv.Renderer(SOURCE, cache_bytes=1 << 20)  # small: threads evict each other's
    tasks = [(camera, pose) for pose in POSES for camera in CAMERAS.values()] * 2
    with ThreadPoolExecutor(4) as threads:
        images = list(threads.map(lambda task: renderer.render(*task, MODES, SMALL), tasks))
    assert all(same(image, reference(*task)) for image, task in zip(images, tasks, strict=True))


def test_wrong_arguments_get_one_sentence():
    for arguments, says in (
        ((CAMERAS["fisheye"], POSES[0], "four-wall.sqlite"), "source: expected a Source"),
        ((POSES[0], CAMERAS["fisheye"], SOURCE), "camera: expected a Camera"),
        ((CAMERAS["fisheye"], (0, 0, 1.5), SOURCE), "pose: expected a Pose"),
        *(((*GOOD, modes), "modes: expected a sequence") for modes in ("lit", (), ("labels",))),
        *(((*GOOD, modes), "each once") for modes in (("lit", "lit"), ("mask", "object_mask"))),
        ((*GOOD, ("flow",)), "got 'flow'"),
    ):
        with pytest.raises(ArgumentError, match=says) as caught:
            omniscv.render(*arguments)
        assert "\n" not in str(caught.value)
    with pytest.raises(ArgumentError, match=r"options: expected some of strategy, .*; got colour"):
        omniscv.render(*GOOD, colour=1)


@pytest.mark.parametrize("filter", ["nearest", "bilinear"])
@pytest.mark.parametrize("name", [name for name in CAMERAS if name != "panorama"])
def test_few_pixels_are_those_of_an_image_that_reads_many(name, filter, monkeypatch):
    images = []
    for least in (0, 1 << 40):
        monkeypatch.setattr(arrays, "_FEW", least)
        with SceneSource(ROOM) as source:
            images.append(omniscv.render(CAMERAS[name], POSES[1], source, MODES, face_size=64, filter=filter))
    assert same(*images)
    assert len(np.unique(images[0].lit)) > 10


CAMERA = omniscv.cameras.create("equirectangular", width=16, height=8)
HERE = (0, 0, 1.5)
THERE = (0.2, 0.1, 1.4)
TRUTHS = ("lit", "object_mask", "depth")
OPTIONS = omniscv.RenderOptions(strategy="cube", face_size=16)
ALL = 6 * len(TRUTHS)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("places") / "room.sqlite"
    with omniscv.record(omniscv.open_source("scene://four-wall"), path) as source:
        for place in (HERE, THERE):
            omniscv.render(CAMERA, Pose.from_angles(place), source, TRUTHS, strategy="cube", face_size=16)
    return path


def reads(renderer, place, yaw_deg):
    """Return how many captures an image takes, and the image."""
    renderer.source.requests.clear()
    image = renderer.render(CAMERA, Pose.from_angles(place, yaw_deg=yaw_deg), TRUTHS, OPTIONS)
    return len(renderer.source.requests), image


def test_a_place_is_decoded_once_until_another_one_comes_but_captured_anew_live(recording):
    """And images of held captures are those of new ones."""
    fresh = omniscv.open_source("scene://four-wall?traces=0")
    counts = []
    with CountingSource(omniscv.open_source(recording)) as source:
        renderer = omniscv.Renderer(source)
        for place, yaw_deg in ((HERE, 0), (HERE, 30), (THERE, 30), (THERE, 60), (HERE, 60)):
            count, image = reads(renderer, place, yaw_deg)
            counts.append(count)
            pose = Pose.from_angles(place, yaw_deg=yaw_deg)
            other = omniscv.Renderer(fresh).render(CAMERA, pose, TRUTHS, OPTIONS)
            assert all(np.array_equal(image[name], other[name]) for name in other.layers)
    assert counts == [ALL, 0, ALL, 0, ALL]
    with CountingSource(fresh) as live:
        renderer = omniscv.Renderer(live)
        assert [reads(renderer, HERE, 0)[0], reads(renderer, HERE, 30)[0]] == [ALL, ALL]


@pytest.mark.parametrize("limit", [0, 1 << 15])
def test_what_does_not_fit_is_read_again(recording, limit):
    with CountingSource(omniscv.open_source(recording)) as source:
        renderer = omniscv.Renderer(source, cache_bytes=limit)
        counts = [reads(renderer, HERE, yaw_deg)[0] for yaw_deg in (0, 30)]
        assert renderer.nbytes <= limit
    assert counts == [ALL, ALL] if limit == 0 else counts[0] == ALL and 0 < counts[1] < ALL


def test_what_images_share_is_released_after_the_last_of_them():
    request = Request(View(Pose.from_angles(HERE), 90.0, 16, 16), "lit")
    counts = []
    with CountingSource(omniscv.open_source("scene://four-wall?traces=0")) as source:
        shared = HeldCaptures(source, {request: 2})
        for _ in range(4):
            list(shared.capture([request]))
            counts.append(len(source.requests))
    assert counts == [1, 1, 2, 3]
