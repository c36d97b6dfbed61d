"""Angles from each pixel's ray to the next one's, against the angles of all pairs of neighbours."""

import numpy as np
import pytest

from omniscv.cameras import create
from omniscv.planning import densities

CAMERAS = {
    "pinhole": create("pinhole", 9, 7, fov_deg=120),
    "fisheye": create("fisheye-orthographic", 12, 12, fov_deg=170),
    "cylinder": create("cylindrical", 16, 6, fov_v_deg=120),
}


def angles(first, second):
    """The angles between rays, rad; NaN where one is not valid."""
    return np.arctan2(np.linalg.norm(np.cross(first, second), axis=-1), (first * second).sum(axis=-1))


@pytest.mark.parametrize("name", CAMERAS)
def test_a_step_is_the_larger_angle_to_the_next_ray_of_row_and_column(name):
    """Those of the last row and column are the angles to the ones before."""
    rays = CAMERAS[name].unproject()
    directions = np.where(rays.valid[..., None], rays.directions, np.nan)
    height, width = rays.valid.shape
    expected = np.full((height, width), np.nan)
    for row in range(height):
        for column in range(width):
            top = min(row, height - 2)
            left = min(column, width - 2)
            down = angles(directions[top, column], directions[top + 1, column])
            right = angles(directions[row, left], directions[row, left + 1])
            expected[row, column] = np.fmax(down, right)
    np.testing.assert_allclose(densities.steps(directions), expected, rtol=1e-9)
