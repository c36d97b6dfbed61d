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
def test_points_that_are_no_points(name):
    bad = np.array([[np.nan, 0, 1], [0, np.inf, 1], [1, 1, -np.inf], [np.nan] * 3])
    pixels, valid = create(name).project(bad)
    assert not valid.any()
    assert np.isnan(pixels).all()


@models
def test_points_on_the_axis(name):
    """On its axis a mirror ball sees only what is before it, in the middle; the others see nothing."""
    z = np.array([-1e9, -1, -1e-300, 0, 1e-300, 0.1, 0.29, 0.3, 0.31, 0.8, 1.3, 1.31, 1e9])
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


@models
def test_points_as_far_as_float64_goes(name):
    """1e9 m, 1e100 m: the direction counts, and it is that of the far ray."""
    camera = create(name)
    rays = camera.unproject()
    near, _ = camera.project(rays.origins + 1e9 * rays.directions)
    for away in (1e12, 1e100, 1e150):
        pixels, seen = camera.project(away * rays.directions)
        np.testing.assert_array_equal(seen, rays.valid)
        # Half a metre of origin against 1e9 m.
        np.testing.assert_allclose(pixels[seen], near[seen], rtol=0, atol=1e-6)


@models
@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 9), (9, 1), (3, 2), (4001, 3)])
@pytest.mark.parametrize("center", [None, (-50.25, 3), (1e4, -1e4)])
def test_images_of_any_size(name, width, height, center):
    camera = create(name, width, height, center=center)
    rays = camera.unproject()
    assert np.isfinite(rays.directions[rays.valid]).all()
    assert np.isfinite(rays.origins[rays.valid]).all()
    assert np.isnan(rays.directions[~rays.valid]).all()
    pixels, seen = camera.project(rays.origins + 10 * rays.directions)
    np.testing.assert_array_equal(seen, rays.valid)
    np.testing.assert_allclose(pixels[seen], camera.pixels()[seen], rtol=0, atol=1e-6)
    views = camera.viewpoints()
    assert views.index.shape == (height, width)
    np.testing.assert_array_equal(views.index >= 0, rays.valid)
    np.testing.assert_array_equal(np.unique(views.index[rays.valid]), np.arange(len(views.centers)))


@models
def test_float32_and_whole_numbers(name):
    """Computed in float64 whatever comes in; as exact as the numbers themselves."""
    camera = create(name)
    half = camera.pixels()
    for ours, same in (
        (camera.unproject(half.astype(np.float32)), camera.unproject(half)),
        (camera.unproject(np.array([[20, 30]])), camera.unproject(np.array([[20.0, 30.0]]))),
    ):
        assert ours.directions.dtype == ours.origins.dtype == np.float64
        np.testing.assert_array_equal(ours.directions, same.directions)
    points = np.array([[3, -2, 1], [1, 2, -3]])
    np.testing.assert_array_equal(camera.project(points)[0], camera.project(points.astype(float))[0])
    assert camera.project(points.astype(np.float32))[0].dtype == np.float64


@models
def test_description_and_back(name):
    camera = create(name, center=(50, 49))
    again = cameras.from_dict(camera.to_dict())
    assert again == camera
    np.testing.assert_array_equal(again.unproject().directions, camera.unproject().directions)
