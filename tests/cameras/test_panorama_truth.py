"""Panoramas and the pinhole against their formulas in 50 digits, rays and pixels, to a few roundings."""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

WIDTH, HEIGHT = 1000, 501
DIGITS = 50
place = st.tuples(st.floats(0, WIDTH), st.floats(0, HEIGHT))
VIEWS = {
    "equirectangular": ("equirectangular", {}),
    "angular": ("cylindrical", {"fov_h_deg": 360, "fov_v_deg": 120}),
    "angular, cropped": ("cylindrical", {"fov_h_deg": 100.5, "fov_v_deg": 180}),
    "perspective": ("cylindrical", {"fov_h_deg": 360, "fov_v_deg": 150, "profile": "perspective"}),
    "pinhole": ("pinhole", {"fov_deg": 110}),
}
every_view = pytest.mark.parametrize("view", VIEWS)


def angles(view, pixel):
    """(azimuth to the right, elevation) of a pixel, in 50 digits."""
    u, v = (mp.mpf(x) for x in pixel)
    right, up = 2 * u / WIDTH - 1, 1 - 2 * v / HEIGHT
    parameters = VIEWS[view][1]
    if view == "equirectangular":
        return right * mp.pi, up * mp.pi / 2
    if view == "pinhole":
        half = mp.tan(mp.radians(parameters["fov_deg"]) / 2)
        azimuth = mp.atan(right * half)
        return azimuth, mp.atan(up * half * HEIGHT / WIDTH * mp.cos(azimuth))
    azimuth = right * mp.radians(parameters["fov_h_deg"]) / 2
    half = mp.radians(parameters["fov_v_deg"]) / 2
    return azimuth, mp.atan(up * mp.tan(half)) if view == "perspective" else up * half


def true_direction(view, pixel):
    azimuth, up = angles(view, pixel)
    return mp.matrix([mp.cos(up) * mp.sin(azimuth), -mp.sin(up), mp.cos(up) * mp.cos(azimuth)])


@every_view
@cases(15)
@given(place)
def test_rays_and_pixels(view, pixel):
    name, parameters = VIEWS[view]
    camera = cameras.create(name, width=WIDTH, height=HEIGHT, **parameters)
    rays = camera.unproject(np.array(pixel))
    assert rays.valid
    with mp.workdps(DIGITS):
        truth = true_direction(view, pixel)
        off = mp.norm(mp.matrix([mp.mpf(x) for x in rays.directions.tolist()]) - truth)
    assert off <= 1.5e-15  # angles up to pi are known to 4e-16
    if 0 < pixel[0] < WIDTH and 0 < pixel[1] < HEIGHT:  # the truth, rounded, may lie beyond a border
        again, seen = camera.project(3 * np.array(truth, dtype=float).ravel())
        assert seen
        off = np.abs(again - pixel)
        if view != "pinhole":
            off[0] = min(off[0], WIDTH - off[0])  # both borders are the seam, in a full turn
            off[0] *= np.hypot(*rays.directions[[0, 2]])  # columns meet at the poles
        np.testing.assert_allclose(off, 0, rtol=0, atol=1e-12)


def test_the_cylinder_ends():
    """Directions beyond its field of view are nowhere in the image."""
    camera = cameras.create("cylindrical", width=90, height=90, fov_h_deg=180, fov_v_deg=60)
    h, v = np.radians(
        [[89.9999, 0], [90.0001, 0], [-90.0001, 0], [180, 0], [0, 29.9999], [0, 30.0001], [0, -90]]
    ).T
    rays = np.stack([np.cos(v) * np.sin(h), -np.sin(v), np.cos(v) * np.cos(h)], axis=-1)
    np.testing.assert_array_equal(camera.project(rays)[1], (True, False, False, False, True, False, False))


def test_nothing_behind_a_pinhole_is_seen():
    camera = cameras.create("pinhole", width=90, height=90)
    points = np.array([[0, 0, -1.0], [0, 0, 0], [0.1, 0.1, -5], [1, 0, 0], [1, 0, -1e-300], [0, 0, 1e-300]])
    np.testing.assert_array_equal(camera.project(points)[1], (False,) * 5 + (True,))
