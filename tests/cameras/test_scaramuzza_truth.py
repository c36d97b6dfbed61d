"""The Scaramuzza model against its definition in 50 digits: the ray of a pixel, and the pixel by bisection.

OCamCalib's pixel of a ray is the root of a polynomial; here it is found by halving an interval of rho, on
the definition ``(u'', v'', -f(rho))`` alone.
"""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

DIGITS = 50
SIZE = {"width": 640, "height": 480}
# Coefficients and affine terms of the size that calibrations give; then the odd ones out.
CAMERAS = {
    "190 deg lens": {"coefficients": (-179.5, 0, 1.9e-3, -3.2e-6, 9.1e-9), "affine": (0.9995, 2e-4, -3e-4)},
    "mirror": {"coefficients": (-150.0, 0, 2.4e-3, -1.1e-6, 3e-9), "center": (331.2, 236.9)},
    "a1 is not 0": {"coefficients": (-200.0, 0.05, 1e-3)},
    "pinhole": {"coefficients": (-320.0,)},
    "sheared": {"coefficients": (-200.0, 0, 2e-3), "affine": (1.3, 0.2, -0.1)},
}
every_camera = pytest.mark.parametrize("given_camera", CAMERAS.values(), ids=CAMERAS)
place = st.tuples(st.floats(0, SIZE["width"]), st.floats(0, SIZE["height"]))


def create(parameters):
    return cameras.create("scaramuzza", **SIZE, **parameters)


def exact(values):
    return [mp.mpf(value) for value in np.asarray(values, dtype=float).tolist()]


def true_ray(camera, pixel):
    """(u'', v'', -f(rho)) by ``u = u_0 + c u'' + d v''``, ``v = v_0 + e u'' + v''``; not normalised."""
    (u, v), (u0, v0), (c, d, e) = exact(pixel), exact(camera.center), exact(camera.affine)
    # Cramer's rule
    across = [(u - u0 - d * (v - v0)) / (c - d * e), (c * (v - v0) - e * (u - u0)) / (c - d * e)]
    return mp.matrix([*across, -height(camera, mp.hypot(*across))])


def height(camera, rho):
    return sum(a * rho**i for i, a in enumerate(exact(camera.coefficients)))


@every_camera
@cases(6)
@given(place)
def test_rays(given_camera, pixel):
    camera = create(given_camera)
    rays = camera.unproject(np.array(pixel))
    assert rays.valid  # the polynomials do not turn back within the image
    with mp.workdps(DIGITS):
        truth = true_ray(camera, pixel)
        off = mp.norm(mp.matrix(exact(rays.directions)) - truth / mp.norm(truth))
    assert off <= 2e-15  # a few roundings of the polynomial's terms, which nearly cancel nowhere


@pytest.mark.parametrize("fov_deg", [1, 90, 179.9, 180, 185])
def test_the_field_of_view_is_a_limit(fov_deg):
    """Valid pixels are those whose true ray is within half of it."""
    camera = create({**CAMERAS["190 deg lens"], "fov_deg": fov_deg})
    pixels = np.random.default_rng(4).uniform(0, (640, 480), (400, 2))
    with mp.workdps(DIGITS):
        rays = [true_ray(camera, pixel) for pixel in pixels]
        angles = np.array([float(mp.degrees(mp.atan2(mp.hypot(x, y), z))) for x, y, z in rays])
    np.testing.assert_array_equal(camera.valid(pixels), angles <= fov_deg / 2)
