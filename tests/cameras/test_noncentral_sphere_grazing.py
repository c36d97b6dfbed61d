"""The mirror ball where the camera's ray grazes it: the paper's gamma runs to 0.

Story. ``gamma = (rho^2 - r^2 Z^2) Z^2`` is a difference that loses its digits towards the edge, and its
root turns 1e-16 into 1e-8. Past the edge the root is of a negative number. The ray itself turns infinitely
fast there (the root is in the physics), but back in the image that is
harmless: a pixel must come back as itself.
"""

import numpy as np
import pytest
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
