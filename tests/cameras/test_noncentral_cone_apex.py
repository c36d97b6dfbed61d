"""The conical mirror at its tip, ``r = 0``.

Story. The tip has no normal: as r runs to 0 the ray keeps its angle 2 tau from the axis, in whatever azimuth
it came, and at r = 0 there is no azimuth left. One arbitrary direction would come out as valid; it must not.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases
from support.noncentral_mirrors import ray_errors

from omniscv import cameras


def create(size=101, half_angle_deg=60, **options):
    return cameras.create(
        "noncentral-conical-mirror",
        width=size,
        height=size,
        half_angle_deg=half_angle_deg,
        distance=0.3,
        **options,
    )


def test_the_tip_is_no_ray():
    camera = create()
    assert not camera.valid()[50, 50]
    assert camera.valid()[49:52, 49:52].sum() == 8
    rays = camera.unproject(np.array([50.5, 50.5]))
    assert np.isnan(rays.directions).all()


@pytest.mark.parametrize("r_px", [10.0**-k for k in (0, 4, 9, 13)])
def test_rays_against_reflection(r_px):
    # A centre at (0, 0), so that a pixel can be as near to it as one likes.
    camera = create(center=(0, 0))
    angle, offset = ray_errors(camera, (0.6 * r_px, 0.8 * r_px))
    assert angle <= 1e-15
    assert offset <= 1e-15


@cases(15)
@given(st.floats(-13, 0), st.floats(0, np.pi / 2))
def test_the_ray_keeps_its_angle_and_azimuth(exponent, azimuth):
    """Within 2e-2 rad per px of 2 tau (the focal length is 50.5 px), and exact in azimuth."""
    camera = create(center=(0, 0))
    r_px = 10**exponent
    rays = camera.unproject(r_px * np.array([np.cos(azimuth), np.sin(azimuth)]))
    x, y, z = rays.directions
    assert abs(np.arctan2(np.hypot(x, y), z) - np.radians(120)) <= 0.02 * r_px + 1e-15
    assert abs(np.arctan2(y, x) - azimuth) <= 1e-15
    assert abs(rays.origins[2] - 0.3) <= 0.3 * 0.03 * r_px + 1e-15
