"""Plans: every valid pixel in one viewpoint, every ray in a view, no view for nothing; finer ground truth."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.exact import FIXED, cameras_at, float_source
from support.plans import plan_of, viewpoints_of, views_of

import omniscv
from mock_server import load_scene
from omniscv import modalities
from omniscv.cameras import create
from omniscv.chart import traced
from omniscv.depth.ray_lookup import look_up
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.geometry import Pose
from omniscv.sources.base import Capabilities

POSE = Pose.from_angles((0.1, -0.2, 1.45), 27, 8, -5)
LEVEL = Pose.from_angles((0.0, 0.0, 1.5))
CAMERAS = cameras_at(48)
ROOM = load_scene("four-wall")
ANY = Capabilities()
COLORS = Capabilities(modes=frozenset({"lit", "object_mask"}))
EXACT = ("exact", "cube")
SCATTERED = ("orthographic",)  # every pixel has an optical centre of its own
LINED_UP = [name for name in CAMERAS if name not in SCATTERED]


def plan(camera, pose=POSE, capabilities=ANY, **options):
    return plan_of(camera, pose, capabilities, **options)


def some(cases):
    """Return cases (name, strategy): every sixth of central cameras, and all others; all with ``--soak``."""
    return [
        pytest.param(*case, marks=[pytest.mark.soak] * (CAMERAS[case[0]].central and i % 6 > 0))
        for i, case in enumerate(cases)
    ]


@pytest.mark.parametrize(("name", "strategy"), some((n, s) for n in LINED_UP for s in EXACT))
def test_every_pixel_is_served_once_and_its_ray_is_seen(name, strategy):
    camera = CAMERAS[name]
    viewpoints = viewpoints_of(plan(camera, strategy=strategy))
    served = np.concatenate([viewpoint.pixels for viewpoint in viewpoints])
    np.testing.assert_array_equal(np.sort(served), np.flatnonzero(camera.unproject().valid))
    directions = camera.unproject().directions.reshape(-1, 3)
    for viewpoint in viewpoints:
        lookup = look_up(directions[viewpoint.pixels], viewpoint.views, POSE.R_w_c)
        assert (lookup.view >= 0).all()
        assert lookup.margin >= 2 - 1e-3
        assert len({(view.width, view.height, view.fov_deg) for view in viewpoint.views}) == 1
        assert all(np.array_equal(view.pose.t_w_c, viewpoint.center_w) for view in viewpoint.views)


@pytest.mark.parametrize(("name", "views"), some((n, each) for each in (ANY, FIXED) for n in LINED_UP))
def test_no_view_is_captured_for_nothing(name, views):
    """Every view of a viewpoint serves a ray of it best: a strip, or a face where views cannot be set."""
    camera = CAMERAS[name]
    directions = camera.unproject().directions.reshape(-1, 3)
    for viewpoint in viewpoints_of(plan(camera, capabilities=views, strategy="exact", border_px=0)):
        lookup = look_up(directions[viewpoint.pixels], viewpoint.views, POSE.R_w_c)
        assert set(range(len(viewpoint.views))) == set(lookup.view.tolist())


@pytest.mark.parametrize("strategy", EXACT)
@pytest.mark.parametrize("name", SCATTERED)
def test_a_centre_for_every_pixel_is_refused(name, strategy):
    with pytest.raises(ArgumentError, match=f"expected 'auto', .* or a number.* got '{strategy}'"):
        views_of(plan(CAMERAS[name], strategy=strategy))
    viewpoints = viewpoints_of(plan(CAMERAS[name], capabilities=COLORS, strategy=strategy, viewpoints=12))
    assert len(viewpoints) <= 12
    # Parallel rays that share a viewpoint may lie within less than the 1 degree of an engine.
    assert min(view.fov_deg for each in viewpoints for view in each.views) >= 1
    served = np.concatenate([viewpoint.pixels for viewpoint in viewpoints])
    np.testing.assert_array_equal(np.sort(served), np.arange(CAMERAS[name].valid().size))


def test_strips_of_the_papers_panorama():
    """One centre a column, as in the paper: six faces each become two strips of a few pixels."""
    camera = create("noncentral-panorama", width=256, height=128, radius=1.0)
    cube, strips = (views_of(plan(camera, strategy=s, pose=LEVEL)) for s in ("cube", "exact"))
    pixels = [sum(view.width * view.height for view in views) for views in (cube, strips)]
    assert len(cube) == 6 * 256
    assert 2 * len(strips) <= len(cube)
    assert 50 * pixels[1] <= pixels[0]


def test_strips_of_a_size_that_a_server_takes():
    camera = CAMERAS["noncentral-panorama"]
    views = views_of(plan(camera, capabilities=Capabilities(min_size=16), strategy="exact"))
    assert all(min(view.width, view.height) >= 16 for view in views)
    source = float_source(ROOM, Capabilities(min_size=16))
    image = omniscv.render(camera, LEVEL, source, ("object_mask",), strategy="exact")
    assert (image.labels == traced(ROOM, camera, LEVEL).label).mean() > 0.95


@given(st.integers(1, 400))
@settings(max_examples=6)
def test_any_number_of_centres(count):
    camera = CAMERAS["noncentral-panorama"]
    viewpoints = viewpoints_of(plan(camera, capabilities=COLORS, viewpoints=count, strategy="exact"))
    assert len(viewpoints) == min(count, camera.width)
    assert sum(len(each.pixels) for each in viewpoints) == camera.width * camera.height


@pytest.mark.parametrize("capabilities", [FIXED, COLORS])
def test_what_cannot_be_planned_is_captured_exactly(capabilities):
    camera = CAMERAS["noncentral-panorama"]
    exact = views_of(plan(camera, capabilities=capabilities, strategy="exact"))
    assert views_of(plan(camera, capabilities=capabilities)) == exact


def test_what_a_source_cannot_set_is_told():
    for size, fov in ((256, 256), 60.0), ((640, 480), 90.0):
        narrow = Capabilities(can_set_size=False, can_set_fov=False, image_size=size, fov_deg=fov)
        with pytest.raises(ArgumentError, match="expected pictures of at least 90 degrees"):
            views_of(plan(CAMERAS["equirectangular"], capabilities=narrow))
    with pytest.raises(ArgumentError, match="cannot set the size"):
        views_of(plan(RING, capabilities=FIXED, truth_scale=2))
    with pytest.raises(ArgumentError, match="at most 16384 px, got 8 x 4104"):
        views_of(plan(NARROW, truth_scale=8, face_size=4096, strategy="cube"))


WRONG_OPTIONS = {
    "viewpoints": (0, -3), "face_size": (0, 9000, "big"), "truth_scale": (0, 9, 1.5, "2"),
    "accuracy": (0, "100%", 1, "much"), "most_captures": (0,), "most_megapixels": (-1,),
    "capture_ms": ((5,), (-1, 5)),
}  # fmt: skip


def test_wrong_options_and_those_that_a_plan_cannot_have():
    for option, values in WRONG_OPTIONS.items():
        example = r".* such as 0\.1%" if option == "accuracy" else ".*expected"
        for value in values:
            with pytest.raises(ArgumentError, match=option + example):
                omniscv.RenderOptions(**{option: value})
    for options, says in (
        ({"strategy": "guess"}, "expected one of auto, exact, cube"),
        ({"strategy": "strips"}, "did you mean exact?"),
        ({"strategy": "adaptive"}, "did you mean auto?"),
        ({"border_px": -1}, "border_px"),
    ):
        with pytest.raises(ArgumentError, match=says):
            views_of(plan(CAMERAS["pinhole"], **options))


def test_a_recording_in_which_one_strip_is_missing(tmp_path):
    camera = create("noncentral-panorama", width=16, height=8, radius=0.5)
    views = views_of(plan(camera, LEVEL, strategy="exact"))
    path = tmp_path / "most.sqlite"
    with omniscv.open_source("mock://four-wall") as live, omniscv.record(live, path) as source:
        for view in views[:5] + views[6:]:
            list(source.capture([omniscv.sources.Request(view, "depth")]))
    with omniscv.open_source(path) as replay, pytest.raises(MissingCaptureError, match="nearest recorded"):
        omniscv.render(camera, LEVEL, replay, ("depth",), strategy="exact")


@pytest.mark.parametrize("strategy", ["cube", "exact", pytest.param("auto", marks=pytest.mark.soak)])
def test_a_radius_beyond_the_walls_is_told(strategy):
    """The room is 6 m x 5 m: with a radius of 2.7 m some columns begin outside, and just those are marked.

    They show what a camera there would see: nothing is invented.
    """
    camera = create("noncentral-panorama", width=32, height=16, radius=2.7)
    aim = {"accuracy": 0.1} if strategy == "auto" else {}
    given = {"strategy": strategy, "face_size": 64, **aim}
    image = omniscv.render(camera, LEVEL, float_source(ROOM), ("depth",), **given)
    centers_w = LEVEL.to_world(camera.viewpoints().centers)
    outside = np.abs(centers_w[:, 1]) > 2.5
    assert outside.any()
    marked = image.occluded.all(axis=0)
    np.testing.assert_array_equal(marked[outside], True)
    if strategy != "auto":
        # what else is marked stands behind furniture or in it, as seen from the middle
        from_the_middle = ROOM.trace(LEVEL.t_w_c, centers_w - LEVEL.t_w_c).distance
        hidden = from_the_middle < 0.97 * 2.7
        seen = from_the_middle > 1.03 * 2.7
        np.testing.assert_array_equal(marked[hidden], True)
        np.testing.assert_array_equal(image.occluded.any(axis=0)[seen], False)


def test_a_mirror_taller_than_the_room_is_told():
    camera = create("noncentral-conical-mirror", width=64, height=64, half_angle_deg=55.0, distance=6.0)
    image = omniscv.render(camera, LEVEL, float_source(ROOM), ("depth",), face_size=32)
    assert image.occluded[image.valid].all()


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
    camera = WIDE if strategy == "cube" else RING
    source = float_source(ROOM)
    truth = truth_of(camera)
    wrong = {}
    off = {}
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
    path = tmp_path / "finer.sqlite"
    given = {"strategy": strategy, "truth_scale": 2}
    with omniscv.open_source("scene://four-wall?traces=0") as live, omniscv.record(live, path) as source:
        recorded = omniscv.render(camera, POSE, source, modes, face_size=64, **given)
    with omniscv.open_source(path) as replay:
        replayed = omniscv.render(camera, POSE, replay, modes, face_size=size, **given)
    for mode in modes:
        np.testing.assert_array_equal(getattr(replayed, mode), getattr(recorded, mode))
