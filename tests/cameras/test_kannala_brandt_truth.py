"""Kannala-Brandt against ``cv2.fisheye``, and against bisection in 50 digits where OpenCV does not go.

OpenCV's pixel centres are whole numbers, ours end in .5: its principal point is ours less half a pixel, and
so is every pixel it answers. It works on x / z, so its truth ends before 90 degrees off the axis.
"""

import cv2
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

LENS = {"width": 640, "height": 480, "fx": 180.0, "fy": 183.0, "cx": 322.25, "cy": 238.5}
COEFFICIENTS = [
    (0.0, 0.0, 0.0, 0.0),
    (0.02, -0.008, 0.002, -0.0004),
    (-0.0134, 0.0207, -0.0121, 0.0026),  # of the size that calibrations of real lenses give
    (0.1, 0.05, 0.02, 0.01),
]
DIGITS = 50
every_lens = pytest.mark.parametrize("k", COEFFICIENTS)


def opencv(k):
    """K and D of ``LENS`` in OpenCV's pixels."""
    K = np.array([[LENS["fx"], 0, LENS["cx"] - 0.5], [0, LENS["fy"], LENS["cy"] - 0.5], [0, 0, 1]])
    return K, np.array(k)


@every_lens
def test_pixels_are_opencvs(k):
    camera = cameras.create("kannala-brandt", **LENS, k=k)
    K, D = opencv(k)
    rng = np.random.default_rng(0)
    theta, azimuth = np.radians(rng.uniform(0, 89, 5000)), rng.uniform(-np.pi, np.pi, 5000)
    across = np.sin(theta)
    rays = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(theta)], axis=-1)
    points = rays * rng.uniform(0.1, 100, (5000, 1))
    theirs = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, D)[0][:, 0] + 0.5
    ours, seen = camera.project(points)
    inside = ((theirs > 0) & (theirs < (LENS["width"], LENS["height"]))).all(axis=1)
    np.testing.assert_array_equal(seen, inside)
    assert seen.mean() > 0.5
    np.testing.assert_allclose(ours[seen], theirs[seen], rtol=0, atol=1e-11)


@mp.workdps(DIGITS)
def theta_by_bisection(k, d):
    """theta in [0, pi] with d(theta) = d, for coefficients that increase there."""
    low, high = mp.mpf(0), mp.pi
    for _ in range(64):  # 1e-19
        middle = (low + high) / 2
        value = middle + sum(mp.mpf(c) * middle ** (2 * i + 3) for i, c in enumerate(k))
        low, high = (middle, high) if value < d else (low, middle)
    return low


@pytest.mark.parametrize("k", [COEFFICIENTS[0], COEFFICIENTS[3], (0.02, -0.008, 0.002, 0.0001)])
@cases(15)
@given(st.floats(0, 1), st.floats(-np.pi, np.pi))
def test_rays_to_straight_back(k, part, azimuth):
    """The whole branch, 90 to 180 degrees off the axis included, there and back."""
    with mp.workdps(DIGITS):
        end = float(mp.pi + sum(mp.mpf(c) * mp.pi ** (2 * i + 3) for i, c in enumerate(k)))
    f = 240 / end
    camera = cameras.create("kannala-brandt", width=480, height=480, fx=f, fy=f, k=k)
    pixel = camera.center + 240 * part * (1 - 1e-12) * np.array([np.cos(azimuth), np.sin(azimuth)])
    rays = camera.unproject(pixel)
    assert rays.valid
    with mp.workdps(DIGITS):
        x, y = ((mp.mpf(p) - 240) / mp.mpf(f) for p in pixel.tolist())
        theta = theta_by_bisection(k, mp.hypot(x, y))
        a = mp.atan2(y, x)
        truth = mp.matrix([mp.sin(theta) * mp.cos(a), mp.sin(theta) * mp.sin(a), mp.cos(theta)])
        assert mp.norm(mp.matrix([mp.mpf(v) for v in rays.directions.tolist()]) - truth) <= 2e-15
    again, seen = camera.project(np.array(truth, dtype=float).ravel() * 7)
    assert seen
    np.testing.assert_allclose(again, pixel, rtol=0, atol=1e-9)
