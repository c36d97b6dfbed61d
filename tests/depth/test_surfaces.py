"""Surfaces between the pixels of a depth picture, against planes whose depth is known at every point."""

import numpy as np
import pytest

from omniscv.depth.surfaces import CONTINUED, surface_point
from omniscv.geometry.precision import Precision, stored_length

EDGE_PX = 12.0
"""A box hides the wall to the left of it."""
BOX_M = 1.0


def wall_m(x):
    """Planar depth of a wall at a grazing angle: 15.4 m where the box ends, 8.5 m four pixels farther."""
    return 1.0 / (0.065 + 0.013 * (x - EDGE_PX))


@pytest.mark.parametrize("turned", [False, True], ids=["across", "down"])
@pytest.mark.parametrize("edge_px", [11.55, 12.0, 12.45])
def test_a_wall_at_a_grazing_angle_behind_an_edge_is_within_the_jump(edge_px, turned):
    """A ray through a pixel of the box, beside its edge, may meet the wall where no pixel shows it."""
    pytest.importorskip("numba")  # Python calls a kernel that others call
    column = np.arange(24) + 0.5
    depth = np.tile(np.where(column < edge_px, BOX_M, wall_m(column)), (24, 1)).astype(np.float32)
    if turned:
        depth = depth.T.copy()
    for x in np.linspace(edge_px, edge_px + 0.5, 9):
        at = (12.2, x) if turned else (x, 12.2)
        point = surface_point(depth.ravel(), 0, depth.shape, *at, 100.0, Precision())
        z = 1.0 / point.inverse
        assert abs(z - wall_m(x)) <= z * z * point.error + point.jump


def test_a_pixel_without_neighbours_has_the_bound_of_an_unknown_slope():
    pytest.importorskip("numba")
    depth = np.full((9, 9), np.inf, np.float32)
    depth[4, 4] = z = 2.0
    point = surface_point(depth.ravel(), 0, depth.shape, 4.4, 4.7, 100.0, Precision())
    assert point.inverse == 1 / z
    assert z * z * point.error >= CONTINUED * z


@pytest.mark.parametrize(("r", "c"), [(0, 0), (3, 11), (7, 5)])
def test_distances_are_stored_where_depth_along_rays_is(r, c):
    """The length of the ray through the pixel to a planar depth of 1 m; 1 where planar depth is stored."""
    at = (r, c, (8, 12), 10.0)
    ray = (c + 0.5 - 6) / 10, (r + 0.5 - 4) / 10, 1.0
    assert stored_length.py_func(*at, Precision(along_ray=True)) == pytest.approx(np.linalg.norm(ray))
    assert stored_length.py_func(*at, Precision()) == 1.0
