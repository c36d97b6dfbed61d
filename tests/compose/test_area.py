"""``area`` shows the mean of what a pixel spans; filters and gutters are exact at their own seams."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.exact import float_source

import omniscv
from mock_server.scene import Scene
from omniscv.cameras import create
from omniscv.compose.atlas import FILTER_SUPPORT_PX, Gutter
from omniscv.depth.interpolation import sample_bicubic, sample_bilinear
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import View

POSE = Pose.from_angles((0.1, 0, 1.5), yaw_deg=15.0, pitch_deg=20.0, roll_deg=10.0)
CAMERAS = {
    "equirectangular": create("equirectangular", width=128, height=64),
    "fisheye-equidistant": create("fisheye-equidistant", width=96, height=96, fov_deg=180),
    "pinhole": create("pinhole", width=48, height=32, fov_deg=60),
}
PIXEL = {"equirectangular": 2 * np.pi / 128, "fisheye-equidistant": np.pi / 96, "pinhole": np.pi / 144}
NONCENTRAL = create("noncentral-panorama", width=32, height=16, radius=0.5)
SUBRAYS = 8


@cache
def waves(period_rad):
    return Scene("waves", {"pattern": {"kind": "waves", "period_rad": period_rad}})


CHECKERS = {"kind": "checker", "colors": [[0.9, 0.9, 0.85], [0.2, 0.25, 0.3]], "scale": 1.0}
HALL = {"texture": CHECKERS, "solids": [{"sphere": 3.0, "at": [0, 0, 1.5]}]}
CHECKERBOARD = Scene("Hall", {"sky": [0.5, 0.6, 0.7], "objects": {"Hall": HALL}})


@cache
def means(scene, camera, subrays=SUBRAYS):
    """(H, W, 3) colours: the mean of the valid ones of a pixel's rays."""
    at = (np.arange(subrays) + 0.5) / subrays - 0.5
    total = np.zeros((camera.height, camera.width, 3))
    count = 0
    for offset in product(at, at):
        rays = camera.unproject(camera.pixels() + offset)
        inside = rays.valid[..., None]
        origins = POSE.position if camera.central else POSE.to_world(np.where(inside, rays.origins, 0))
        rays_w = np.where(inside, rays.directions, (0, 0, 1)) @ POSE.R_w_c.T
        total += inside * scene.trace(origins, rays_w).color
        count = count + inside
    return total / np.maximum(count, 1)


source_of = cache(float_source)


def shown(scene, camera, face_size, filter="area", **options):
    return omniscv.render(camera, POSE, source_of(scene), filter=filter, face_size=face_size, **options)


def rms(image, wanted, where=True):
    """Grey levels of 255."""
    return 255 * np.sqrt(((image.lit - wanted)[image.valid & where] ** 2).mean())


def kept(values, scene, camera):
    """The share of a sinusoid's height that pixels keep, where it is crossed at its own period."""
    rays = camera.unproject()
    directions = np.where(rays.valid[..., None], rays.directions, 0)
    rays_w = directions @ POSE.R_w_c.T
    some = rays.valid[..., None] & (np.abs(rays_w) < 0.3) & (np.abs(directions[..., 1:2]) < 0.3)
    wave = scene.trace((0, 0, 0), rays_w).color[some] - 0.5
    return ((values[some] - 0.5) * wave).sum() / (wave**2).sum()


@pytest.mark.parametrize(
    ("name", "period_px", "face_size"),
    [
        ("equirectangular", 2.5, 160),
        ("fisheye-equidistant", 2.5, 384),
        ("fisheye-equidistant", 4.0, 120),
        ("pinhole", 3.0, 640),
    ],
)
def test_sinusoids_keep_what_the_mean_keeps(name, period_px, face_size):
    """.77 and .85 of their height; the pinhole has one view."""
    camera = CAMERAS[name]
    scene = waves(period_px * PIXEL[name])
    image = shown(scene, camera, face_size)
    wanted = means(scene, camera)
    assert abs(kept(image.lit, scene, camera) - kept(wanted, scene, camera)) <= 0.01
    assert rms(image, wanted) <= 2


@pytest.mark.parametrize(("name", "period_px"), [*zip(CAMERAS, (0.7, 0.9), strict=False)])
def test_sinusoids_shorter_than_a_pixel_keep_no_more_than_the_mean_keeps(name, period_px):
    """A bilinear image shows others in their place, that are not there."""
    camera = CAMERAS[name]
    scene = waves(period_px * PIXEL[name])
    wanted = means(scene, camera)
    image, bilinear = (shown(scene, camera, 384, filter) for filter in ("area", "bilinear"))
    assert abs(kept(image.lit, scene, camera)) <= abs(kept(wanted, scene, camera)) + 0.05
    assert rms(image, wanted) < 0.12 * rms(bilinear, wanted)


def test_at_the_rim_only_what_is_inside_the_field_of_view_counts():
    camera = create("fisheye-equidistant", width=96, height=96, fov_deg=300)
    scene = waves(3 * np.radians(300) / 96)
    image = shown(scene, camera, 384)
    assert (image.lit[~image.valid] == 0).all()
    rim = np.hypot(*(np.indices((96, 96)) - 47.5)) > 46.5
    assert (image.valid & rim).sum() > 200
    assert rms(image, means(scene, camera), rim) <= 4


@pytest.mark.parametrize("strategy", ["cube", "exact"])
def test_pixels_of_a_viewpoint_are_averaged_too(strategy):
    """A strip is as wide as the footprints of its rays."""
    scene = waves(3 * np.pi / 16)
    image = shown(scene, NONCENTRAL, 128, strategy=strategy)
    wanted = means(scene, NONCENTRAL)
    assert rms(image, wanted) <= 2


def test_what_depth_marching_finds_is_averaged_over_the_step_of_a_pixel():
    """Its rays are not the pixels' own, and have no neighbours: their footprints are squares."""
    wanted = means(CHECKERBOARD, NONCENTRAL)
    area, bilinear = (shown(CHECKERBOARD, NONCENTRAL, 128, filter) for filter in ("area", "bilinear"))
    assert rms(area, wanted) < 0.3 * rms(bilinear, wanted)


def test_auto_averages_where_the_image_is_coarser():
    camera = CAMERAS["equirectangular"]
    scene = waves(3 * PIXEL["equirectangular"])
    area, auto, bilinear = (shown(scene, camera, 384, filter).lit for filter in ("area", "auto", "bilinear"))
    assert np.array_equal(area, auto)
    assert not np.array_equal(area, bilinear)


HEIGHT = 24
WIDTH = 31
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
INSIDE = st.tuples(st.floats(1, WIDTH - 3), st.floats(1, HEIGHT - 3))


@given(st.lists(INSIDE, min_size=1, max_size=50), st.tuples(*[st.floats(-2, 2)] * 6))
def test_bicubic_reproduces_quadratics(points, coefficients):
    """Keys' cubic with a = -1/2 reproduces polynomials of the second degree."""
    a, b, c, d, e, f = coefficients

    def polynomial(x, y):
        return a + b * x + c * y + d * x * x / 10 + e * x * y / 10 + f * y * y / 10

    x, y = np.array(points, dtype=np.float32).T
    found = sample_bicubic(polynomial(COLUMNS, ROWS)[..., None].astype(np.float32), x, y)[:, 0]
    np.testing.assert_allclose(found, polynomial(x, y), atol=2e-3)  # float32 of values up to a few hundred


def test_bicubic_rounds_and_clips_whole_numbers_and_is_zero_where_its_support_is_not():
    """Across a step the cubic overshoots by up to 7 %: at the ends of a type's range that is cut off."""
    step = np.where(COLUMNS < 15, 0, 255).astype(np.uint8)[..., None]
    x = np.linspace(10, 20, 200, dtype=np.float32)
    found = sample_bicubic(step, x, np.full_like(x, 10.0))[:, 0].astype(int)
    assert (found.min(), found.max()) == (0, 255)
    assert (np.diff(found) >= 0).all()  # no overshoot that wrapped around
    x = np.array([0.9, 1.0, WIDTH - 2.0, WIDTH - 2.1, -5.0], np.float32)
    ones = np.ones((HEIGHT, WIDTH, 1), np.float32)
    assert sample_bicubic(ones, x, np.full_like(x, 10.0))[:, 0].tolist() == [0.0, 1.0, 0.0, 1.0, 0.0]


def test_remap_takes_any_number_of_points():
    """cv2.remap itself takes no row of 32767 px."""
    for count, row in product((1, 7, 4095, 4096, 4097, 40_000), (0, 5, 40_000)):
        rng = np.random.default_rng(count)
        x, y = (rng.uniform(0, size - 1, count).astype(np.float32) for size in (WIDTH, HEIGHT))
        found = sample_bilinear(COLUMNS + 100 * ROWS, x, y, row)
        assert found.shape == (count,)
        np.testing.assert_allclose(found, x + 100 * y, atol=3.2)  # 1/32 px of the steeper axis
        assert sample_bilinear(np.ones((4, 4, 3), np.uint8), x - 100, y, row).max() == 0


def directions(view, level=0):
    """(H, W, 3) unit rays of a view's pixels, and of so many pixels beyond its edges."""
    margin = FILTER_SUPPORT_PX
    v, u = np.mgrid[-margin : view.height + margin, -margin : view.width + margin] + 0.5
    rays = np.stack([(u - view.width / 2) / view.focal_px, (v - view.height / 2) / view.focal_px], axis=-1)
    rays = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) @ view.pose.R_w_c.T
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


@pytest.mark.parametrize(("bicubic", "error"), [(False, 2e-3), (True, 5e-4)])
def test_a_gutter_continues_what_neighbours_see(bicubic, error):
    """The picture is the ray's direction: beyond an edge it must be that of the plane, continued.

    The error is that of interpolation in a neighbour of 64 px, h^2 / 8 of the largest curvature.
    """
    edge = 64
    views = [View(Pose((0, 0, 0), R_w_c), 90.0, edge, edge) for _, R_w_c in cube_rotations()]
    size = edge + 2 * FILTER_SUPPORT_PX
    atlas = np.zeros((size, 6 * size, 3), np.float32)
    corners = np.array([(k * size + FILTER_SUPPORT_PX, FILTER_SUPPORT_PX) for k in range(6)])
    wanted = [directions(view) for view in views]
    own = slice(FILTER_SUPPORT_PX, -FILTER_SUPPORT_PX)
    for k, rays in enumerate(wanted):
        atlas[own, k * size + FILTER_SUPPORT_PX : (k + 1) * size - FILTER_SUPPORT_PX] = rays[own, own]
    Gutter(views, 0, FILTER_SUPPORT_PX, bicubic).fill(atlas, corners)
    for k, rays in enumerate(wanted):
        found = atlas[:, k * size : (k + 1) * size]
        off = np.abs(found - rays).max(axis=-1)
        corners_px = np.ix_([0, 1, -2, -1], [0, 1, -2, -1])  # at or beyond the edges of both neighbours
        assert off[corners_px].max() < 0.01
        off[corners_px] = 0
        assert off.max() < error


def test_a_gutter_without_neighbours_continues_the_edge():
    view = View(Pose.from_angles((0, 0, 0)), 60.0, 8, 8)
    atlas = np.zeros((12, 12, 1), np.float32)
    atlas[2:-2, 2:-2, 0] = np.arange(8)
    Gutter([view], 0, 2, bicubic=False).fill(atlas, np.array([[2, 2]]))
    np.testing.assert_array_equal(atlas[..., 0], np.broadcast_to([0, 0, *range(8), 7, 7], (12, 12)))
