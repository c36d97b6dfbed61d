"""Awkward points and images: on the axis, at a centre, far, NaN; 1x1, odd, wide, off centre; float32.

Story. ``project`` divides by distances that are 0 on the axis and at the centres. Whatever comes out as
valid must be a pixel that sees the point; everything else is marked, and NumPy stays silent (warnings
are errors here).
"""

import numpy as np
import pytest

from omniscv import cameras

MODELS = {
    "noncentral-panorama": {"radius": 0.5},
    "noncentral-conical-mirror": {"half_angle_deg": 60, "distance": 0.3},
    "noncentral-spherical-mirror": {"mirror_radius": 0.5, "distance": 0.3},
}
SPHERE = "noncentral-spherical-mirror"
models = pytest.mark.parametrize("name", MODELS)


def create(name, width=101, height=101, center=None):
    placed = {"center": center} if name != "noncentral-panorama" else {}
    return cameras.create(name, width=width, height=height, **MODELS[name], **placed)


@models
def test_points_on_the_axis(name):
    """On its axis a mirror ball sees only what is before it, in the middle; the others see nothing."""
    z = np.array([-1e9, -1, 0, 0.1, 0.29, 0.3, 0.31, 0.8, 1.3, 1.31, 1e9])
    points = np.stack([0 * z, 0 * z, z], axis=-1)
    if name == "noncentral-panorama":
        points = points[:, [0, 2, 1]]
    pixels, valid = create(name).project(points)
    np.testing.assert_array_equal(valid, (z <= 0.3) & (name == SPHERE))
    assert (pixels[valid] == 50.5).all()


@models
def test_points_at_the_centres(name):
    """A ray's own origin is in no direction. (Mirrors: it lies on the axis, where many rays meet.)"""
    camera = create(name)
    rays = camera.unproject()
    pixels, seen = camera.project(rays.origins[rays.valid])
    if name == SPHERE:  # before the ball the axis is seen in its middle
        assert (pixels[seen] == 50.5).all()
        assert (rays.origins[rays.valid][seen][:, 2] <= 0.3).all()
    else:
        # The panorama's centres are off the circle by a rounding, or on it: at the pole or nowhere.
        away = np.linalg.norm(rays.origins[rays.valid][seen], axis=1) - 0.5
        assert (np.abs(away) < 1e-15).all()
