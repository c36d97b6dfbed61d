"""Shared optical centres: one per column or ring, or fewer, and the error that makes."""

import numpy as np
import pytest

from omniscv import cameras

MODELS = {
    "noncentral-panorama": {"radius": 1.0},
    "noncentral-conical-mirror": {"half_angle_deg": 60, "distance": 0.3},
    "noncentral-spherical-mirror": {"mirror_radius": 0.5, "distance": 0.3},
}
MIRRORS = [name for name in MODELS if name != "noncentral-panorama"]


def create(name, width=64, height=64, **options):
    return cameras.create(name, width=width, height=height, **{**MODELS[name], **options})


def displaced(camera, count=None):
    """(H, W) metres between each pixel's own optical centre and the shared one; NaN where invalid."""
    rays, views = camera.unproject(), camera.viewpoints(count)
    return np.linalg.norm(rays.origins - views.centers[views.index], axis=-1)


def test_panorama_by_default_a_column_has_its_own_centre():
    camera = create("noncentral-panorama", 64, 8)
    views = camera.viewpoints()
    np.testing.assert_array_equal(views.index, np.tile(np.arange(64), (8, 1)))
    np.testing.assert_array_equal(views.centers, camera.unproject().origins[0])
    at_rest = create("noncentral-panorama", radius=0).viewpoints()
    np.testing.assert_array_equal(at_rest.centers, np.zeros((1, 3)))


@pytest.mark.parametrize("count", [1, 5, 63, 64, 1000])
def test_panorama_in_equal_steps_of_azimuth(count):
    """No column is further from its centre than the half step's chord, pi R / K at most."""
    camera = create("noncentral-panorama", 64, 4)
    views = camera.viewpoints(count)
    assert len(views.centers) == min(count, 64)
    sizes = np.bincount(views.index[0])
    assert np.ptp(sizes) <= 1
    assert displaced(camera, count).max() <= np.pi * sizes.max() / 64
    assert np.hypot(views.centers[:, 0], views.centers[:, 2]).max() <= 1 + 1e-15


@pytest.mark.parametrize("name", MIRRORS)
def test_mirrors_by_default_a_ring_of_one_pixel(name):
    camera = create(name)
    views, valid = camera.viewpoints(), camera.valid()
    r = np.linalg.norm(camera.pixels() - camera.center, axis=-1)
    np.testing.assert_array_equal(views.index[valid], np.floor(r[valid]))
    np.testing.assert_array_equal(views.centers[:, :2], 0)
    many = camera.viewpoints(10_000)
    np.testing.assert_array_equal(many.centers, views.centers)
    np.testing.assert_array_equal(many.index, views.index)


@pytest.mark.parametrize("name", MIRRORS)
@pytest.mark.parametrize("count", [1, 2, 7, 20])
def test_mirrors_in_equal_steps_of_height(name, count):
    """No pixel is further off than half a step."""
    camera = create(name, 128, 128)
    rays, views = camera.unproject(), camera.viewpoints(count)
    heights = rays.origins[rays.valid][:, 2]
    assert len(views.centers) <= count
    assert np.nanmax(displaced(camera, count)) <= np.ptp(heights) / count / 2 + 1e-15


def test_a_mirror_out_of_the_image_has_no_viewpoint():
    views = create(MIRRORS[0], center=(1e4, 1e4)).viewpoints()
    assert views.centers.shape == (0, 3)
    assert (views.index == -1).all()
