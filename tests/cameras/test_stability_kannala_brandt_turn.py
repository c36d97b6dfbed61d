"""Kannala-Brandt with coefficients that turn back: ``d(theta)`` grows, stops, and shrinks again.

Story. Calibrations fit d within the lens's own field of view and care for nothing beyond; with k1 = -0.1, d
turns back at theta = 1.826 rad (104.6 deg), where d = 1.217. A pixel further out has no ray, yet Newton's
iteration from a guess happily returns a root of another branch: a wrong ray, marked valid. And a point beyond
104.6 deg has a d of its own that is the pixel of another point. Here only the first branch counts; its end is
found by exact means below, and pixels up to 1e-9 px from it still come back.
"""

import functools

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

SIZE = {"width": 640, "height": 640}
F = 100.0
DIGITS = 50
TURNING = [
    (-0.1, 0, 0, 0),
    (0.02, -0.008, 0, -0.0004),
    (-0.3, 0.1, -0.02, 0.001),
    (1.0, -1.0, 0, 0),
    (0, 0, 0, -1e-4),
    (-0.2, 0.012, 0, 0),  # rises again after its turn: the second branch is not the lens
]
turning = pytest.mark.parametrize("k", TURNING)


def create(k, f=F):
    return cameras.create("kannala-brandt", **SIZE, fx=f, fy=f, k=k)


def d_of(k, theta):
    return theta + sum(mp.mpf(c) * theta ** (2 * i + 3) for i, c in enumerate(k))


@functools.cache
@mp.workdps(DIGITS)
def first_turn(k):
    """(theta, d) where d stops growing, at most pi: the first sign change of d' on a fine grid, bisected."""

    def slope(theta, one=1.0):
        return one + sum((2 * i + 3) * one * c * theta ** (2 * i + 2) for i, c in enumerate(k))

    grid = np.linspace(0, np.pi, 20001)
    falls = np.flatnonzero(slope(grid) < 0)
    if not falls.size:
        return mp.pi, d_of(k, mp.pi)
    low, high = (mp.mpf(grid[falls[0] + i].item()) for i in (-1, 0))
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if slope(middle, mp.mpf(1)) > 0 else (low, middle)
    return low, d_of(k, low)


@turning
def test_the_branch_ends_at_the_first_turn(k):
    """Pixels to the turn's radius are valid and no pixel beyond; so are points to its angle."""
    theta, d = (float(v) for v in first_turn(k))
    assert theta < 3.1
    camera = create(k)
    for part, valid in ((0.9, True), (1 - 1e-12, True), (1 + 1e-12, False), (1.05, False)):
        pixels = camera.center + F * d * part * np.array([[1, 0], [0.6, -0.8], [0, 1]])
        assert (camera.valid(pixels) == valid).all(), part
    for past, seen in ((-0.1, True), (-1e-9, True), (1e-9, False), (0.1, False)):
        a = theta + past
        assert camera.project(np.array([np.sin(a), 0, np.cos(a)]))[1] == seen, past


@turning
@cases(15)
@given(st.floats(-12, 0), st.floats(-np.pi, np.pi))
def test_no_wrong_ray_next_to_the_turn(k, exponent, azimuth):
    """The ray of a pixel, put into d(theta) in 50 digits, is that pixel to 1e-10 px; and it is the first."""
    theta_end, d_end = first_turn(k)
    camera = create(k)
    pixel = camera.center + F * float(d_end) * (1 - 10**exponent) * np.array(
        [np.cos(azimuth), np.sin(azimuth)]
    )
    rays = camera.unproject(pixel)
    assert rays.valid
    with mp.workdps(DIGITS):
        x, y, z = (mp.mpf(v) for v in rays.directions.tolist())
        theta = mp.atan2(mp.hypot(x, y), z)
        assert theta <= theta_end * (1 + mp.mpf(10) ** -12)
        off_px = F * d_of(k, theta) - mp.hypot(*(mp.mpf(v) - 320 for v in pixel.tolist()))
    assert abs(off_px) <= 1e-10
    again, seen = camera.project(3 * rays.directions)
    assert seen
    np.testing.assert_allclose(again, pixel, rtol=0, atol=1e-9)


def test_a_slope_that_only_touches_zero_is_no_turn():
    """d' = (1 - theta^2)^2, 0 at 1 rad but never negative: the branch goes on, on both sides of it.

    The solver's two roots are off by 1e-8 or a complex pair; what rounding made of them decided, once.
    """
    k = (-2 / 3, 1 / 5, 0, 0)
    camera = create(k)
    for theta in (0.9, 1 - 1e-6, 1 + 1e-6, 1.5, 3.0):
        pixel, seen = camera.project(np.array([np.sin(theta), 0, np.cos(theta)]))
        r = F * float(d_of(k, mp.mpf(theta)))
        assert seen == (r <= 320)
        if seen:
            np.testing.assert_allclose(pixel, (320 + r, 320), rtol=0, atol=1e-9)


def test_a_threefold_root_is_a_turn():
    """d' = (1 - theta^2)^3: the solver scatters the roots 1e-5 around 1 rad, and none is real.

    Once no turn was seen there, and points 1.5 rad off the axis got the pixel of a ray nearer to it.
    """
    camera = create((-1.0, 3 / 5, -1 / 7, 0))
    r_end = F * (1 - 1 + 3 / 5 - 1 / 7)
    assert camera.valid(np.array([320 + r_end * (1 - 1e-9), 320]))
    assert not camera.valid(np.array([320 + r_end * (1 + 1e-9), 320]))
    for theta, seen in ((0.99, True), (1.01, False), (1.5, False)):
        assert camera.project(np.array([np.sin(theta), 0, np.cos(theta)]))[1] == seen


@mp.workdps(DIGITS)
def theta_by_bisection(k, d):
    """theta in [0, pi] with d(theta) = d, for coefficients that increase there."""
    low, high = mp.mpf(0), mp.pi
    for _ in range(64):  # 1e-19
        middle = (low + high) / 2
        low, high = (middle, high) if d_of(k, middle) < d else (low, middle)
    return low


@pytest.mark.parametrize("k", [(0, 0, 0, 0), (0.1, 0.05, 0.02, 0.01), (0.02, -0.008, 0.002, 0.0001)])
@cases(15)
@given(st.floats(0, 1), st.floats(-np.pi, np.pi))
def test_rays_to_straight_back(k, part, azimuth):
    """The whole branch, 90 to 180 degrees off the axis included, there and back."""
    with mp.workdps(DIGITS):
        end = float(d_of(k, mp.pi))
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
