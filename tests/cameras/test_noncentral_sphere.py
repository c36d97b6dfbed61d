"""The mirror ball at its ends: where the camera's ray grazes it, and where the camera touches it or is far.

Story of grazing. The paper's ``gamma = (rho^2 - r^2 Z^2) Z^2`` is a difference that loses its digits towards
the edge, and its root turns 1e-16 into 1e-8. Past the edge the root is of a negative number. The ray itself
turns infinitely fast there (the root is in the physics), but back in the image that is harmless: a pixel must
come back as itself.

Story of touching: distance to 0 (Z = Z_s / R_s to 1). With Z near 1 the optical centres crowd into
``Z_r < 2 Z_m``, while the paper's ``Z_s (delta + epsilon) / delta`` takes them from a difference of
numbers as large as the ball: at Z_m = 1e-9 R_s half of the digits are gone, at 1e-16 R_s all. Far away the
ball becomes a dot.
"""

import numpy as np
import pytest
from support.camera_contract import last_radius
from support.noncentral_mirrors import ray_errors

from omniscv import cameras

SIZE = 512


def create(distance=0.3):
    # With the default focal, 256 px, the edge of the ball lies within the image circle: at r = 0.8006.
    return cameras.create(
        "noncentral-spherical-mirror", width=SIZE, height=SIZE, mirror_radius=0.5, distance=distance
    )


def pixel_at(camera, part_left, azimuth=0.3):
    """The pixel whose radius is short of the edge by a part of it."""
    edge_px = camera.focal * 0.5 / np.sqrt(0.8**2 - 0.5**2)
    return camera.center + edge_px * (1 - part_left) * np.array([np.cos(azimuth), np.sin(azimuth)])


@pytest.mark.parametrize("part_left", [10.0**-k for k in (1, 5, 9, 13)])
def test_rays_stay_as_exact_as_the_pixel_says(part_left):
    """A pixel's last digit, 2e-16, moves the ray by 1e-16 / sqrt(part_left) and no more."""
    camera = create()
    angle, offset = ray_errors(camera, pixel_at(camera, part_left))
    assert angle <= 4e-16 / np.sqrt(part_left)
    assert offset <= 4e-16 / np.sqrt(part_left)


def test_one_step_past_the_edge_is_marked():
    """Bisected to one ulp: valid turns False once, at the edge of 50 digits, and nothing is NaN before."""
    camera = create()
    low, high = SIZE / 2, float(SIZE)
    while np.nextafter(low, high) < high:
        middle = (low + high) / 2
        low, high = (middle, high) if camera.valid(np.array([middle, SIZE / 2])) else (low, middle)
    edge_px = camera.focal * 0.5 / np.sqrt(0.39)
    assert abs(low - SIZE / 2 - edge_px) <= 1e-13 * SIZE
    rays = camera.unproject(np.array([low, SIZE / 2]))
    assert np.isfinite(rays.directions).all()
    assert np.isfinite(rays.origins).all()
    # Grazing means that the ray goes straight on: it is the camera's own, and starts at the camera.
    # 1e-7: the root of the last pixel's rounding.
    straight = np.array([edge_px / camera.focal, 0, 1])
    np.testing.assert_allclose(rays.directions, straight / np.linalg.norm(straight), rtol=0, atol=1e-7)
    np.testing.assert_allclose(rays.origins, 0, rtol=0, atol=1e-7)


def test_no_point_is_found_in_the_shadow_of_the_ball():
    """Behind the tangent cone of the grazing rays nothing is seen; just before it everything is."""
    camera = create()
    alpha = np.arcsin(0.5 / 0.8)
    for z in (1.0, 5.0, 1e6):
        rho = z * np.tan(alpha)
        points = np.array([[rho * (1 - 1e-9), 0, z], [rho * (1 + 1e-9), 0, z]])
        np.testing.assert_array_equal(camera.project(points)[1], (False, True))


@pytest.mark.parametrize("distance", [10.0**k for k in (-18, -9, -3, 0, 3)])
@pytest.mark.parametrize("part", [0.01, 0.5, 0.9])
def test_rays_against_reflection(distance, part):
    """At 1e-18 m as at 1 km: errors of a few roundings relative to the distance itself."""
    camera = create(distance)
    pixel = camera.center + part * last_radius(camera) * np.array([0.6, -0.8])
    angle, offset = ray_errors(camera, pixel)
    # The pixel's place is known to 1e-16 of the image's size: what that is of the ball's size, when it
    # has become a dot, is no error of the model.
    lost = SIZE / 2 / last_radius(camera)
    assert angle <= 1e-15 * lost
    assert offset <= 1e-15 * lost


def test_touching_the_ball_sees_the_half_space_above_it():
    """From the ball's surface every camera ray comes straight back: phi = pi - alpha."""
    camera = create(1e-18)
    rays = camera.unproject()
    x, y = np.moveaxis(camera.pixels() - camera.center, -1, 0) / camera.focal
    expected = np.stack([x, y, -np.ones_like(x)], axis=-1) / np.sqrt(x**2 + y**2 + 1)[..., None]
    np.testing.assert_allclose(rays.directions[rays.valid], expected[rays.valid], rtol=0, atol=2e-15)
    assert (rays.origins[rays.valid][:, 2] >= 0).all()
    assert rays.origins[rays.valid][:, 2].max() < 2.1e-18
