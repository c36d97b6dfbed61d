"""Central mirrors against light that bounces off the real surface, in 50 digits.

The test's own geometry: a surface, a camera ray, where they meet, the law of reflection. The sphere model's
xi, eta and lambda are not in it. With q the semi latus rectum, which gives each surface its size, and the
point where all rays seem to meet, a focus, at the origin:

- paraboloid ``x^2 + y^2 = 2 q (z + q / 2)`` under a telecentric camera: rays parallel to z, ``focal`` px
  per metre;
- hyperboloid of the foci (0, 0, 0) and (0, 0, -d), where the camera is: the sheet of the points that are 2a
  nearer to the first, ``q = b^2 / a``, ``a^2 + b^2 = (d / 2)^2``;
- plane halfway between a pinhole camera and its mirror image, the origin.
"""

from collections.abc import Callable
from typing import NamedTuple

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from omniscv import cameras

SIZE = 400
DIGITS = 50
EPS = mp.mpf(2.3e-16)
place = st.tuples(st.floats(0, SIZE), st.floats(0, SIZE))
metres = st.floats(-2, 2).map(lambda e: 10**e)  # 1 cm to 100 m


class Mirror(NamedTuple):
    """A surface ``X^T Q X = 0``, the part of it with z >= ``nearest``, and the camera's rays."""

    quadric: mp.matrix
    nearest: mp.mpf
    ray: Callable  # (x, y) in units of the focal length -> start, direction


@mp.workdps(DIGITS)
def paraboloid(q):
    q = mp.mpf(q)
    quadric = mp.matrix([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, -q], [0, 0, -q, -q * q]])
    return Mirror(quadric, -q / 2, lambda x, y: (mp.matrix([x, y, -10 * q, 1]), mp.matrix([0, 0, 1, 0])))


@mp.workdps(DIGITS)
def hyperboloid(d, q):
    d, q = mp.mpf(d), mp.mpf(q)
    c = d / 2
    a = (mp.sqrt(q * q + 4 * c * c) - q) / 2  # the positive root of a^2 + q a = c^2
    b2 = q * a
    # (z + c)^2 / a^2 - (x^2 + y^2) / b^2 = 1
    k = b2 / a**2
    quadric = mp.matrix([[-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, k, k * c], [0, 0, k * c, k * c * c - b2]])
    return Mirror(quadric, a - c, lambda x, y: (mp.matrix([0, 0, -d, 1]), mp.matrix([x, y, 1, 0])))


@mp.workdps(DIGITS)
def plane(half_distance):
    h = mp.mpf(half_distance)
    # z = -h, as a quadric: (z + h) w = 0
    quadric = mp.matrix([[0] * 4, [0] * 4, [0, 0, 0, mp.mpf(1) / 2], [0, 0, mp.mpf(1) / 2, h]])
    return Mirror(quadric, -h, lambda x, y: (mp.matrix([0, 0, -2 * h, 1]), mp.matrix([x, y, 1, 0])))


@mp.workdps(DIGITS)
def bounce(mirror, x, y):
    """(hit, unit direction) of a camera ray off the surface, or None where it misses."""
    start, ray = mirror.ray(x, y)
    a, b = (mp.fdot(ray, mirror.quadric * other) for other in (ray, start))
    c = mp.fdot(start, mirror.quadric * start)
    square = b * b - a * c
    if square < 0:
        return None
    # Not divided by a, which is 0 for the plane, and for rays along the paraboloid's axis.
    ways = [c / bottom for bottom in (-b + mp.sqrt(square), -b - mp.sqrt(square)) if bottom]
    ahead = [start + way * ray for way in ways if way > 0]
    hits = [p for p in ahead if p[2] >= mirror.nearest * (1 + mp.eps)]
    if not hits:
        return None
    hit = min(hits, key=lambda p: p[2])
    normal, d = unit((mirror.quadric * hit)[:3]), unit(ray[:3])
    along = mp.fdot(d, normal)
    return hit[:3], [d[i] - 2 * along * normal[i] for i in range(3)]


def unit(vector):
    length = mp.norm(mp.matrix(vector))
    return [v / length for v in vector]


def example(kind, q, d, spread):
    """A camera of each kind with its real mirror; ``spread``: radii up to this many times the mirror's q."""
    size = {"width": SIZE, "height": SIZE}
    if kind == "parabolic":
        focal = SIZE / 2 / (spread * q)
        camera = cameras.create("catadioptric-parabolic", **size, semi_latus_rectum=q, focal=focal)
        return camera, paraboloid(q)
    if kind == "hyperbolic":
        camera = cameras.create("catadioptric-hyperbolic", **size, distance=d, semi_latus_rectum=q)
        return camera, hyperboloid(d, q)
    return cameras.create("catadioptric-planar", **size, focal=SIZE / 2 / spread), plane(d)


def off_axis(camera, pixel):
    """(x, y) of a pixel in units of the focal length, in 50 digits."""
    return [
        (mp.mpf(p) - mp.mpf(c)) / mp.mpf(camera.focal)
        for p, c in zip(np.asarray(pixel).tolist(), camera.center.tolist(), strict=True)
    ]


kinds = pytest.mark.parametrize("kind", ["parabolic", "hyperbolic", "planar"])
spreads = st.floats(-2, 2).map(lambda e: 10**e)


@kinds
@given(metres, metres, spreads, place)
def test_the_real_mirror_has_one_viewpoint(kind, q, d, spread, pixel):
    """A test of the test's geometry: every reflected ray, drawn back, meets the origin."""
    camera, mirror = example(kind, q, d, spread)
    with mp.workdps(DIGITS):
        met = bounce(mirror, *off_axis(camera, pixel))
        if met:
            hit, direction = (mp.matrix(v) for v in met)
            along = mp.fdot(hit, direction)
            assert along > 0
            assert mp.norm(hit - along * direction) <= mp.mpf(10) ** -40 * (mp.norm(hit) + q + d)


@kinds
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


@kinds
@given(metres, metres, spreads, place, st.floats(0, 9))
def test_pixels(kind, q, d, spread, pixel, exponent):
    """A point where the light of a pixel comes from is seen by that pixel."""
    camera, mirror = example(kind, q, d, spread)
    assume(camera.valid(np.array(pixel)))
    with mp.workdps(DIGITS):
        _, direction = bounce(mirror, *off_axis(camera, pixel))
    point = 10**exponent * np.array(direction, dtype=float)
    seen_by, seen = camera.project(point)
    assert seen
    np.testing.assert_allclose(seen_by, pixel, rtol=0, atol=1e-9)  # the contract asks 1e-6


def test_the_hyperboloid_ends():
    """The last valid pixel sees almost along the mirror's asymptote; the next one sees nothing, as in truth.

    d = 1 m, q = 0.5 m: 2a = (sqrt(5) - 1) / 2 m, so that the edge is at ``sqrt((d / 2a)^2 - 1)``, the root
    of the golden ratio, 1.272 focal lengths.
    """
    camera = cameras.create(
        "catadioptric-hyperbolic", width=SIZE, height=SIZE, distance=1, semi_latus_rectum=0.5, focal=100
    )
    edge = 100 * np.sqrt((1 + np.sqrt(5)) / 2)
    for part, on_mirror in ((0.5, True), (1 - 1e-12, True), (1 + 1e-12, False), (1.3, False)):
        pixel = camera.center + part * edge * np.array([0.6, 0.8])
        with mp.workdps(DIGITS):
            assert (bounce(hyperboloid(1, 0.5), *off_axis(camera, pixel)) is not None) == on_mirror
        assert camera.valid(pixel) == on_mirror


@pytest.mark.parametrize("name", ["catadioptric-parabolic", "catadioptric-hyperbolic", "catadioptric-planar"])
def test_mirrors_show_what_mirrors_show(name):
    """A pixel right of the centre sees the right, one below sees what is below; the centre the camera."""
    camera = cameras.create(name, width=101, height=101)
    directions = camera.unproject(np.array([[80.5, 50.5], [50.5, 80.5], [50.5, 50.5]])).directions
    assert directions[0, 0] > 0
    assert directions[1, 1] > 0
    np.testing.assert_array_equal(directions[2], (0, 0, -1))
