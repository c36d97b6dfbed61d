"""``accuracy``: as little in doubt as asked for, for less than finer captures of everything take."""

import numpy as np
import pytest
from support.judged import Errors

import mock_server
import omniscv
from omniscv import Pose
from omniscv.cameras import create
from omniscv.sources.base import Capabilities, SourceWrapper
from omniscv.sources.recording import Recording
from omniscv.sources.scene import SceneSource, open_scene

POSE = Pose.from_angles((0.13, -0.21, 1.47), yaw_deg=20.0)
TRUTH = ("object_mask", "depth")
MODES = ("lit", *TRUTH)
PANORAMA = create("equirectangular", width=256, height=128)
RING = create("noncentral-panorama", width=64, height=32, radius=0.3)
WIDE = create("fisheye-equidistant", width=128, height=128, fov_deg=170)
NARROW = create("pinhole", width=160, height=120, fov_deg=90)


class Counted(SourceWrapper):
    """Counts captures and their pixels."""

    requests = pixels = 0
    fields, places = (), frozenset()

    def capture(self, requests):
        for capture in self._source.capture(requests):
            self.requests += 1
            self.fields += (capture.view.fov_deg,)
            self.places |= {tuple(capture.view.pose.position)}
            self.pixels += capture.view.width * capture.view.height
            yield capture


def source(capabilities=None, scene="four-wall"):
    return Counted(SceneSource(open_scene(f"scene://{scene}").scene, capabilities, cached_views=6))


def made(camera, where, modes=MODES, **options):
    return omniscv.render(camera, POSE, where, modes, **options)


@pytest.fixture(scope="module")
def one_percent(tmp_path_factory):
    """An image, what it took, and its recording."""
    path = tmp_path_factory.mktemp("aimed") / "aimed.sqlite"
    counted = source()
    with Recording(counted, path) as live:
        return made(PANORAMA, live, accuracy="1%"), counted, path


def test_an_aim_is_reached_for_less_than_by_finer_captures_of_everything(one_percent):
    image, counted, _ = one_percent
    assert image.doubtful <= 0.01
    assert image.effort.stopped == "aim"
    assert (image.effort.captures, image.effort.megapixels) == (counted.requests, counted.pixels / 1e6)
    assert image.seconds == pytest.approx(0.005 * counted.requests + 0.025 * counted.pixels / 1e6)
    with source() as whole:
        finer = made(PANORAMA, whole, truth_scale=3)
    assert finer.doubtful > 0.01
    assert image.seconds < finer.seconds


def test_what_is_not_doubted_is_right(one_percent):
    """By exact tracing: patches claim no more than faces do, 0.05 % at most."""
    image = one_percent[0]
    found = Errors(image, mock_server.load_scene("four-wall"))
    wrong = found.uncovered & (found.label | (found.depth_m > image.depth_error))
    assert wrong[image.valid].mean() <= 0.0005
    assert found.label[image.valid].mean() < 0.0025  # faces of 384 px: 0.5 %


def test_colours_are_those_of_an_image_without_an_aim(one_percent):
    with source() as plain:
        np.testing.assert_array_equal(one_percent[0].lit, made(PANORAMA, plain, ("lit",)).lit)


def test_a_view_of_a_narrow_camera_and_an_aim_that_coarse_captures_reach():
    with source(scene="open") as counted:
        assert made(NARROW, counted, accuracy=0.05).effort.captures == 3
    with source() as counted:
        image = made(NARROW, counted, accuracy="0.3%")
    assert image.doubtful <= 0.003


@pytest.mark.parametrize(
    ("capabilities", "stopped"),
    [
        (Capabilities(can_set_fov=False, fov_deg=90.0), "aim"),
        (
            Capabilities(can_set_fov=False, fov_deg=90.0, can_set_size=False, image_size=(256, 256)),
            "the source captures one size",
        ),
    ],
    ids=["one field of view", "one picture"],
)
def test_sources_that_cannot_set_views(capabilities, stopped):
    with source(capabilities) as counted:
        image = made(WIDE, counted, TRUTH, accuracy="1.5%")
    assert image.effort.stopped == stopped
    assert (image.doubtful <= 0.015) == (stopped == "aim")
    assert counted.requests > 12 or stopped != "aim"


def test_budgets_are_kept_and_named():
    for camera, budget in ((PANORAMA, {"most_captures": 16}), (RING, {"most_megapixels": 3.0})):
        with source() as counted:
            image = made(camera, counted, TRUTH, accuracy="0.1%", **budget)
        assert image.effort.stopped == "a budget is spent"
        assert counted.requests <= budget.get("most_captures", np.inf)
        assert counted.pixels <= 1e6 * budget.get("most_megapixels", np.inf)
        assert image.doubtful > 0.001


def test_a_replay_is_the_image_and_one_without_finer_views_says_so(one_percent):
    image, _, path = one_percent
    with omniscv.open_source(path) as replayed:
        again = made(PANORAMA, replayed, accuracy="1%")
        finer = made(PANORAMA, replayed, accuracy="0.2%")
    for layer in ("lit", "labels", "depth", "depth_error", "label_edge"):
        np.testing.assert_array_equal(again[layer], image[layer])
    assert finer.effort.stopped == "the recording holds no finer views"
    assert 0.002 < finer.doubtful <= 0.02


def test_several_centres_are_captured_from_few_and_finer_only_at_edges():
    ball = create("noncentral-spherical-mirror", width=48, height=48, mirror_radius=0.3, distance=0.3)
    with source() as counted:
        image = made(ball, counted, TRUTH, accuracy="3%")
    assert image.doubtful <= 0.03
    assert len(counted.places) <= 6
    assert image.seconds < 0.4
    found = Errors(image, mock_server.load_scene("four-wall"))
    wrong = found.uncovered & (found.label | (found.depth_m > image.depth_error))
    assert wrong[image.valid].mean() <= 0.0005


def test_centres_are_added_only_while_they_show_what_was_hidden():
    """Rays past these bars, narrower than a capture's pixel, are certified from no centre."""
    ring = create("noncentral-panorama", width=48, height=24, radius=1.0)
    with source(scene="fence") as counted:
        image = made(ring, counted, TRUTH, accuracy="0.01%")
    assert image.effort.stopped
    assert len(counted.places) <= 12


def test_a_ring_of_centres_becomes_finer_until_it_is_accurate():
    with source() as counted:
        image = made(RING, counted, TRUTH, accuracy="2%")
    assert image.doubtful <= 0.02
    assert image.effort.stopped == "aim"


def test_no_view_is_narrower_than_an_engine_can_capture():
    """A server refuses less than 1 degree, and the last doubts are spots that narrower views would hold."""
    cube = create("equiangular-cube", width=96, height=64)
    with source() as counted:
        made(cube, counted, TRUTH, accuracy="0.3%")
    assert min(counted.fields) >= 1.0
