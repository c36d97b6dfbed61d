"""A Scaramuzza polynomial that turns back: the ray's angle grows with rho, stops, and shrinks again.

Story. A polynomial of degree 4 fits the calibrated circle and does as it likes outside. With f = -150 + 1e-3
rho^2 - 2e-8 rho^4 rays turn away from the axis up to rho = 242.9 px, 56.5 deg, and then come back: pixels at
rho = 147.1 and 350 see the same point, and a solver of the polynomial may return either. Only the inner
branch counts. At the turn itself pixels 1e-8 of the radius apart have the same ray in float64: a few 1e-6 px
are all that can be told there, and all that is asked.
"""

import functools

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

SIZE = {"width": 800, "height": 800}
DIGITS = 50
TURNING = [
    (-150.0, 0, 1e-3, 0, -2e-8),
    (-150.0, 0, 1e-3, -4e-6, 0),
    (-80.0, 0.1, 0, 0, -1e-8),
    (-200.0, 0, -1e-3),  # nearer to the axis from rho = 447 px on
    (-120.0, 0, 4e-3, -3.3e-5, 5e-8),  # turns back, and later away again
]
turning = pytest.mark.parametrize("coefficients", TURNING)


def create(coefficients, **options):
    return cameras.create("scaramuzza", **SIZE, coefficients=coefficients, **options)


def angle(coefficients, rho):
    """Off the axis, rad, in numpy or mpmath as rho is."""
    f = sum(a * rho**i for i, a in enumerate(coefficients))
    return mp.atan2(rho, -f) if isinstance(rho, mp.mpf) else np.arctan2(rho, -f)


@functools.cache
def first_turn(coefficients):
    """(rho, theta) where the angle first stops growing; (inf, last angle) if not within 600 px."""
    rho = np.linspace(0, 600, 60_001)
    theta = angle(coefficients, rho)
    falls = np.flatnonzero(np.diff(theta) < -1e-15)
    if not falls.size:
        return np.inf, theta[-1]
    low, high = (mp.mpf(rho[max(falls[0] + i, 0)].item()) for i in (-2, 2))
    with mp.workdps(DIGITS):
        for _ in range(100):  # golden section would do with fewer
            a, b = low + (high - low) / 3, high - (high - low) / 3
            low, high = (a, high) if angle(coefficients, a) < angle(coefficients, b) else (low, b)
        return float(low), float(angle(coefficients, low))


@turning
def test_the_branch_ends_at_the_first_turn(coefficients):
    rho, theta = first_turn(coefficients)
    assert 0.8 * rho < 400  # the turn is within the image, that way
    camera = create(coefficients)
    for part, valid in ((0.5, True), (1 - 1e-9, True), (1 + 1e-9, False), (1.2, False)):
        pixels = camera.center + rho * part * np.array([[0.6, -0.8], [-0.8, -0.6]])
        inside = ((pixels >= 0) & (pixels <= 800)).all(axis=1)
        np.testing.assert_array_equal(camera.valid(pixels), inside & valid)
    for past, seen in ((-0.1, True), (-1e-9, True), (1e-9, False), (0.1, False)):
        a = theta + past
        point = np.array([0.6 * np.sin(a), -0.8 * np.sin(a), np.cos(a)])
        assert camera.project(point)[1] == seen, past


def test_two_pixels_with_one_ray():
    """The numbers of the story: the outer pixel has no ray, and the point is seen by the inner one."""
    camera = create(TURNING[0])
    outer = 350.0
    theta = angle(TURNING[0], outer)
    inner = np.interp(theta, angle(TURNING[0], np.arange(0, 240, 1e-3)), np.arange(0, 240, 1e-3))
    assert inner == pytest.approx(147.1, abs=0.1)
    assert not camera.valid(np.array([400 + outer, 400]))
    pixel, seen = camera.project(np.array([np.sin(theta), 0, np.cos(theta)]))
    assert seen
    np.testing.assert_allclose(pixel, camera.center + np.array([inner, 0]), rtol=0, atol=1e-6)


@turning
@cases(15)
@given(st.floats(-15, 0), st.floats(-np.pi, np.pi), st.floats(-9, 9))
def test_pixels_next_to_the_turn(coefficients, exponent, azimuth, away):
    """They come back as far as float64 rays differ: 1e-6 px, but 1e-8 of the radius at the turn."""
    camera = create(coefficients)
    rho = min(first_turn(coefficients)[0], 399.0) * (1 - 10**exponent)
    pixel = camera.center + rho * np.array([np.cos(azimuth), np.sin(azimuth)])
    rays = camera.unproject(pixel)
    if not rays.valid:
        assert exponent < -11
        return
    again, seen = camera.project(10**away * rays.directions)
    assert seen
    # A ray is known to 2e-16; next to the turn, left off it, that is 2e-16 / left of the radius.
    known = 400 * min(3e-15 / 10**exponent, 6e-8)
    np.testing.assert_allclose(again, pixel, rtol=0, atol=max(1e-9, known))
    # Whatever the pixel, its ray is the point's: no other branch, no digits lost.
    seen_by = camera.unproject(again).directions
    np.testing.assert_allclose(seen_by, rays.directions, rtol=0, atol=4e-15)


def test_no_depth_is_refused():
    for a0 in (0.0, 5e-324, 1.0):
        with pytest.raises(
            cameras.base.ArgumentError, match=r"^coefficients\[0\]: expected a finite number < 0"
        ):
            create((a0, 0, 1e-3))
