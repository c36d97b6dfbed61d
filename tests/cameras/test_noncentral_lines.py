"""Plücker coordinates of rays, and known answers of the paper's formulas as design.md corrects them."""

import numpy as np
import pytest

from omniscv import cameras
from omniscv.cameras import Rays

SIZE = 100
CAMERAS = {
    "panorama": ("noncentral-panorama", {"radius": 0.7}),
    "cone": ("noncentral-conical-mirror", {"half_angle_deg": 55, "distance": 0.3}),
    "cone, 45 degrees": ("noncentral-conical-mirror", {"half_angle_deg": 45, "distance": 0.3}),
    "ball": ("noncentral-spherical-mirror", {"mirror_radius": 0.5, "distance": 0.3}),
}


def create(key):
    name, parameters = CAMERAS[key]
    return cameras.create(name, width=SIZE, height=SIZE, **parameters)


def same_lines(actual, expected):
    """Equal as lines: coordinates are homogeneous, and a line may be walked either way."""
    actual = actual / np.linalg.norm(actual[..., :3], axis=-1, keepdims=True)
    expected = expected / np.linalg.norm(expected[..., :3], axis=-1, keepdims=True)
    way = np.sign((actual * expected).sum(axis=-1, keepdims=True))
    # 1e-13: entries are near 1, and the paper's ball takes differences of numbers near 100.
    np.testing.assert_allclose(actual, way * expected, rtol=0, atol=1e-13)


def moved(rays, R, t):
    """The rays in a frame with ``p_new = R (p - t)``."""
    return Rays((rays.origins - t) @ np.transpose(R), rays.directions @ np.transpose(R), rays.valid)


@pytest.mark.parametrize("key", CAMERAS)
def test_lines_are_plucker_coordinates(key):
    """Direction and moment are perpendicular, and the moment is the same from any point of the ray."""
    rays = create(key).unproject()
    lines = rays.lines()
    assert lines.shape == (SIZE, SIZE, 6)
    assert np.isnan(lines[~rays.valid]).all()
    direction, moment = lines[rays.valid][:, :3], lines[rays.valid][:, 3:]
    np.testing.assert_allclose((direction * moment).sum(axis=1), 0, rtol=0, atol=1e-15)
    further = rays.origins[rays.valid] + 5 * direction
    np.testing.assert_allclose(
        np.cross(further, direction), moment, rtol=0, atol=5e-15
    )  # a 5 m arm's rounding


def test_panorama_in_the_papers_frame():
    """The paper's axis of revolution points up; its phi is counted from there, its theta to the left.

    The paper prints ``R_c sin(phi)`` in the moment. Every such line passes through (0, 0, -R_c): a
    central camera. The origin ``R_c (cos theta, sin theta, 0)`` of its text gives ``R_c cos(phi)``.
    """
    camera = create("panorama")
    R_paper_c = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    u, v = np.moveaxis(camera.pixels(), -1, 0)
    theta, phi = -(2 * u / SIZE - 1) * np.pi, v / SIZE * np.pi
    xi = np.stack([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)], axis=-1)
    moment = camera.radius * np.stack([np.sin(theta), -np.cos(theta), 0 * theta], axis=-1)

    expected = np.concatenate([xi, np.cos(phi)[..., None] * moment], axis=-1)
    same_lines(moved(camera.unproject(), R_paper_c, 0).lines(), expected)

    as_printed = np.sin(phi)[..., None] * moment
    np.testing.assert_allclose(np.cross((0, 0, -camera.radius), xi), as_printed, rtol=0, atol=1e-15)
