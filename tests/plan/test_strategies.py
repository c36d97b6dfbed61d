"""Plans: every valid pixel in one station, every ray in a view, and no view that no ray needs."""

import numpy as np
import pytest
from exact import cameras_at
from hypothesis import given, settings
from hypothesis import strategies as st

import omniscv
from mock_server import load_scene
from omniscv.cameras import create
from omniscv.captures.source import Capabilities
from omniscv.chart.truth import TracedSource, traced
from omniscv.errors import ArgumentError, MissingCapture
from omniscv.geometry import Pose, cube_rotations
from omniscv.plan import STRATEGIES, make_plan
from omniscv.plan.places import locate

POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)
LEVEL = Pose.from_angles((0.0, 0.0, 1.5))
CAMERAS = cameras_at(96)
ROOM = load_scene("four-wall")
ANY = Capabilities()


def plan_of(camera, pose=POSE, capabilities=ANY, **options):
    return make_plan(camera, pose, capabilities, **options)


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("name", CAMERAS)
def test_every_pixel_is_served_once_and_its_ray_is_seen(name, strategy):
    camera = CAMERAS[name]
    plan = plan_of(camera, strategy=strategy)
    served = np.concatenate([station.pixels for station in plan.stations])
    np.testing.assert_array_equal(np.sort(served), np.flatnonzero(camera.unproject().valid))
    directions = camera.unproject().directions.reshape(-1, 3)
    for station in plan.stations:
        places = locate(directions[station.pixels], station.views, POSE.R_w_c)
        assert (places.view >= 0).all()
        assert places.margin >= min(plan.border_px, 2) - 1e-3
        assert len({(view.width, view.height, view.fov_deg) for view in station.views}) == 1
        assert all(np.array_equal(view.pose.t_w_c, station.center_w) for view in station.views)


@pytest.mark.parametrize("strategy", ["faces", "strips"])
@pytest.mark.parametrize("name", CAMERAS)
def test_no_view_is_captured_for_nothing(name, strategy):
    """Every view of a station serves a ray of it best."""
    camera = CAMERAS[name]
    directions = camera.unproject().directions.reshape(-1, 3)
    for station in plan_of(camera, strategy=strategy, border_px=0).stations:
        places = locate(directions[station.pixels], station.views, POSE.R_w_c)
        assert set(range(len(station.views))) == set(places.view.tolist())


@pytest.mark.parametrize(
    ("camera", "faces"),
    [
        (create("pinhole", width=64, height=64, fov_deg=60), 1),
        (create("fisheye-equidistant", width=64, height=64, fov_deg=180), 5),
        (create("fisheye-equidistant", width=64, height=64, fov_deg=240), 5),
        (create("fisheye-equidistant", width=64, height=64, fov_deg=300), 6),
        (create("equirectangular", width=64, height=32), 6),
    ],
)
def test_only_faces_that_rays_hit(camera, faces):
    assert len(plan_of(camera, pose=LEVEL, strategy="faces")) == faces
    assert len(plan_of(camera, pose=LEVEL, strategy="cube")) == 6


def test_a_column_of_a_panorama_takes_two_to_four_faces():
    plan = plan_of(CAMERAS["noncentral-panorama"], pose=LEVEL, strategy="faces")
    assert {len(station.views) for station in plan.stations} <= {3, 4}


def test_strips_of_the_papers_panorama():
    """1024 x 512, one centre a column: 6144 faces of the paper become 2048 strips of a few pixels."""
    camera = create("noncentral-panorama", width=1024, height=512, radius=1.0)
    cube, strips = (plan_of(camera, strategy=s, pose=LEVEL) for s in ("cube", "strips"))
    pixels = [sum(view.width * view.height for view in plan.views()) for plan in (cube, strips)]
    assert len(cube) == 6144
    assert 2 * len(strips) <= len(cube)
    assert 200 * pixels[1] <= pixels[0]


@pytest.mark.parametrize(
    "name", ["noncentral-panorama", "noncentral-spherical-mirror", "noncentral-conical-mirror"]
)
def test_strips_show_what_cubes_show(name):
    """Within the filter's error: both against exact tracing of the pixels' own rays."""
    camera = cameras_at(96)[name]
    truth, errors = traced(ROOM, camera, LEVEL), {}
    for strategy in ("cube", "strips"):
        image = omniscv.render(
            camera,
            LEVEL,
            TracedSource(ROOM),
            ("lit", "object_mask", "depth"),
            strategy=strategy,
            filter="bilinear",
        )
        valid = image.valid
        relative = np.abs(image.depth - truth.distance)[valid] / truth.distance[valid]
        errors[strategy] = (
            np.sqrt(((image.lit - truth.color)[valid] ** 2).mean()),
            (image.labels != truth.label)[valid].mean(),
            np.median(relative),
        )
    cube, strips = errors["cube"], errors["strips"]
    assert 20 * np.log10(strips[0] / cube[0]) < 2  # dB; at this size a strip's pixel is a wide one
    assert strips[1] < cube[1] + 0.01
    assert strips[2] < 1.5 * cube[2] + 1e-6


def test_strips_of_a_size_that_a_server_takes():
    """A server that refuses less than 16 px gets strips of 16: padded, not cut."""
    camera = CAMERAS["noncentral-panorama"]
    plan = plan_of(camera, capabilities=Capabilities(min_size=16), strategy="strips")
    assert all(min(view.width, view.height) >= 16 for view in plan.views())
    source = TracedSource(ROOM, Capabilities(min_size=16))
    image = omniscv.render(camera, LEVEL, source, ("object_mask",), strategy="strips")
    assert (image.labels == traced(ROOM, camera, LEVEL).label).mean() > 0.95


@given(st.integers(1, 400))
@settings(max_examples=15)
def test_any_number_of_centres(count):
    """One to more than there are columns: never more centres than columns, every pixel served."""
    camera = CAMERAS["noncentral-panorama"]
    plan = plan_of(camera, viewpoints=count, strategy="faces")
    assert len(plan.stations) == min(count, camera.width)
    assert sum(len(station.pixels) for station in plan.stations) == camera.width * camera.height


@pytest.mark.parametrize("count", [0, -3])
def test_no_number_of_centres(count):
    with pytest.raises(ArgumentError, match="count"):
        plan_of(CAMERAS["noncentral-panorama"], viewpoints=count)


def test_one_centre_is_the_axis():
    plan = plan_of(CAMERAS["noncentral-panorama"], viewpoints=1)
    [station] = plan.stations
    np.testing.assert_allclose(station.center_w, POSE.t_w_c, atol=1e-12)


def test_a_source_that_sets_nothing_gets_faces():
    fixed = Capabilities(can_set_size=False, can_set_fov=False, image_size=(256, 256), fov_deg=90.0)
    camera = CAMERAS["noncentral-panorama"]
    assert plan_of(camera, capabilities=fixed).strategy == "faces"
    with pytest.raises(ArgumentError, match="strips need a source"):
        plan_of(camera, capabilities=fixed, strategy="strips")


@pytest.mark.parametrize(("size", "fov"), [((256, 256), 60.0), ((640, 480), 90.0)])
def test_a_source_too_narrow_is_told_what_to_set(size, fov):
    narrow = Capabilities(can_set_size=False, can_set_fov=False, image_size=size, fov_deg=fov)
    with pytest.raises(ArgumentError, match="expected pictures of at least 90 degrees"):
        plan_of(CAMERAS["equirectangular"], capabilities=narrow)


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("strategy", "guess", "expected one of auto, cube"),
        ("face_size", 0, "face_size"),
        ("face_size", 9000, "face_size"),
        ("face_size", "big", "face_size"),
        ("border_px", -1, "border_px"),
    ],
)
def test_wrong_options(option, value, says):
    with pytest.raises(ArgumentError, match=says):
        plan_of(CAMERAS["pinhole"], **{option: value})


def test_a_record_in_which_one_strip_is_missing(tmp_path):
    """The record says which view it lacks, and which one is nearest."""
    camera = create("noncentral-panorama", width=16, height=8, radius=0.5)
    plan = make_plan(camera, LEVEL, ANY, strategy="strips")
    views = list(plan.views())
    path = tmp_path / "most.sqlite"
    with omniscv.open_source("mock://four-wall") as live, omniscv.record(live, path) as source:
        for view in views[:5] + views[6:]:
            list(source.capture([omniscv.captures.Request(view, "depth")]))
    with omniscv.open_source(path) as replay, pytest.raises(MissingCapture, match="nearest recorded"):
        omniscv.render(camera, LEVEL, replay, ("depth",), strategy="strips")


@pytest.mark.parametrize("strategy", ["cube", "strips", "adaptive"])
def test_a_radius_beyond_the_walls_is_told(strategy):
    """The room is 6 m x 5 m: with a radius of 2.7 m some columns begin outside, and just those are marked.

    They show what a camera there would see: nothing is invented.
    """
    camera = create("noncentral-panorama", width=64, height=32, radius=2.7)
    image = omniscv.render(camera, LEVEL, TracedSource(ROOM), ("depth",), strategy=strategy, face_size=64)
    centers_w = LEVEL.to_world(camera.viewpoints().centers)
    outside = np.abs(centers_w[:, 1]) > 2.5
    assert outside.any()
    marked = image.unsure.all(axis=0)
    np.testing.assert_array_equal(marked[outside], True)
    if strategy != "adaptive":
        # what else is marked stands behind furniture or in it, as seen from the middle
        from_the_middle = ROOM.trace(LEVEL.t_w_c, centers_w - LEVEL.t_w_c).distance
        hidden = from_the_middle < 0.97 * 2.7
        seen = from_the_middle > 1.03 * 2.7
        np.testing.assert_array_equal(marked[hidden], True)
        np.testing.assert_array_equal(image.unsure.any(axis=0)[seen], False)


def test_a_mirror_taller_than_the_room_is_told():
    camera = create("noncentral-conical-mirror", width=64, height=64, half_angle_deg=55.0, distance=6.0)
    image = omniscv.render(camera, LEVEL, TracedSource(ROOM), ("depth",), face_size=32)
    assert image.unsure[image.valid].all()


def test_in_the_open_nothing_is_marked():
    image = omniscv.render(
        CAMERAS["noncentral-panorama"], LEVEL, TracedSource(ROOM), ("depth",), face_size=32
    )
    assert not image.unsure.any()


def test_cubes_are_aligned_with_the_world():
    """So that one set of captures serves every orientation."""
    plan = plan_of(CAMERAS["equirectangular"], strategy="cube")
    for view, (_, R_w_c) in zip(plan.views(), cube_rotations(), strict=True):
        np.testing.assert_array_equal(view.pose.R_w_c, R_w_c)
