"""Poles, seam, and the cube's edges and corners: where maps of the sphere are cut or squeezed.

Story. Straight up every column of a panorama sees the same point, and atan2(0, 0) picks one; at +-180 deg
left and right border are one place, and -0.0 decides. Images are made from the six faces of a cube: rays to
its 12 edges and 8 corners lie on the border of two or three pictures, where ``x / z`` is exactly 1 or
1 + 2e-16. A pixel that misses there is a dark line across the image. So: every such direction is a pixel of
every model that sees it, comes back to 1e-12 rad, and its neighbours one last digit away are its neighbours
in the image.
"""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from examples import example_cameras
from omniscv import cameras

EXAMPLES = example_cameras(central_only=True)
every_central = pytest.mark.parametrize("camera", EXAMPLES.values(), ids=EXAMPLES)
PANORAMAS = [("equirectangular", {}), ("cylindrical", {"fov_v_deg": 180})]
every_panorama = pytest.mark.parametrize(("name", "parameters"), PANORAMAS)


def edge_points(count=201):
    """(N, 3) points all along the 12 edges of the cube [-1, 1]^3."""
    along = np.linspace(-1, 1, count)
    edges = [
        np.insert(np.broadcast_to(ends, (count, 2)), axis, along, axis=1)
        for ends in itertools.product((-1.0, 1.0), repeat=2)
        for axis in range(3)
    ]
    return np.concatenate(edges)


@every_central
def test_no_crack_along_edges(camera):
    """One last digit to either side of an edge: both seen, in places that touch or see one ray (the borders
    of a panorama, of a cube map's faces); or the image ends there."""
    points = edge_points()
    pixels, seen = camera.project(points)
    for axis in range(3):
        for side in (-np.inf, np.inf):
            beside = points.copy()
            beside[:, axis] = np.nextafter(points[:, axis], side)
            there, seen_there = camera.project(beside)
            both = seen & seen_there
            apart = np.abs(there - pixels)[both].max(axis=1, initial=0)
            rays, rays_there = (camera.unproject(places[both]).directions for places in (pixels, there))
            assert ((apart <= 1e-6) | (np.linalg.norm(rays_there - rays, axis=1) <= 1e-12)).all()
            # One is seen and the other not only where the rays end: further out there is no pixel.
            lone = seen ^ seen_there
            last = np.where(seen[:, None], pixels, there)[lone]
            assert not camera.valid(camera.center + (last - camera.center) * (1 + 1e-9)).any()


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
    pixel, seen = camera.project(
        np.array([level * np.sin(aside), -np.sin(elevation), -level * np.cos(aside)])
    )
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
