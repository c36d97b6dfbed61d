"""Orthographic and equisolid lenses at ``r = f``, where asin has an infinite slope.

Story. At the rim one rounding of r / f, 1e-16, turns the orthographic ray by sqrt(2e-16) = 1.5e-8 rad and
the equisolid one by twice that; a rounding to the other side makes r / f > 1, and NaN. A lens that goes by
way of the angle loses half of the digits there. These do not: the last pixel comes back to 1e-10 px, all
around, and rays are those of the pixel as it is in memory, to 16 digits across the axis.
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
PHI_OF = {"fisheye-orthographic": mp.asin, "fisheye-equisolid": lambda t: 2 * mp.asin(t)}
lenses = pytest.mark.parametrize("name", PHI_OF)
azimuths = st.floats(-np.pi, np.pi)
closeness = st.floats(-16, -1).map(lambda e: 10**e)


def create(name, focal=200.0):
    return cameras.create(name, width=SIZE, height=SIZE, focal=focal)


def on_circle(camera, r_px, azimuth):
    return camera.center + r_px * np.array([np.cos(azimuth), np.sin(azimuth)])


@lenses
@cases(15)
@given(azimuths, closeness)
def test_rays_up_to_the_rim(name, azimuth, left):
    """Across the axis as exact as everywhere; along it as the pixel's last digit leaves it."""
    camera = create(name)
    pixel = on_circle(camera, camera.focal * (1 - left), azimuth)
    rays = camera.unproject(pixel)
    if not rays.valid:
        assert left < 1e-15  # rounding took the pixel out
        return
    with mp.workdps(DIGITS):
        x, y = (mp.mpf(p) - mp.mpf(c) for p, c in zip(pixel.tolist(), camera.center.tolist(), strict=True))
        r = mp.hypot(x, y)
        t = min(r / camera.focal, mp.mpf(1))  # hypot of float64 may round a pixel of r > f to r = f
        phi = PHI_OF[name](t)
        across, along = (
            mp.mpf(v) for v in (float(np.hypot(*rays.directions[:2])), rays.directions[2].item())
        )
        # One last digit of t: for a sine that is dt / sqrt(1 - t^2), at the rim itself sqrt(2 dt).
        last_digit = 2.3e-16 / mp.sqrt(1 - t + 2.3e-16)
        assert mp.hypot(across - mp.sin(phi), along - mp.cos(phi)) <= 4 * last_digit
        if name == "fisheye-orthographic":
            assert abs(across - t) <= 4e-16


@lenses
def test_beyond_the_rim_is_marked(name):
    """One part in 1e15 further out there is no ray, and no NaN calls itself valid."""
    camera = create(name)
    azimuth = np.linspace(-np.pi, np.pi, 1001)
    around = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    for part in (1 + 1e-15, 1 + 1e-12, 1.1):
        rays = camera.unproject(camera.center + camera.focal * part * around)
        inside = np.linalg.norm(camera.focal * part * around, axis=1) <= camera.focal
        assert not rays.valid[~inside].any()
        assert np.isfinite(rays.directions[rays.valid]).all()


def test_orthographic_sees_sideways_but_not_behind():
    """z = 0 is the rim; one denormal behind it is out of sight."""
    camera = create("fisheye-orthographic")
    points = np.array(
        [[1, 0, 0.0], [1, 0, -0.0], [0, -1, 5e-324], [0.6, 0.8, 1e-300], [1, 0, -5e-324], [0, 1, -1]]
    )
    pixels, seen = camera.project(points)
    np.testing.assert_array_equal(seen, (True, True, True, True, False, False))
    np.testing.assert_allclose(np.linalg.norm(pixels[:4] - camera.center, axis=1), 200, rtol=0, atol=1e-10)


def test_equisolid_sees_straight_back_all_around():
    """All pixels of the rim see -z; each comes back to its own place all the same, not to one of them."""
    camera = create("fisheye-equisolid", focal=256.0)
    azimuth = np.linspace(-np.pi, np.pi, 721)
    pixels = np.stack([on_circle(camera, 256.0 * (1 - 1e-15), a) for a in azimuth])
    rays = camera.unproject(pixels)
    np.testing.assert_allclose(rays.directions, [(0, 0, -1)] * len(pixels), rtol=0, atol=1e-7)
    again, seen = camera.project(rays.directions)
    assert seen.all()
    np.testing.assert_allclose(again, pixels, rtol=0, atol=1e-10)


@lenses
@cases(15)
@given(azimuths, st.floats(-16, -1), st.floats(-9, 9))
def test_points_next_to_the_rim(name, azimuth, exponent, away):
    """``project`` by the true angle, for points that close in on the last ray."""
    camera = create(name)
    last = np.pi / 2 if name == "fisheye-orthographic" else np.pi
    phi = last - 10**exponent
    across = np.sin(phi)
    point = 10**away * np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(phi)])
    pixel, seen = camera.project(point)
    assert seen == (name == "fisheye-equisolid" or point[2] >= 0)
    if seen:
        with mp.workdps(DIGITS):
            true_phi = mp.atan2(mp.hypot(*map(mp.mpf, point[:2].tolist())), mp.mpf(point[2].item()))
            radius = 200 * float(mp.sin(true_phi) if name == "fisheye-orthographic" else mp.sin(true_phi / 2))
        assert np.linalg.norm(pixel - camera.center) == pytest.approx(radius, abs=1e-10)
