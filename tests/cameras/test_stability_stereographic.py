"""The stereographic lens near 360 degrees, where straight back lies at infinity.

Story. ``r = 2 f tan(phi / 2)`` grows without end: with 360 deg less 1e-9 the image circle spans 2e11 focal
lengths, half of the pixels crowd within 1e-9 rad of straight back, and ``1 + cos phi`` has lost every
digit. The radius has two forms, each good where the other is not; rays are held by their part across the
axis, which keeps its digits. So neighbouring pixels stay apart to the last number below 360.
"""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

SIZE = 512
DIGITS = 50


def create(left_deg):
    return cameras.create("fisheye-stereographic", width=SIZE, height=SIZE, fov_deg=360 - left_deg)


@cases(15)
@given(st.floats(-13, 0), st.floats(0.001, 1), st.floats(-np.pi, np.pi))
def test_rays_keep_their_digits_across_the_axis(exponent, part, azimuth):
    """Relative to the part across, 1e-9 and less of the ray: what tells these pixels apart."""
    camera = create(10**exponent)
    pixel = camera.center + part * SIZE / 2 * (1 - 1e-15) * np.array([np.cos(azimuth), np.sin(azimuth)])
    ray = camera.unproject(pixel).directions
    with mp.workdps(DIGITS):
        x, y = (mp.mpf(p) - SIZE / 2 for p in pixel.tolist())
        truth = mp.sin(2 * mp.atan(mp.hypot(x, y) / mp.mpf(camera.focal) / 2))
        across = mp.hypot(*map(mp.mpf, ray[:2].tolist()))
        assert abs(across / truth - 1) <= 2e-15


@pytest.mark.parametrize("left_deg", [1.0, 1e-3, 1e-6, 1e-9, 1e-12, 360 - np.nextafter(360, 0)])
def test_the_rim_sees_what_is_left(left_deg):
    """The last ray is half of what is left to 360 deg off straight back, to 1e-15 of that."""
    camera = create(left_deg)
    ray = camera.unproject(np.array([SIZE, SIZE / 2])).directions
    left = np.radians(360 - (360 - left_deg)) / 2  # of the number that the constructor got
    assert ray[0] == pytest.approx(np.sin(left), rel=2e-15)
    assert ray[2] < 0


@pytest.mark.parametrize("left_deg", [1.0, 1e-6, 1e-12])
def test_straight_back_is_nowhere(left_deg):
    """Points within what is left are out of sight, at any distance; just beside they are seen."""
    camera = create(left_deg)
    left = np.radians(360 - (360 - left_deg)) / 2
    for metres in (1e-9, 1.0, 1e9):
        points = metres * np.array([[0, 0, -1], [0.99 * left, 0, -1], [0, -1.01 * left, -1]])
        np.testing.assert_array_equal(camera.project(points)[1], (False, False, True))
