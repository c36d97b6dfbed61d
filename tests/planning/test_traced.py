"""Ground truth by one ray a pixel, of sources that trace; rays marched through depth from another centre."""

from dataclasses import replace

import numpy as np
import pytest
from support.exact import float_source

import omniscv
from mock_server import load_scene
from omniscv.chart import traced
from omniscv.depth.depth_shell import depth_shell
from omniscv.depth.ray_marching import march
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose, cube_rotations
from omniscv.planning.sharing import cost
from omniscv.sources.base import Request, View

pytestmark = pytest.mark.rays

POSE = omniscv.Pose.from_angles((0.13, -0.21, 1.47), 20, -5, 3)
CAMERAS = {
    "ring": omniscv.cameras.create("noncentral-panorama", width=32, height=16, radius=0.4),
    "ball": omniscv.cameras.create(
        "noncentral-spherical-mirror", width=32, height=32, mirror_radius=0.3, distance=0.3, fov_deg=280
    ),
    "push-broom": omniscv.cameras.create("push-broom", width=40, height=30, travel=(1, 0.2, 0), fov_deg=90),
}
CENTRAL = {
    "pinhole": omniscv.cameras.create("pinhole", width=40, height=30, fov_deg=80),
    "fisheye": omniscv.cameras.create("fisheye-equidistant", width=48, height=48, fov_deg=200),
    "panorama": omniscv.cameras.create("equirectangular", width=64, height=32),
}
DATA = ("object_mask", "depth", "normals")


@pytest.mark.parametrize("camera", [*CAMERAS.values(), *CENTRAL.values()], ids=[*CAMERAS, *CENTRAL])
@pytest.mark.parametrize("strategy", ["auto", "exact"])
@pytest.mark.parametrize("masks", ["ids", "colors"])
def test_each_pixel_shows_what_its_own_ray_meets(camera, strategy, masks):
    with omniscv.open_source(f"scene://courtyard?masks={masks}") as source:
        image = omniscv.render(camera, POSE, source, DATA, strategy=strategy)
        assert image.effort.traced == DATA
        assert image.provenance["traced"] == list(DATA)
        truth = traced(source, camera, POSE)
        table = source.objects()
    valid = image.valid
    assert image.effort.captures == 0
    assert (image.labels[valid] == truth.label[valid]).all()
    shown = image.object_mask[valid]  # of ids, as the colours made up for them
    colors = np.array([(0, 0, 0), *(table.colors[name] for name in table.names())])
    assert (shown == colors[truth.label[valid]]).all()
    met = np.isfinite(truth.distance) & valid
    assert (np.isposinf(image.depth[valid]) == ~met[valid]).all()
    assert (np.abs(image.depth[met] - truth.distance[met]) <= image.depth_error[met]).all()
    np.testing.assert_allclose(image.normals[met], (truth.normal @ POSE.R_w_c)[met], atol=1e-6)
    assert image.doubtful == 0
    points = np.sort(image.points(), axis=0)
    origins = np.broadcast_to(POSE.to_world(camera.unproject().origins), truth.normal.shape)[met]
    ends = origins + (camera.unproject().directions @ POSE.R_w_c.T * truth.distance[..., None])[met]
    np.testing.assert_allclose(points, np.sort(ends, axis=0), atol=1e-5)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_objects_that_stand_for_the_sky_are_the_sky_of_rays(camera):
    """As of captures, up to what these mark as doubtful."""
    images = {}
    for address in ("scene://four-wall", "scene://four-wall?traces=0"):
        with omniscv.open_source(address) as source:
            images[address] = omniscv.render(
                camera, POSE, source, DATA, sky=("Layout_Ceiling", "Layout_Floor")
            )
            truth = traced(source, camera, POSE)
            table = source.objects()
    rays, captured = images.values()
    sky = rays.valid & np.isin(truth.label, [table.label("Layout_Ceiling"), table.label("Layout_Floor")])
    assert 0.1 < sky.mean() < 0.9
    for name, value in {
        "depth": np.inf,
        "depth_error": 0,
        "labels": 0,
        "object_mask": 0,
        "normals": 0,
    }.items():
        assert (rays[name][sky] == value).all(), name
    assert np.isfinite(rays.depth[~sky]).all()
    sure = captured.valid & ~captured.doubt
    assert (np.isinf(captured.depth) == sky)[sure].all()
    assert (rays.labels == captured.labels)[sure].all()


def test_colours_beside_them_are_captured_as_alone_and_centres_behind_a_wall_are_marked():
    """The ring around a place 0.2 m from the wall x = 3 goes through it; options ask for shared captures."""
    ring = CAMERAS["ring"]
    behind = omniscv.Pose.from_angles((2.8, 0, 1.5))
    with omniscv.open_source("scene://four-wall") as source:
        alone = omniscv.render(ring, POSE, source, ("lit",), color_rays=0)
        image = omniscv.render(ring, POSE, source, ("lit", *DATA), color_rays=0)
        labels = traced(source, ring, POSE).label
        marked = omniscv.render(ring, behind, source, DATA)
        for options in ({"strategy": "cube", "face_size": 16}, {"viewpoints": 4}):
            assert omniscv.render(ring, POSE, source, ("depth",), **options).effort.captures > 0
    assert np.array_equal(image.lit, alone.lit)
    assert np.array_equal(image.unsure, alone.unsure)
    assert np.array_equal(image.labels, labels)
    assert image.effort == replace(alone.effort, traced=DATA)
    outside = marked.centers_w[..., 0] > 3
    assert 0.1 < outside.mean() < 0.5
    assert (marked["occluded"] == outside).all()


@pytest.mark.parametrize("camera", CENTRAL.values(), ids=CENTRAL)
def test_central_colours_are_captured_beside_rays(camera):
    """The same faces as without ground truth; ``cube`` and ``?traces=0`` capture all."""
    with omniscv.open_source("scene://four-wall") as source:
        alone = omniscv.render(camera, POSE, source, ("lit",))
        image = omniscv.render(camera, POSE, source, ("lit", *DATA))
        cube = omniscv.render(camera, POSE, source, DATA, strategy="cube")
        labels = traced(source, camera, POSE).label
    with omniscv.open_source("scene://four-wall?traces=0") as source:
        captured = omniscv.render(camera, POSE, source, DATA)
    assert np.array_equal(image.lit, alone.lit)
    assert np.array_equal(image.labels[image.valid], labels[image.valid])
    assert image.effort.captures == alone.effort.captures
    assert "occluded" not in image.layers
    for other in (cube, captured):
        assert other.effort.captures > 0
        assert other.effort.traced == ()
        assert "traced" not in other.provenance


def test_central_cameras_at_one_place_share_captures_of_colours_alone():
    turned = omniscv.Pose.from_angles((0.13, -0.21, 1.47), 90, -5, 3)
    shots = [(CENTRAL["fisheye"], POSE), (CENTRAL["fisheye"], turned)]
    with omniscv.open_source("scene://four-wall") as source:
        renderer = omniscv.Renderer(source)
        colors = list(renderer.render_together(shots, ("lit",)))
        images = list(renderer.render_together(shots, ("lit", *DATA)))
        data = list(renderer.render_together(shots, DATA))
    for image, alone, pure in zip(images, colors, data, strict=True):
        assert np.array_equal(image.lit, alone.lit)
        assert image.effort.captures == alone.effort.captures
        assert pure.effort.captures == 0
        for mode in ("labels", "depth", "normals"):
            assert np.array_equal(image[mode], pure[mode])


def test_an_image_in_blocks_of_rows_shows_what_its_rays_meet():
    """Memory for a seventh of the image: several blocks, each cut where it is traced."""
    camera = omniscv.cameras.create("equirectangular", width=128, height=64)
    with omniscv.open_source("scene://courtyard") as source:
        whole = omniscv.render(camera, POSE, source, DATA)
        small = omniscv.Renderer(source, cache_bytes=0, tile_bytes=128 * camera.width * 10)
        image = small.render(camera, POSE, DATA)
    assert not small.plan(camera, POSE).rays.kept
    for name in whole.layers:
        assert np.array_equal(whole[name], image[name]), name


def test_plans_cost_no_captures_of_what_rays_tell():
    camera = CENTRAL["fisheye"]
    with omniscv.open_source("scene://four-wall") as source:
        plan = omniscv.Renderer(source).plan(camera, POSE)
    data = cost("auto", [[plan]], DATA)
    both = cost("auto", [[plan]], ("lit", *DATA))
    colors = cost("auto", [[plan]], ("lit",))
    assert (data.requests, data.pixels, data.marked, data.traced) == (0, 0, 0.0, DATA)
    assert (both.requests, both.pixels, both.traced) == (colors.requests, colors.pixels, DATA)
    assert cost("cube", [[plan]], DATA, strategy="cube").requests > 0


def test_a_recording_holds_captures_in_place_of_rays(tmp_path):
    with omniscv.record(omniscv.open_source("scene://four-wall"), tmp_path / "room.sqlite") as source:
        live = omniscv.render(CAMERAS["ring"], POSE, source, DATA)
        assert live.effort.captures > 0
    with omniscv.open_source(tmp_path / "room.sqlite") as replay:
        image = omniscv.render(CAMERAS["ring"], POSE, replay, DATA)
        with pytest.raises(ArgumentError, match="expected one that traces rays"):
            replay.trace(np.zeros(3), np.array([[1.0, 0, 0]]))
    assert all(np.array_equal(image[name], live[name]) for name in live.layers)


FENCE = load_scene("fence")
CENTER = np.array([0.13, 0.11, 1.43])
FACE_PX = 384


@pytest.fixture(scope="module")
def shell():
    views = [View(Pose(CENTER, R_w_c), 90.0, FACE_PX, FACE_PX) for _, R_w_c in cube_rotations()]
    captures = float_source(FENCE).capture([Request(view, "depth") for view in views])
    return depth_shell(CENTER, list(captures))


@pytest.mark.parametrize("aside_m", [0.003, 0.1, 0.4])
def test_rays_through_a_fence_end_within_their_bounds(aside_m, shell):
    """Its bars are two pixels wide, and a ray from beside the centre passes them within a step of a pixel."""
    rng = np.random.default_rng(7)
    origins = CENTER + aside_m * rng.normal(size=(20_000, 3)) / np.sqrt(3)
    directions = rng.uniform((2.6, -1.1, 0.2), (2.6, 1.1, 1.9), (20_000, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    truth = FENCE.trace(origins, directions).distance
    hits = march(shell, origins, directions)
    known = hits.sure & np.isfinite(hits.reach)
    off = np.abs(hits.reach - truth)[known]
    wrong = off > hits.known_depth().error[known] + 1e-4  # metres: captures are float32
    assert known.mean() > 0.5
    assert not wrong.any()


def test_rays_end_within_the_bounds_of_finer_views(shell):
    bars = Pose(CENTER, cube_rotations()[0][1])
    (finer,) = float_source(FENCE).capture([Request(View(bars, 60.0, 1600, 1600), "depth")])
    rng = np.random.default_rng(7)
    origins = CENTER + 0.05 * rng.normal(size=(20_000, 3))
    directions = rng.uniform((2.6, -1.1, 0.6), (2.6, 1.1, 1.9), (20_000, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    truth = FENCE.trace(origins, directions).distance
    coarse, hits = (march(some, origins, directions) for some in (shell, shell.refined([finer])))
    known = hits.sure & np.isfinite(hits.reach)
    of_coarse = coarse.sure & np.isfinite(coarse.reach)
    depth = hits.known_depth()
    coarse_depth = coarse.known_depth()
    assert not (np.abs(hits.reach - truth)[known] > depth.error[known] + 1e-4).any()
    assert (depth.grazes & hits.sure).mean() < 0.6 * (coarse_depth.grazes & coarse.sure).mean()
    assert np.median(depth.error[known]) < np.median(coarse_depth.error[of_coarse])


def test_two_centres_are_unsure_only_of_what_both_are_unsure_of(shell):
    """A ray that grazes one post for each centre passes both: together they know that it does."""
    rng = np.random.default_rng(6)
    other_w = np.add(CENTER, (0, 0.4, 0))
    views = [View(Pose(other_w, R_w_c), 90.0, FACE_PX, FACE_PX) for _, R_w_c in cube_rotations()]
    other = depth_shell(
        other_w, list(float_source(FENCE).capture([Request(view, "depth") for view in views]))
    )
    origins = CENTER + rng.uniform((-0.3, -0.2, -0.2), (0.3, 0.9, 0.3), (6000, 3))
    directions = rng.uniform((2.6, -1.2, 0.1), (2.6, 1.25, 2.05), (6000, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    truth = FENCE.trace(origins, directions).distance
    one, two = (march(each, origins, directions) for each in (shell, other))
    both = one.copy()
    agree = both.narrow(two)
    doubtful = [(each.known_depth().grazes | each.known_depth().unsure) for each in (one, two, both)]
    assert agree.mean() > 0.8
    assert doubtful[2].mean() < 0.85 * min(doubtful[0].mean(), doubtful[1].mean())
    clear = agree & ~doubtful[2]
    assert not (np.abs(both.reach - truth)[clear] > both.known_depth().error[clear] + 1e-4).any()
    assert both[~agree].tobytes() == one[~agree].tobytes()
