"""Where the double sphere's image ends: where its radius stops growing, found here in 40 digits.

The limit that was published with the model, ``z > -w2 d``, ``w2 = (w1 + xi) / sqrt(2 w1 xi + xi^2 + 1)``, is
another one but at xi = 0: it refuses rays that pixels have, or, for xi > 1, accepts two rays of one pixel.
"""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras

SIZE = {"width": 400, "height": 400}
# xi, alpha, the last angle in degrees, the published one.
TABLE = [
    (-0.2, 0.55, 138.300, 137.075),
    (-0.27, 0.5635, 130.939, 128.587),
    (0.5, 0.6, 153.691, 147.426),
    (0.9, 0.65, 171.901, 149.638),
]


def create(xi, alpha, f=60.0):
    return cameras.create("double-sphere", **SIZE, fx=f, fy=f, xi=xi, alpha=alpha)


def sees(camera, theta):
    """Whether the camera has a pixel, in the image or not, for a ray at theta: its image is made larger."""
    vast = cameras.from_dict({**camera.to_dict(), "width": 10**6, "height": 100, "cx": 1.0, "cy": 50.0})
    return bool(vast.project(np.array([np.sin(theta), 0.0, np.cos(theta)]))[1])


def last_angle(camera):
    low, high = 0.0, np.pi
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if sees(camera, middle) else (low, middle)
    return low


@mp.workdps(40)
def denominator_and_growth(xi, alpha, theta):
    """n of eq. 40, and the sign of d(r)/d(theta), r = sin(theta) / n, at a point 1 away."""
    xi, alpha = mp.mpf(xi), mp.mpf(alpha)

    def n(t):
        k = xi + mp.cos(t)
        return alpha * mp.sqrt(mp.sin(t) ** 2 + k**2) + (1 - alpha) * k

    return n(theta), mp.diff(lambda t: mp.sin(t) / n(t), theta)


def true_last_angle(xi, alpha):
    """The first theta where r grows no more, or is infinite, by bisection."""
    low, high = mp.mpf(0), mp.pi
    for _ in range(40):
        middle = (low + high) / 2
        n, growth = denominator_and_growth(xi, alpha, middle)
        low, high = (middle, high) if n > 0 and growth > 0 else (low, middle)
    return float(low)


def published_limit(xi, alpha):
    w1 = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
    return np.arccos(-(w1 + xi) / np.sqrt(2 * w1 * xi + xi**2 + 1))


@pytest.mark.parametrize(("xi", "alpha", "last_deg", "published_deg"), TABLE)
def test_known_ends(xi, alpha, last_deg, published_deg):
    assert np.degrees(last_angle(create(xi, alpha))) == pytest.approx(last_deg, abs=6e-4)
    assert np.degrees(published_limit(xi, alpha)) == pytest.approx(published_deg, abs=6e-4)


@cases(5)
@given(st.floats(-0.95, 1), st.floats(0.52, 1))
def test_the_domain_ends_where_the_radius_turns(xi, alpha):
    assert last_angle(create(xi, alpha)) == pytest.approx(true_last_angle(xi, alpha), abs=1e-9)


@pytest.mark.parametrize(("xi", "alpha", "last_deg", "published_deg"), TABLE)
def test_the_last_pixel_of_the_image_is_the_last_ray(xi, alpha, last_deg, published_deg):
    """``r^2 = 1 / (2 alpha - 1)`` in the image, the turn in space: one border."""
    f = 190 * np.sqrt(2 * alpha - 1)  # the border at 190 px
    camera = create(xi, alpha, f)
    radii = 190 * np.array([1 - 1e-15, 1 + 1e-12])
    rays = camera.unproject(np.stack([200 + radii, np.full(2, 200)], axis=-1))
    np.testing.assert_array_equal(rays.valid, [True, False])
    assert np.degrees(np.arctan2(*rays.directions[0, [0, 2]])) == pytest.approx(last_deg, abs=6e-4)


@pytest.mark.parametrize(("row", "share"), [(1, 0.001), (2, 0.02), (3, 0.19)], ids=lambda value: str(value))
def test_a_ring_of_pixels_comes_back_that_the_published_limit_refuses(row, share):
    """Of the radii that have a ray, this share has one beyond the published limit; ours come back."""
    xi, alpha = TABLE[row][:2]
    camera = create(xi, alpha, 190 * np.sqrt(2 * alpha - 1))
    radii = np.linspace(0, 189.99, 2000)
    pixels = camera.center + np.stack([radii, 0 * radii], axis=-1)
    rays = camera.unproject(pixels)
    assert rays.valid.all()
    refused = np.arccos(rays.directions[:, 2]) > published_limit(xi, alpha)
    assert refused.mean() == pytest.approx(share, rel=0.5)
    again, seen = camera.project(5 * rays.directions)
    assert seen[refused].all()
    np.testing.assert_allclose(again[refused], pixels[refused], rtol=0, atol=1e-6)
