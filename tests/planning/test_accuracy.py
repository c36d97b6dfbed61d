"""``accuracy``: as little in doubt as asked for, for less than finer captures of everything take."""

from itertools import product

import numpy as np
import pytest
from scipy import ndimage
from support.judged import Errors

import mock_server
import omniscv
from mock_server.scene import Scene
from omniscv import Pose, Rig, RigCamera
from omniscv.cameras import create, model
from omniscv.chart import traced
from omniscv.errors import ArgumentError
from omniscv.geometry import cube_rotations
from omniscv.job import load
from omniscv.make import capture as capture_job
from omniscv.make.render import warnings_of
from omniscv.planning import tuned
from omniscv.planning.refinement import nearest_view
from omniscv.sources.base import Capabilities, SourceWrapper, View
from omniscv.sources.recording import Recording
from omniscv.sources.scene import SceneSource, open_scene

POSE = Pose.from_angles((0.13, -0.21, 1.47), yaw_deg=20.0)
TRUTH = ("object_mask", "depth")
MODES = ("lit", *TRUTH)
PANORAMA = create("equirectangular", width=256, height=128)
RING = create("noncentral-panorama", width=48, height=24, radius=0.3)
WIDE = create("fisheye-equidistant", width=96, height=96, fov_deg=170)
NARROW = create("pinhole", width=40, height=30, fov_deg=90)


class Counted(SourceWrapper):
    """Counts captures and their pixels."""

    requests = pixels = 0
    fields = ()
    places = frozenset()

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


def assert_right(image, scene="four-wall"):
    """By exact tracing: 0.05 % at most is wrong and not marked."""
    found = Errors(image, mock_server.load_scene(scene))
    wrong = found.uncovered & (found.label | (found.depth_m > image.depth_error))
    assert wrong[image.valid].mean() <= 0.0005
    return found


@pytest.fixture(scope="module")
def one_percent(tmp_path_factory):
    """An image, what it took, and its recording."""
    path = tmp_path_factory.mktemp("aimed") / "aimed.sqlite"
    counted = source()
    with Recording(counted, path) as live:
        return made(PANORAMA, live, accuracy="1%"), counted, path


def test_an_aim_is_reached_for_less_than_by_finer_captures_of_everything(one_percent):
    """What is not doubted is right, and colours are those of an image without an aim."""
    image, counted, _ = one_percent
    assert image.doubtful <= 0.01
    assert image.effort.stopped == "aim"
    assert (image.effort.captures, image.effort.megapixels) == (counted.requests, counted.pixels / 1e6)
    assert image.seconds == pytest.approx(0.005 * counted.requests + 0.025 * counted.pixels / 1e6)
    with source() as whole:
        finer = made(PANORAMA, whole, truth_scale=3)
    assert finer.doubtful > 0.01
    assert image.seconds < finer.seconds
    np.testing.assert_array_equal(image.lit, finer.lit)
    assert assert_right(image).label[image.valid].mean() < 0.0025  # faces of 384 px: 0.5 %


def test_what_relief_makes_doubtful_is_captured_finer():
    with source(scene="courtyard") as counted:
        plain, image = (made(NARROW, counted, TRUTH, accuracy=aim) for aim in (None, "1%"))
    assert plain.doubtful > 0.1
    assert image.effort.stopped == "aim"
    assert image.doubtful <= 0.01
    assert_right(image, "courtyard")


def test_the_default_spends_no_more_than_its_budget_on_relief(monkeypatch):
    """Its own aim takes this ring more than a thousand captures there."""
    monkeypatch.setattr(tuned, "DEFAULT_MOST_CAPTURES", 30)
    with source(scene="courtyard") as counted:
        image = made(create("noncentral-panorama", width=24, height=12, radius=0.4), counted)
    assert counted.requests == image.effort.captures <= 30
    assert image.effort.stopped == "a budget is spent"


def test_relief_ahead_hides_no_centre_that_is_nearer():
    """Mirror centres 0.4 m ahead at most, before a log wall at 4.8 m whose relief reaches 10 m."""
    ball = model("noncentral-spherical-mirror").example(24)
    pose = Pose.from_angles((0, 0, 1.5))
    with source(scene="courtyard") as counted:
        image = omniscv.render(ball, pose, counted, TRUTH, strategy="exact")
    assert image.unsure[image.valid].mean() < 0.01


@pytest.mark.parametrize("camera", [create("equirectangular", 64, 32), RING], ids=["panorama", "ring"])
def test_captures_end_where_the_source_stores_no_depth(camera):
    """Half floats of centimetres end at 655 m; finer captures gain nothing of what is farther: the first
    round is the last one."""
    grey = {"kind": "plain", "colors": [[0.5, 0.5, 0.5]]}
    solids = [{"box": [200, 200, 900], "at": [900, 0, 0]}, {"box": [1, 1, 6], "at": [8, 3, 1]}]
    towers = Scene("far", {"sky": [0, 0, 1], "objects": {"Tower": {"texture": grey, "solids": solids}}})
    with mock_server.serve(towers) as server, omniscv.open_source(server.uri) as where:
        image = made(camera, where, TRUTH, accuracy="0.3%")
    assert image.effort.stopped == "captures store no depth beyond 655 m"
    assert image.doubtful > 0.003
    assert image.effort.captures <= 20


def test_a_view_of_a_narrow_camera_and_an_aim_that_coarse_captures_reach():
    with source(scene="open") as counted:
        assert made(NARROW, counted, accuracy=0.05).effort.captures == 3
    with source() as counted:
        image = made(NARROW, counted, accuracy="0.3%")
    assert image.doubtful <= 0.003


@pytest.mark.parametrize(
    ("size", "stopped"),
    [({}, "aim"), ({"can_set_size": False, "image_size": (256, 256)}, "the source captures one size")],
    ids=["one field of view", "one picture"],
)
def test_sources_that_cannot_set_views(size, stopped):
    with source(Capabilities(can_set_fov=False, fov_deg=90.0, **size)) as counted:
        image = made(WIDE, counted, TRUTH, accuracy="1.5%")
    assert image.effort.stopped == stopped
    assert (image.doubtful <= 0.015) == (stopped == "aim")
    assert counted.requests > 12 or stopped != "aim"


def test_rays_along_edges_and_diagonals_belong_to_a_face_that_shows_them():
    """At such widths as 300 px, pixels look exactly along the diagonals of faces."""
    views = [View(Pose((0, 0, 1.5), R_w_c), 90, 64, 64) for _, R_w_c in cube_rotations()]
    corners = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
    directions_w = corners[np.any(corners != 0, axis=1)]
    for direction_w, number in zip(directions_w, nearest_view(directions_w, views), strict=True):
        x, y, z = views[number].pose.R_w_c.T @ direction_w
        assert z > 0
        assert max(abs(x), abs(y)) <= z * (1 + 1e-12)  # the rounding of a rotation


@pytest.mark.parametrize("yaw_deg", [0, 90])
def test_faces_become_finer_for_pixels_on_diagonals(yaw_deg):
    camera = create("equirectangular", width=300, height=150)
    pose = Pose.from_angles(tuple(POSE.t_w_c), yaw_deg=yaw_deg)
    with source(Capabilities(can_set_fov=False, fov_deg=90.0)) as counted:
        image = omniscv.render(camera, pose, counted, TRUTH, accuracy="1%")
    assert image.doubtful <= 0.01
    assert_right(image)


def test_budgets_are_kept_and_named():
    for strategy in ("exact", "cube"):
        with source() as counted, pytest.raises(ArgumentError, match=f"strategy 'auto'.* got .*'{strategy}'"):
            made(PANORAMA, counted, strategy=strategy, accuracy="1%")
        assert counted.requests == 0
    for camera, budget in ((PANORAMA, {"most_captures": 16}), (RING, {"most_megapixels": 2.0})):
        with source() as counted:
            image = made(camera, counted, TRUTH, accuracy="0.1%", **budget)
        assert image.effort.stopped == "a budget is spent"
        assert counted.requests <= budget.get("most_captures", np.inf)
        assert counted.pixels <= 1e6 * budget.get("most_megapixels", np.inf)
        assert image.doubtful > 0.001


@pytest.mark.parametrize("camera", [PANORAMA, RING], ids=["one centre", "several"])
def test_a_budget_below_what_is_captured_first_is_refused_and_the_named_one_is_enough(camera):
    with (
        source() as counted,
        pytest.raises(ArgumentError, match="most_captures: expected at least") as refused,
    ):
        made(camera, counted, TRUTH, accuracy="0.1%", most_captures=1)
    assert counted.requests == 0
    least = int(refused.value.message.split("at least ")[1].partition(",")[0])
    with source() as counted:
        image = made(camera, counted, TRUTH, accuracy="0.1%", most_captures=least)
    assert image.effort.captures == counted.requests == least


def test_a_replay_is_the_image_and_one_without_finer_views_says_so(one_percent):
    image, _, path = one_percent
    with omniscv.open_source(path) as replayed:
        again = made(PANORAMA, replayed, accuracy="1%")
        finer = made(PANORAMA, replayed, accuracy="0.2%")
    for layer in ("lit", "labels", "depth", "depth_error", "label_edge"):
        np.testing.assert_array_equal(again[layer], image[layer])
    assert finer.effort.stopped == "the recording holds no finer views"
    assert 0.002 < finer.doubtful <= 0.02


WIDE_RING = create("noncentral-panorama", 48, 24, radius=1.0)


@pytest.mark.parametrize(
    ("camera", "options", "reason"),
    [
        (PANORAMA, {"accuracy": "0.1%", "most_captures": 30}, "a budget is spent"),
        pytest.param(WIDE_RING, {"accuracy": "0.01%"}, "no finer view fits", marks=pytest.mark.soak),
    ],
)
def test_a_replay_ends_for_the_reason_of_the_live_image(camera, options, reason, tmp_path):
    """No centre shows rays past bars narrower than a capture's pixel, so that few are added for them."""
    counted = source(scene="fence")
    with Recording(counted, tmp_path / "fence.sqlite") as live:
        image = made(camera, live, TRUTH, **options)
    assert len(counted.places) <= 12
    with omniscv.open_source(tmp_path / "fence.sqlite") as replayed:
        assert made(camera, replayed, TRUTH, **options).effort == image.effort
    assert image.effort.stopped == reason


def test_several_centres_are_captured_from_few_and_finer_only_at_edges():
    ball = create("noncentral-spherical-mirror", width=32, height=32, mirror_radius=0.3, distance=0.3)
    with source() as counted:
        image = made(ball, counted, TRUTH, accuracy="3%")
    assert image.doubtful <= 0.03
    assert len(counted.places) <= 6
    assert image.seconds < 0.4
    assert_right(image)


def test_rays_that_no_centre_sees_to_their_end_are_unsure_in_colours_alone():
    """Behind a lamp and a ball, areas of a wrong colour were in no layer; errors of a pixel are edges."""
    pose = Pose.from_angles((-0.9, -0.5, 1.4), yaw_deg=25.0)
    camera = create("noncentral-panorama", width=256, height=128, radius=0.6)
    with source() as rooms:
        image = omniscv.render(camera, pose, rooms, ("lit",))
    color = traced(mock_server.load_scene("four-wall"), camera, pose).color
    wrong = (np.abs(image.lit - 255 * color) > 30).any(axis=-1)
    areas = ndimage.binary_erosion(wrong, np.ones((3, 3)))
    assert not np.count_nonzero(areas & ~image.unsure)
    assert image.unsure.mean() < 0.01


def test_no_view_is_narrower_than_an_engine_can_capture():
    """A server refuses less than 1 degree, and the last doubts are spots that narrower views would hold."""
    cube = create("equiangular-cube", width=48, height=32)
    with source() as counted:
        made(cube, counted, TRUTH, accuracy="0.3%")
    assert min(counted.fields) >= 1.0


def test_old_recordings_of_strips_replay_exactly_and_say_so(tmp_path):
    """The pictures that show which centres are occluded are none that an image could be planned with."""
    path = tmp_path / "strips.sqlite"
    ring = create("noncentral-panorama", width=24, height=12, radius=0.3)
    with Recording(source(), path) as live:
        captured = made(ring, live, strategy="exact")
    with omniscv.open_source(path) as replay:
        for options in ({"strategy": "exact"}, {}):
            again = made(ring, replay, **options)
            assert again.effort.strategy == "exact"
            for layer in captured.layers:
                np.testing.assert_array_equal(captured[layer], again[layer])
    assert again.effort.stopped == "the recording holds other captures"
    warning = next(iter(warnings_of("ring", again)))
    assert warning.startswith("ring: strategy exact instead of auto: the recording")


def test_a_job_a_rig_and_a_replay_capture_the_same(tmp_path):
    keys = {"source": "scene://four-wall?traces=0", "cameras": {"ring": RING.to_dict()}, "modes": list(MODES)}
    job = load(keys | {"poses": [{"position": [0.13, -0.21, 1.47], "yaw_deg": 20.0}]})
    count = capture_job(job, tmp_path / "job.sqlite").needed
    with source() as counted:
        rig = Rig({"ring": RigCamera(RING)})
        image = omniscv.render_rig(rig, POSE, counted, MODES)["ring"]
    with omniscv.open_source(tmp_path / "job.sqlite") as replay, Counted(replay) as counted_again:
        again = made(RING, counted_again)
        with pytest.raises(omniscv.OmniscvError, match="nearest recorded"):
            omniscv.render(RING, Pose.from_angles((0.5, 0.0, 1.5)), replay, MODES)
    assert count == counted.requests == counted_again.requests == image.effort.captures
    assert image.effort.stopped == again.effort.stopped == "aim"
    for layer in image.layers:
        np.testing.assert_array_equal(image[layer], again[layer])


def test_the_sky_is_met_at_infinity():
    red = {"kind": "plain", "colors": [[0.9, 0.1, 0.1]]}
    post = {"texture": red, "solids": [{"box": [0.3, 0.3, 4], "at": [2, 0, 1]}]}
    field = Scene("field", {"sky": [0.5, 0.7, 1.0], "objects": {"Post": post}})
    ring = create("noncentral-panorama", width=256, height=32, radius=1.0)
    image = made(ring, SceneSource(field), (*MODES, "normals"))
    sky = np.isinf(traced(field, ring, POSE).distance)
    sure = ~image.unsure
    assert (np.isinf(image.depth) == sky)[sure].mean() > 0.995
    assert sure.mean() > 0.99


def test_at_one_centre_the_plan_is_that_of_a_central_camera():
    circle = create("noncentral-panorama", width=64, height=32, radius=0.0)
    with source() as where:
        image, central = (made(camera, where) for camera in (circle, create("equirectangular", 64, 32)))
    for layer in ("lit", "labels", "depth"):
        np.testing.assert_array_equal(image[layer], central[layer])
    assert not image.unsure.any()
