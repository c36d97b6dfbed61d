"""Conical and spherical mirrors against rays that bounce off the real cone and the real ball, in 50 digits.

Drawn most of all where the paper's formulas lose their digits. The ball: where the camera's ray grazes it,
where ``gamma`` is a difference; with the camera on it or far away, where ``Z_s (delta + epsilon) / delta``
takes small numbers from large ones. The cone: at 45 degrees, where tan(2 tau) is infinite; as a needle and as
a plate, where it is 0; at its tip, which has no normal; at its edge, where camera rays run along its side.
"""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.cases import cases
from support.mirrors import ray_errors, seen_by

from omniscv import cameras

SIZE = 200
FOCAL = 100.0
metres = st.floats(-2, 2).map(lambda e: 10**e)  # 1 cm to 100 m
hair = st.floats(-13, -1).map(lambda e: 10**e)
# Of the last radius.
part = st.one_of(st.floats(1e-13, 1.2), hair, hair.map(lambda x: 1 - x), hair.map(lambda x: 1 + x))
azimuth = st.floats(0, np.pi / 2)
half_angle = st.one_of(
    st.floats(0.5, 89.5),
    st.sampled_from([45.0, float(np.nextafter(45, 0)), float(np.nextafter(45, 90))]),
    hair.map(lambda x: 45 - x),
    hair.map(lambda x: 45 + x),
    st.floats(-9, 0).map(lambda e: 10**e),
    st.floats(-12, 0).map(lambda e: 90 - 10**e),
)


def ball(radius=0.5, distance=0.3, **options):
    return create("noncentral-spherical-mirror", mirror_radius=radius, distance=distance, **options)


def cone(half_angle_deg, distance=0.3, **options):
    return create("noncentral-conical-mirror", half_angle_deg=half_angle_deg, distance=distance, **options)


def create(name, center=(0, 0), **options):
    """A camera whose centre is (0, 0), so that a pixel can be as near to it as one likes."""
    return cameras.create(name, width=SIZE, height=SIZE, focal=FOCAL, center=center, **options)


def pixel_at(edge, part, azimuth):
    """A pixel at a part of the last radius, and its radius in focal lengths; not on a border to 1e-13."""
    pixel = part * min(edge, 1) * FOCAL * np.array([np.cos(azimuth), np.sin(azimuth)])
    r = np.hypot(*pixel) / FOCAL
    assume(min(abs(r / edge - 1), abs(r - 1)) > 5e-14)
    return pixel, r


def check(camera, pixel, tolerance):
    """Direction and origin within ``tolerance``; False where the pixel has no ray."""
    rays = camera.unproject(np.array(pixel))
    if not rays.valid:
        return False
    assert max(ray_errors(camera, pixel)) <= tolerance
    hit = np.array(seen_by(camera, pixel)[0], dtype=float)
    assert (hit - rays.origins) @ rays.directions > 0  # the light comes in from beyond the mirror
    return True


@cases(30)
@given(metres, st.one_of(metres, st.floats(-18, 3).map(lambda e: 10**e)), part, azimuth)
def test_ball(radius, distance, part, azimuth):
    """A few roundings of 1e-16; towards grazing the ray turns as the root of what is left to the edge."""
    edge = radius / np.sqrt(distance * (distance + 2 * radius))
    pixel, r = pixel_at(edge, part, azimuth)
    left = 1 - r / edge
    served = check(ball(radius, distance), pixel, 2e-15 / np.sqrt(max(left, 1e-13)))
    assert served == (left > 0 and r < 1)


@cases(30)
@given(half_angle, metres, part, azimuth)
def test_cone(half_angle_deg, distance, part, azimuth):
    """A few roundings of 1e-16, no more at 45 degrees or at the edge than anywhere else."""
    edge = np.tan(np.radians(half_angle_deg))
    pixel, r = pixel_at(edge, part, azimuth)
    served = check(cone(half_angle_deg, distance), pixel, 1e-15)
    assert served == (0 < r < edge and r < 1)


def test_a_ball_shows_the_camera_in_its_middle():
    np.testing.assert_array_equal(ball().unproject((0, 0)).directions, (0, 0, -1))


def test_the_tip_is_no_ray():
    camera = cone(60, center=None)
    rays = camera.unproject(camera.center)
    assert np.isnan(rays.directions).all()
    assert camera.valid(camera.center + np.array([(1, 0), (0, -1), (1, 1)])).all()


def test_the_cone_ends_at_its_rim():
    """The last ring that is served meets the mirror just inside its rim."""
    camera = cone(60, center=None, mirror_radius=0.2)
    u = np.linspace(SIZE / 2, SIZE, 101)[1:]
    served = camera.valid(np.stack([u, np.full_like(u, SIZE / 2)], axis=-1))
    for x, ok in zip(u, served, strict=True):
        hit, _ = seen_by(camera, (x, SIZE / 2))
        assert ok == (hit[0] <= 0.2)
    assert served.any()
    assert not served.all()


@pytest.mark.parametrize("half_angle_deg", [5, 30, 44])
def test_no_point_is_found_along_or_within_the_cone(half_angle_deg):
    slope = np.tan(np.radians(half_angle_deg))
    z = np.array([0.4, 1.0, 100.0])
    for part, visible in ((1 - 1e-9, False), (1 + 1e-9, True)):
        points = np.stack([(z - 0.3) * slope * part, 0 * z, z], axis=-1)
        assert (cone(half_angle_deg, center=None).project(points)[1] == visible).all()


def test_no_point_is_found_in_the_shadow_of_the_ball():
    """Behind the tangent cone of the grazing rays nothing is seen; just before it everything is."""
    z = np.array([1.0, 5.0, 1e6])
    rho = z * np.tan(np.arcsin(0.5 / 0.8))
    for part, visible in ((1 - 1e-9, False), (1 + 1e-9, True)):
        points = np.stack([rho * part, 0 * z, z], axis=-1)
        assert (ball(center=None).project(points)[1] == visible).all()
