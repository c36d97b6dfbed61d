"""Filters and gutters at their own seams: exact where theory says so."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omniscv.compose.atlas import FILTER_SUPPORT_PX, Gutter
from omniscv.compose.interpolation import sample_bicubic, sample_bilinear
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import View

HEIGHT, WIDTH = 24, 31
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


def test_bicubic_rounds_and_clips_whole_numbers():
    """Across a step the cubic overshoots by up to 7 %: at the ends of a type's range that is cut off."""
    step = np.where(COLUMNS < 15, 0, 255).astype(np.uint8)[..., None]
    x = np.linspace(10, 20, 200, dtype=np.float32)
    found = sample_bicubic(step, x, np.full_like(x, 10.0))[:, 0].astype(int)
    assert found.min() == 0
    assert found.max() == 255
    assert (np.diff(found) >= 0).all()  # no overshoot that wrapped around


def test_bicubic_is_zero_where_its_support_is_not():
    ones = np.ones((HEIGHT, WIDTH, 1), np.float32)
    x = np.array([0.9, 1.0, WIDTH - 2.0, WIDTH - 2.1, -5.0], np.float32)
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
