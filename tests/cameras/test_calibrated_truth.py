"""Calibrated lenses against their published formulas in 40 digits: from points to pixels, as each is written.

``unproject`` is held to the same: the pixel of its ray, by the formula, is the pixel that it was given.
"""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.calibrated import LENSES, SIZE, drawn_lens
from support.cases import cases
from support.lens_formulas import FORMULAS

DIGITS = 40
TOLERANCE = 1e-9  # px


def test_every_lens_has_a_formula():
    assert set(FORMULAS) == set(LENSES)


@pytest.mark.parametrize("name", LENSES)
@cases(16)
@given(st.integers(0, 2**32 - 1))
def test_rays_and_pixels(name, seed):
    rng = np.random.default_rng(seed)
    camera = drawn_lens(name, rng)
    pixels = rng.uniform(0, (SIZE["width"], SIZE["height"]), (8, 2))
    rays = camera.unproject(pixels)
    for pixel, ray in zip(pixels[rays.valid], rays.directions[rays.valid], strict=True):
        point = ray * 10 ** rng.uniform(-3, 3)
        projected, seen = camera.project(point)
        assert seen
        with mp.workdps(DIGITS):
            truth = np.array(FORMULAS[name](camera, *map(mp.mpf, point.tolist())), dtype=float)
        np.testing.assert_allclose(projected, truth, rtol=0, atol=TOLERANCE)
        np.testing.assert_allclose(pixel, truth, rtol=0, atol=TOLERANCE)
