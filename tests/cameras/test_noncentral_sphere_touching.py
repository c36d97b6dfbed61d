"""The mirror ball when the camera touches it: distance to 0 (Z = Z_s / R_s to 1), and far away.

Story. With Z near 1 the optical centres crowd into ``Z_r < 2 Z_m``, while the paper's
``Z_s (delta + epsilon) / delta`` takes them from a difference of numbers as large as the ball: at
Z_m = 1e-9 R_s half of the digits are gone, at 1e-16 R_s all. Far away the ball becomes a dot.
"""

import numpy as np
import pytest
from hypothesis import strategies as st
from support.camera_contract import last_radius
from support.noncentral_mirrors import ray_errors

from omniscv import cameras

SIZE = 512
exponents = st.floats(-300, 3)


def create(distance, **options):
    return cameras.create(
        "noncentral-spherical-mirror",
        width=SIZE,
        height=SIZE,
        mirror_radius=0.5,
        distance=distance,
        **options,
    )


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
