"""The four lenses against their formulas in 50 digits: rays, pixels and focal lengths, to a few roundings."""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

SIZE = 512
DIGITS = 50
EPS = 2.3e-16
# phi of t = r / f; its inverse; the last phi, degrees.
LENSES = {
    "fisheye-equidistant": (lambda t: t, lambda phi: phi, 180),
    "fisheye-stereographic": (lambda t: 2 * mp.atan(t / 2), lambda phi: 2 * mp.tan(phi / 2), 180 - 1e-13),
    "fisheye-orthographic": (mp.asin, mp.sin, 90),
    "fisheye-equisolid": (lambda t: 2 * mp.asin(t), lambda phi: mp.sin(phi / 2), 180),
}
lenses = pytest.mark.parametrize("name", LENSES)
azimuths = st.floats(-np.pi, np.pi)
# Anywhere, next to 0 and next to 1.
part = st.one_of(
    st.floats(0, 1), st.floats(-16, 0).map(lambda e: 10**e), st.floats(-13, 0).map(lambda e: 1 - 10**e)
)


def exact(values):
    return [mp.mpf(value) for value in np.asarray(values).tolist()]


@mp.workdps(DIGITS)
def true_direction(camera, pixel, phi_of):
    """The direction of a pixel by the formula, and how far the last digit of t turns it, rad."""
    (u, v), (u0, v0) = exact(pixel), exact(camera.center)
    r = mp.hypot(u - u0, v - v0)
    t = r / mp.mpf(camera.focal)
    phi = phi_of(t)
    turn = abs(mp.re(phi_of(t * (1 + EPS))) - mp.re(phi_of(t * (1 - EPS))))
    if r == 0:
        return [0, 0, 1], 0
    return [mp.sin(phi) * (u - u0) / r, mp.sin(phi) * (v - v0) / r, mp.cos(phi)], turn


@lenses
@cases(15)
@given(st.floats(1, 360), azimuths, part, st.floats(-9, 9))
def test_rays_and_pixels(name, fov_deg, azimuth, at, exponent):
    """``unproject`` is as exact as the pixel's radius; ``project`` returns the radius of a point's angle."""
    phi_of, radius_of, last_deg = LENSES[name]
    camera = cameras.create(name, width=SIZE, height=SIZE, fov_deg=min(fov_deg, 2 * last_deg))
    pixel = camera.center + at * SIZE / 2 * np.array([np.cos(azimuth), np.sin(azimuth)]) * (1 - 1e-15)
    rays = camera.unproject(pixel)
    assert rays.valid
    truth, turn = true_direction(camera, pixel, phi_of)
    with mp.workdps(DIGITS):
        off = mp.norm([a - b for a, b in zip(exact(rays.directions), truth, strict=True)])
    assert off <= 4 * turn + 4 * EPS
    phi = at * np.radians(min(fov_deg / 2, last_deg)) * (1 - 1e-12)
    away = 10**exponent
    point = away * np.array([np.sin(phi) * np.cos(azimuth), np.sin(phi) * np.sin(azimuth), np.cos(phi)])
    pixel, seen = camera.project(point)
    assert seen
    with mp.workdps(DIGITS):
        x, y, z = exact(point)
        across = mp.hypot(x, y)
        r = mp.mpf(camera.focal) * radius_of(mp.atan2(across, z))
        truth = [mp.mpf(SIZE) / 2 + (r * c / across if across else 0) for c in (x, y)]
        off = mp.norm([a - b for a, b in zip(exact(pixel), truth, strict=True)])
    # The pixel's own last digit is 6e-14 px; pixels stay 1e-13 of 256 px within the rim.
    assert off <= 4e-11
    if at < 0.999:
        assert off <= 4e-13


@lenses
@cases(15)
@given(st.one_of(st.floats(0.01, 360), st.floats(-13, 0).map(lambda e: 360 - 10**e)))
def test_focal_length_follows_the_field_of_view(name, fov_deg):
    """The rim of the image circle sees ``fov_deg / 2``, by the formula."""
    _, radius_of, last_deg = LENSES[name]
    fov_deg = min(fov_deg, 2 * last_deg)
    camera = cameras.create(name, width=SIZE, height=SIZE - 100, fov_deg=fov_deg)
    with mp.workdps(DIGITS):
        half = mp.radians(mp.mpf(fov_deg)) / 2
        truth = mp.mpf(SIZE - 100) / 2 / radius_of(half)
        assert abs(mp.mpf(camera.focal) / truth - 1) <= 4 * EPS


def test_default_fields_of_view():
    """180 degrees where neither ``focal`` nor ``fov_deg`` is given, for every lens."""
    for name in LENSES:
        camera = cameras.create(name, width=SIZE, height=SIZE)
        assert camera == cameras.create(name, width=SIZE, height=SIZE, fov_deg=180)
        z = camera.unproject(np.array([SIZE, SIZE / 2])).directions[2]
        assert abs(z) <= 3e-8  # the rim looks sideways; orthographic: the root of a rounding


def test_orthographic_sees_sideways_but_not_behind():
    """z = 0 is the rim; one denormal behind it is out of sight."""
    camera = cameras.create("fisheye-orthographic", width=SIZE, height=SIZE, focal=200)
    points = np.array(
        [[1, 0, 0.0], [1, 0, -0.0], [0, -1, 5e-324], [0.6, 0.8, 1e-300], [1, 0, -5e-324], [0, 1, -1]]
    )
    pixels, seen = camera.project(points)
    np.testing.assert_array_equal(seen, (True, True, True, True, False, False))
    np.testing.assert_allclose(np.linalg.norm(pixels[:4] - camera.center, axis=1), 200, rtol=0, atol=1e-10)
