"""Calibrated lenses with drawn parameters: to the end of every domain, and not beyond.

The end is found from outside, by bisection of ``valid`` along rays of the image; no formula is used.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.calibrated import LENSES, drawn_lens, drawn_rays
from support.cases import cases

from omniscv.testing.cameras import PIXEL_TOLERANCE, check_projection

AZIMUTHS = np.linspace(-np.pi, np.pi, 25)[:-1] + 0.05
seeds = st.integers(0, 2**32 - 1)
every_lens = pytest.mark.parametrize("name", LENSES)


def fan(camera, radii):
    """(R, N, 2) pixels at radii (R, N), px, around the principal point."""
    return camera.center + radii[..., None] * np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], axis=-1)


def last_radii(camera):
    """(N,) the last valid radius in every direction, px."""
    low, high = np.zeros(len(AZIMUTHS)), np.full(len(AZIMUTHS), 1000.0)
    for _ in range(60):
        middle = (low + high) / 2
        inside = camera.valid(fan(camera, middle))
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return low


@every_lens
@cases(8)
@given(seeds)
def test_the_whole_domain_comes_back_and_nothing_beyond(name, seed):
    rng = np.random.default_rng(seed)
    camera = drawn_lens(name, rng, **({"fov_deg": rng.uniform(60, 300)} if seed % 3 == 0 else {}))
    last = last_radii(camera)
    pixels = fan(camera, np.multiply.outer([1e-9, 0.1, 0.5, 0.9, 0.99, 0.999], last))
    rays = camera.unproject(pixels)
    assert rays.valid.all()
    again, seen = camera.project(rays.directions * rng.uniform(0.01, 100, (*pixels.shape[:-1], 1)))
    assert seen.all()
    np.testing.assert_allclose(again, pixels, rtol=0, atol=PIXEL_TOLERANCE)
    assert not camera.valid(fan(camera, np.multiply.outer([1.001, 1.1, 2.0], last))).any()


@every_lens
@cases(8)
@given(seeds)
def test_both_sides_of_the_border_agree(name, seed):
    """Rays next to the last one of every direction: what is seen has a ray, and that ray points there."""
    rng = np.random.default_rng(seed)
    camera = drawn_lens(name, rng)
    rim = camera.unproject(fan(camera, last_radii(camera) * (1 - 1e-12))).directions
    aside = 10.0 ** rng.uniform(-15, -1, rim.shape) * rng.choice([-1, 1], rim.shape)
    check_projection(camera, np.concatenate([rim, rim + aside, drawn_rays(rng, 100)]), at_the_border=1e-3)
