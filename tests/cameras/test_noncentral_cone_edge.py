"""The conical mirror at ``r = tan tau``, where the camera's ray runs along the cone's side.

Story. The formula goes on where the mirror does not: past tan tau it gives rays of a cone that is not
there, and no NaN warns of it. On this side the hit runs away to infinity while the ray stays well behaved.
"""

import numpy as np
import pytest
from support.noncentral_mirrors import bounce, ray_errors

from omniscv import cameras

SIZE = 512
angles = pytest.mark.parametrize("half_angle_deg", [5, 30, 44])


def create(half_angle_deg):
    """The edge is within the image circle up to 45 degrees: the focal length is half the width."""
    return cameras.create(
        "noncentral-conical-mirror", width=SIZE, height=SIZE, half_angle_deg=half_angle_deg, distance=0.3
    )


@angles
@pytest.mark.parametrize("part_left", [10.0**-k for k in (1, 5, 9, 13)])
def test_rays_against_reflection(half_angle_deg, part_left):
    camera = create(half_angle_deg)
    edge_px = camera.focal * np.tan(np.radians(half_angle_deg))
    pixel = camera.center + np.array([0.6, -0.8]) * edge_px * (1 - part_left)
    angle, offset = ray_errors(camera, pixel)
    assert angle <= 1e-15
    assert offset <= 1e-15


@angles
def test_past_the_edge_is_marked(half_angle_deg):
    """To 1e-13: the reflection hits this side of the edge, misses on the other, and so says ``valid``."""
    camera = create(half_angle_deg)
    edge_px = camera.focal * np.tan(np.radians(half_angle_deg))
    for part, met in ((-1e-13, True), (1e-13, False), (1e-6, False), (0.5, False)):
        pixel = np.array([SIZE / 2 + edge_px * (1 + part), SIZE / 2])
        if pixel[0] <= SIZE:
            assert (bounce(camera, pixel) is not None) == met
            assert camera.valid(pixel) == met


@angles
def test_no_point_is_found_along_or_within_the_cone(half_angle_deg):
    camera = create(half_angle_deg)
    slope = np.tan(np.radians(half_angle_deg))
    z = np.array([0.4, 1.0, 100.0])
    for part, visible in ((1 - 1e-9, False), (1 + 1e-9, True)):
        points = np.stack([(z - 0.3) * slope * part, 0 * z, z], axis=-1)
        assert (camera.project(points)[1] == visible).all()
