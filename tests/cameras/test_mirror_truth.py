"""Central mirrors against light that bounces off the real surface, in 50 digits."""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.cases import cases
from support.mirrors import DIGITS, bounce, hyperboloid, off_axis, paraboloid, plane

from omniscv import cameras

SIZE = 400
EPS = mp.mpf(2.3e-16)
place = st.tuples(st.floats(0, SIZE), st.floats(0, SIZE))
# 1 cm to 100 m; and mirrors as long and as flat as float64 has them: xi rounds to 1 from q / d = 1e-8 on.
metres = st.one_of(st.floats(-2, 2), st.floats(-7.5, 7.5)).map(lambda e: 10**e)


def example(kind, q, d, spread):
    """A camera of each kind with its real mirror; ``spread``: radii up to this many times the mirror's q."""
    size = {"width": SIZE, "height": SIZE}
    if kind == "parabolic":
        focal = SIZE / 2 / (spread * q)
        camera = cameras.create("catadioptric-parabolic", **size, semi_latus_rectum=q, focal=focal)
        return camera, paraboloid(q)
    if kind == "hyperbolic":
        focal = SIZE / 2 / (spread * edge_of_the_hyperboloid(d, q))
        camera = cameras.create(
            "catadioptric-hyperbolic", **size, distance=d, semi_latus_rectum=q, focal=focal
        )
        return camera, hyperboloid(d, q)
    return cameras.create("catadioptric-planar", **size, focal=SIZE / 2 / spread), plane(d)


@mp.workdps(DIGITS)
def edge_of_the_hyperboloid(d, q):
    """The radius, focal lengths, from which on camera rays miss it."""
    d, q = mp.mpf(d), mp.mpf(q)
    return float(mp.sqrt(2 * q * (mp.hypot(d, q) + q)) / d)


kinds = pytest.mark.parametrize("kind", ["parabolic", "hyperbolic", "planar"])
spreads = st.floats(-2, 2).map(lambda e: 10**e)


@kinds
@cases(15)
@given(metres, metres, spreads, place)
def test_rays(kind, q, d, spread, pixel):
    """Direction to a few roundings of the pixel; a ray exactly where camera rays meet the mirror."""
    camera, mirror = example(kind, q, d, spread)
    rays = camera.unproject(np.array(pixel))
    with mp.workdps(DIGITS):
        x, y = off_axis(camera, pixel)
        truth, more, less = (bounce(mirror, k * x, k * y) for k in (1, 1 + 100 * EPS, 1 - 100 * EPS))
        assume((more is None) == (less is None))  # not on the mirror's very edge
        on_mirror = truth is not None
        r_px = float(mp.hypot(x, y) * camera.focal)
        assume(abs(r_px - SIZE / 2) > 1e-9)
        assert rays.valid == (on_mirror and r_px < SIZE / 2)
        if rays.valid:
            turn = mp.norm(mp.matrix(more[1]) - mp.matrix(less[1])) / 200
            off = mp.norm(mp.matrix([mp.mpf(v) for v in rays.directions.tolist()]) - mp.matrix(truth[1]))
            assert off <= 4 * turn + 4 * EPS
            # One viewpoint: the reflected ray, drawn back, meets the origin.
            hit, direction = (mp.matrix(v) for v in truth)
            along = mp.fdot(hit, direction)
            assert along > 0
            assert mp.norm(hit - along * direction) <= mp.mpf(10) ** -40 * (mp.norm(hit) + q + d)
