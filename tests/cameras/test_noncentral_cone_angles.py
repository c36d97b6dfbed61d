"""The conical mirror at 45 degrees, as a needle (tau to 0) and as a plate (tau to 90 degrees).

Story. The paper's formulas go through tan(2 tau), which is infinite at 45 degrees and 0 at both ends;
cos(tau) in radians has lost its digits at 90 degrees. At 90 the cone is a plane mirror, which has one
optical centre: the camera's image at 2 Z_m.
"""

import numpy as np
import pytest
from support.camera_contract import last_radius
from support.noncentral_mirrors import ray_errors

from omniscv import cameras

SIZE = 512


def create(half_angle_deg):
    return cameras.create(
        "noncentral-conical-mirror", width=SIZE, height=SIZE, half_angle_deg=half_angle_deg, distance=0.3
    )


def around(degrees):
    """45 degrees, its neighbours in float64, and ever further away."""
    steps = [0.0, *(sign * 10.0**-k for k in (1, 7, 14) for sign in (-1, 1))]
    near = [float(np.nextafter(degrees, np.inf)), float(np.nextafter(degrees, 0))]
    return [degrees + step for step in steps] + near


@pytest.mark.parametrize("half_angle_deg", around(45.0))
@pytest.mark.parametrize("part", [0.001, 0.5, 0.999])
def test_45_degrees_is_an_angle_like_any_other(half_angle_deg, part):
    camera = create(half_angle_deg)
    angle, offset = ray_errors(camera, camera.center + part * last_radius(camera) * np.array([0.6, 0.8]))
    assert angle <= 1e-15
    assert offset <= 1e-15


def test_45_degrees_looks_sideways():
    """The tip's neighbours see the horizon: phi = 90 degrees exactly, less the camera ray's own angle."""
    camera = create(45)
    rays = camera.unproject(np.array([SIZE / 2 + 100, SIZE / 2]))
    alpha = np.arctan(100 / camera.focal)
    np.testing.assert_allclose(rays.directions, (np.cos(alpha), 0, np.sin(alpha)), rtol=0, atol=3e-16)


@pytest.mark.parametrize("half_angle_deg", [10.0**-k for k in (0, 4, 9)])
def test_a_needle(half_angle_deg):
    """The image shrinks to ``r < tan tau``; what is left of it is as exact as the pixel's own place."""
    camera = create(half_angle_deg)
    pixel = camera.center + 0.5 * last_radius(camera) * np.array([0.6, 0.8])
    angle, offset = ray_errors(camera, pixel)
    assert angle <= 1e-15
    # The origin is off the line by the angle's error over the needle's own angle, at the tip's distance.
    assert offset <= 1e-15
    again, seen = camera.project(camera.unproject(pixel).origins + 1e3 * camera.unproject(pixel).directions)
    assert seen
    np.testing.assert_allclose(again, pixel, rtol=0, atol=1e-9)


@pytest.mark.parametrize("short_of_90_deg", [10.0**-k for k in (0, 6, 12)])
def test_a_plate(short_of_90_deg):
    camera = create(90 - short_of_90_deg)
    pixel = camera.center + np.array([60.0, 80.0])
    angle, offset = ray_errors(camera, pixel)
    assert angle <= 1e-15
    assert offset <= 1e-15
    again, seen = camera.project(camera.unproject(pixel).origins + 1e3 * camera.unproject(pixel).directions)
    assert seen
    np.testing.assert_allclose(again, pixel, rtol=0, atol=1e-9)


def test_the_plate_is_a_plane_mirror():
    """One optical centre, 2 Z_m, and rays that come straight back, to the 2e-11 rad left of the cone."""
    camera = create(90 - 1e-9)
    rays = camera.unproject(np.array([[SIZE / 2 + 100, SIZE / 2], [SIZE / 2, SIZE / 2 - 200]]))
    np.testing.assert_allclose(rays.origins[:, 2], 0.6, rtol=0, atol=1e-9)
    expected = np.array([[100, 0, -camera.focal], [0, -200, -camera.focal]])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(rays.directions, expected, rtol=0, atol=4e-11)
