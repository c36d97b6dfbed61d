"""Calibrated lenses against their published formulas in 40 digits: from points to pixels, as each is written.

``unproject`` is held to the same: the pixel of its ray, by the formula, is the pixel that it was given.
"""

import mpmath as mp
import numpy as np
import pytest
from support.lens_formulas import FORMULAS

from examples import example_cameras

DIGITS = 40
TOLERANCE = 1e-9  # px
LENSES = {key: camera for key, camera in example_cameras().items() if camera.name in FORMULAS}


@pytest.mark.parametrize("key", LENSES)
def test_rays_and_pixels(key):
    camera, rng = LENSES[key], np.random.default_rng(1)
    pixels = rng.uniform(0, (camera.width, camera.height), (24, 2))
    rays = camera.unproject(pixels)
    assert rays.valid.sum() > 4
    for pixel, ray in zip(pixels[rays.valid], rays.directions[rays.valid], strict=True):
        point = ray * 10 ** rng.uniform(-3, 3)
        projected, seen = camera.project(point)
        assert seen
        with mp.workdps(DIGITS):
            truth = np.array(FORMULAS[camera.name](camera, *map(mp.mpf, point.tolist())), dtype=float)
        np.testing.assert_allclose(projected, truth, rtol=0, atol=TOLERANCE)
        np.testing.assert_allclose(pixel, truth, rtol=0, atol=TOLERANCE)
