"""The non-central panorama at radius 0 and at a radius far larger than any room.

Story. A point is seen by how far it lies ahead of the circle, ``hypot(x, z) - R_c``: with a large circle
that is a difference of like numbers. A point given in float64 metres from the axis is known to 1e-16 R_c,
so at a distance s of its optical centre the elevation is known to 1e-16 R_c / s: no code can do better,
and this one does no worse. The first and last row look along the circle's cylinder, where rounding decides
between ahead and behind: they must not be lost.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

WIDTH, HEIGHT = 200, 100


def create(radius):
    return cameras.create("noncentral-panorama", width=WIDTH, height=HEIGHT, radius=radius)


@cases(15)
@given(
    st.one_of(st.just(0.0), st.floats(-300, 12).map(lambda e: 10**e)),
    st.floats(0, WIDTH),
    st.one_of(st.floats(0, HEIGHT), st.sampled_from([0.0, 0.5, HEIGHT - 0.5, HEIGHT])),
    st.floats(-3, 9).map(lambda e: 10**e),
)
def test_the_pixel_comes_back_as_well_as_the_point_is_known(radius, u, v, away):
    camera = create(radius)
    pixel = np.array([u, v])
    rays = camera.unproject(pixel)
    assert rays.valid
    known = 4e-16 * max(radius / away, 1)  # radians: two roundings in each coordinate
    if known > 1e-6:
        return  # a point lost in the rounding of its own coordinates
    again, seen = camera.project(rays.origins + away * rays.directions)
    inside_by = abs(np.cos((0.5 - v / HEIGHT) * np.pi))
    assert seen or inside_by <= known
    if seen:
        assert abs(again[1] - v) <= 1e-12 + known * HEIGHT / np.pi
        # Azimuth is lost at the poles of a circle of no size, as in any panorama; the seam is one place.
        around = abs(again[0] - u) % WIDTH
        lever = (radius + away * inside_by) / (radius + away)
        assert min(around, WIDTH - around) * lever <= 1e-12 * WIDTH


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3, 1e9])
def test_first_and_last_row_are_kept(radius):
    """Corner to corner of the image: straight up and straight down, over a circle of any size."""
    camera = create(radius)
    u = np.linspace(0, WIDTH, 401)
    for v in (0.0, HEIGHT):
        rays = camera.unproject(np.stack([u, np.full_like(u, v)], axis=-1))
        pixels, seen = camera.project(rays.origins + radius * rays.directions)
        assert seen.all()
        np.testing.assert_allclose(pixels[:, 1], v, rtol=0, atol=1e-12)
        around = np.abs(pixels[:, 0] - u)
        np.testing.assert_allclose(np.minimum(around, WIDTH - around), 0, atol=1e-12 * WIDTH)
