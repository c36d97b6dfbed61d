"""The conical mirror where it degenerates: at its tip, at 45 degrees, as a needle, as a plate, at its edge.

The tip has no normal: the ray keeps its angle 2 tau from the axis in whatever azimuth it came, and at r = 0
there is no azimuth left. The paper's formulas go through tan(2 tau), which is infinite at 45 degrees and 0
at both ends; cos(tau) in radians has lost its digits at 90 degrees, where the cone is a plane mirror with
one optical centre, the camera's image at 2 Z_m. At r = tan tau the camera's ray runs along the cone's side:
the formula continues, the mirror does not.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.camera_contract import last_radius
from support.cases import cases
from support.noncentral_mirrors import bounce, ray_errors

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


def create_tip(size=101, half_angle_deg=60, **options):
    return cameras.create(
        "noncentral-conical-mirror",
        width=size,
        height=size,
        half_angle_deg=half_angle_deg,
        distance=0.3,
        **options,
    )


def test_the_tip_is_no_ray():
    camera = create_tip()
    assert not camera.valid()[50, 50]
    assert camera.valid()[49:52, 49:52].sum() == 8
    rays = camera.unproject(np.array([50.5, 50.5]))
    assert np.isnan(rays.directions).all()


@pytest.mark.parametrize("r_px", [10.0**-k for k in (0, 4, 9, 13)])
def test_rays_next_to_the_tip(r_px):
    # A centre at (0, 0), so that a pixel can be as near to it as one likes.
    camera = create_tip(center=(0, 0))
    angle, offset = ray_errors(camera, (0.6 * r_px, 0.8 * r_px))
    assert angle <= 1e-15
    assert offset <= 1e-15


@cases(15)
@given(st.floats(-13, 0), st.floats(0, np.pi / 2))
def test_the_ray_keeps_its_angle_and_azimuth(exponent, azimuth):
    """Within 2e-2 rad per px of 2 tau (the focal length is 50.5 px), and exact in azimuth."""
    camera = create_tip(center=(0, 0))
    r_px = 10**exponent
    rays = camera.unproject(r_px * np.array([np.cos(azimuth), np.sin(azimuth)]))
    x, y, z = rays.directions
    assert abs(np.arctan2(np.hypot(x, y), z) - np.radians(120)) <= 0.02 * r_px + 1e-15
    assert abs(np.arctan2(y, x) - azimuth) <= 1e-15
    assert abs(rays.origins[2] - 0.3) <= 0.3 * 0.03 * r_px + 1e-15


angles = pytest.mark.parametrize("half_angle_deg", [5, 30, 44])


@angles
@pytest.mark.parametrize("part_left", [10.0**-k for k in (1, 5, 9, 13)])
def test_rays_next_to_the_edge(half_angle_deg, part_left):
    camera = create(half_angle_deg)
    edge_px = camera.focal * np.tan(np.radians(half_angle_deg))
    pixel = camera.center + np.array([0.6, -0.8]) * edge_px * (1 - part_left)
    angle, offset = ray_errors(camera, pixel)
    assert angle <= 1e-15
    assert offset <= 1e-15


@angles
def test_past_the_edge_is_marked(half_angle_deg):
    """To 1e-13: the reflection hits this side of the edge, misses on the other, and so says ``valid``."""
    camera = create(half_angle_deg)
    edge_px = camera.focal * np.tan(np.radians(half_angle_deg))
    for part, met in ((-1e-13, True), (1e-13, False), (1e-6, False), (0.5, False)):
        pixel = np.array([SIZE / 2 + edge_px * (1 + part), SIZE / 2])
        if pixel[0] <= SIZE:
            assert (bounce(camera, pixel) is not None) == met
            assert camera.valid(pixel) == met


@angles
def test_no_point_is_found_along_or_within_the_cone(half_angle_deg):
    camera = create(half_angle_deg)
    slope = np.tan(np.radians(half_angle_deg))
    z = np.array([0.4, 1.0, 100.0])
    for part, visible in ((1 - 1e-9, False), (1 + 1e-9, True)):
        points = np.stack([(z - 0.3) * slope * part, 0 * z, z], axis=-1)
        assert (camera.project(points)[1] == visible).all()
