"""The hyperbolic mirror as it degenerates: 2p -> 0, 2p -> infinity, d -> 0, xi -> 1.

Story. With q = 2p the model's numbers are xi = d / D, eta = -q / D, D = sqrt(d^2 + q^2). As q / d falls, xi
rounds to 1 from 1e-8 on, and ``1 - xi^2``, all that makes it a hyperboloid, is 0; as it grows, ``d / 2a =
d / (D - q)`` cancels, and so did ``xi - cos`` of rays that are all next to sideways: pixels came back 42 px
off at q / d = 1e15. The mirror does not care: truth here is light reflected off the real hyperboloid in 50
digits, with ratios from 1e-15 to 1e15.
"""

import mpmath as mp
import numpy as np
import pytest
from support.central_mirrors import DIGITS, bounce, hyperboloid, off_axis

from omniscv import cameras

SIZE = 201
RATIOS = [10.0**k for k in (-15, -6, 0, 6, 15)]
ratios = pytest.mark.parametrize("ratio", RATIOS)  # 2p / d


def create(distance, semi_latus_rectum, spread=0.9, **options):
    """A camera whose image circle ends at ``spread`` of the mirror's own edge."""
    d, q = mp.mpf(distance), mp.mpf(semi_latus_rectum)
    edge = float(mp.sqrt(2 * q * (mp.hypot(d, q) + q)) / d)
    return cameras.create(
        "catadioptric-hyperbolic",
        width=SIZE,
        height=SIZE,
        distance=distance,
        semi_latus_rectum=semi_latus_rectum,
        focal=SIZE / 2 / (spread * edge),
        **options,
    )


@ratios
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_rays_are_reflected_ones(ratio, scale):
    """Over the whole mirror, to 1e-14 rad: a few roundings, beside a mirror that turns rays by up to pi."""
    camera = create(scale, ratio * scale)
    rng = np.random.default_rng(7)
    for pixel in rng.uniform(30, 171, (6, 2)):
        rays = camera.unproject(pixel)
        assert rays.valid
        with mp.workdps(DIGITS):
            mirror = hyperboloid(scale, mp.mpf(camera.semi_latus_rectum))
            _, truth = bounce(mirror, *off_axis(camera, pixel))
            off = mp.norm(mp.matrix([mp.mpf(v) for v in rays.directions.tolist()]) - mp.matrix(truth))
        assert off <= 1e-14


@pytest.mark.parametrize("ratio", [1e3, 1e6, 1e9, 1e12])
def test_a_flat_hyperboloid_is_a_plane(ratio):
    """2p -> infinity, or d -> 0: the planar mirror, off by d / 2p."""
    planar = cameras.create("catadioptric-planar", width=SIZE, height=SIZE, focal=200)
    for distance, latus in ((1.0, ratio), (1 / ratio, 1.0)):
        flat = cameras.create(
            "catadioptric-hyperbolic",
            width=SIZE,
            height=SIZE,
            distance=distance,
            semi_latus_rectum=latus,
            focal=200,
        )
        off = np.abs(flat.unproject().directions - planar.unproject().directions)[flat.valid()]
        assert off.size == 3 * planar.valid().sum()
        assert off.max() <= 1 / ratio + 1e-15


@pytest.mark.parametrize("ratio", [1e3, 1e6, 1e9, 1e12])
def test_a_far_focus_is_a_telecentric_camera(ratio):
    """xi -> 1: with the camera's focus at infinity the hyperboloid is a paraboloid, off by 2p / d.

    A focal length of f px at d metres is f / d px per metre.
    """
    q, spread = 1.0, 2.0  # radii up to 2 q
    make = {"width": SIZE, "height": SIZE, "semi_latus_rectum": q}
    per_metre = SIZE / 2 / spread / q
    parabolic = cameras.create("catadioptric-parabolic", **make, focal=per_metre)
    hyperbolic = cameras.create(
        "catadioptric-hyperbolic", **make, distance=ratio * q, focal=per_metre * ratio * q
    )
    ours, theirs = hyperbolic.unproject(), parabolic.unproject()
    np.testing.assert_array_equal(ours.valid, theirs.valid)
    off = np.abs(ours.directions - theirs.directions)[ours.valid]
    assert off.max() <= 3 / ratio + 1e-15
