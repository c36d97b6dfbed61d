"""Poles and seam: where maps of the sphere are cut or squeezed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

PANORAMAS = [("equirectangular", {}), ("cylindrical", {"fov_v_deg": 180})]
every_panorama = pytest.mark.parametrize(("name", "parameters"), PANORAMAS)


@every_panorama
def test_poles(name, parameters):
    """Straight up is the first row, straight down the last; all columns of these rows see it."""
    camera = cameras.create(name, width=64, height=32, **parameters)
    for metres in (1e-300, 1e-9, 1.0, 1e9, 1e149):
        (up, down), seen = camera.project(metres * np.array([[0, -1.0, 0], [0, 1.0, 0]]))
        assert seen.all()
        assert (up[1], down[1]) == (0, 32)
    for row, y in ((0, -1), (32, 1)):
        rays = camera.unproject(np.stack([np.arange(65.0), np.full(65, row)], axis=-1))
        assert rays.valid.all()
        np.testing.assert_allclose(rays.directions, [(0, y, 0)] * 65, rtol=0, atol=1e-16)


@every_panorama
@cases(15)
@given(st.floats(-16, 0), st.sampled_from([-1, 1]), st.floats(-1.5, 1.5))
def test_the_seam(name, parameters, exponent, side, elevation):
    """Behind the camera: a hair to the left is the left border, a hair to the right the right one."""
    camera = cameras.create(name, width=64, height=32, **parameters)
    aside = side * 10**exponent
    level = np.cos(elevation)
    point = [level * np.sin(aside), -np.sin(elevation), -level * np.cos(aside)]
    pixel, seen = camera.project(point)
    assert seen
    expected = aside / (2 * np.pi) * 64
    assert pixel[0] == pytest.approx(64 - expected if side > 0 else -expected, abs=1e-12)


@every_panorama
def test_signed_zeros_behind_the_camera_are_one_direction(name, parameters):
    """x = 0.0 and x = -0.0 are one direction: either border, and both see it."""
    camera = cameras.create(name, width=64, height=32, **parameters)
    pixels, seen = camera.project(np.array([[0.0, 0, -1], [-0.0, 0, -1]]))
    assert seen.all()
    assert set(pixels[:, 0]) <= {0.0, 64.0}
    rays = camera.unproject(np.array([[0.0, 16], [64.0, 16]])).directions
    np.testing.assert_allclose(rays, [(0, 0, -1)] * 2, rtol=0, atol=2e-16)
