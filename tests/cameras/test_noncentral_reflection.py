"""Conical and spherical mirror against rays that bounce off the real cone and the real ball."""

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from support.cases import cases
from support.noncentral_mirrors import bounce, ray_errors

from omniscv import cameras

SIZE = 200
FOCAL = 100.0
metres = st.floats(-2, 2).map(lambda e: 10**e)  # 1 cm to 100 m
place = st.tuples(st.floats(0, SIZE), st.floats(0, SIZE))


def check(camera, pixel, tolerance):
    """Direction and origin within ``tolerance``; False where the pixel has no ray."""
    rays = camera.unproject(np.array(pixel))
    if not rays.valid:
        return False
    assert max(ray_errors(camera, pixel)) <= tolerance
    hit = np.array(bounce(camera, pixel)[0], dtype=float)
    assert (hit - rays.origins) @ rays.directions > 0  # the light comes in from beyond the mirror
    return True


@cases(15)
@given(metres, metres, place)
def test_ball(radius, distance, pixel):
    camera = cameras.create(
        "noncentral-spherical-mirror",
        width=SIZE,
        height=SIZE,
        mirror_radius=radius,
        distance=distance,
        focal=FOCAL,
    )
    r = np.hypot(*(np.array(pixel) - SIZE / 2)) / FOCAL
    edge = radius / np.sqrt((radius + distance) ** 2 - radius**2)
    # A few roundings of 1e-16. Towards grazing incidence i the ray turns by dr / cos i, and cos i falls
    # as the root of what is left to the edge.
    away = 1 - r / edge
    assume(not 0 <= away < 1e-12)
    tolerance = 2e-15 / np.sqrt(max(away, 1e-12))
    served = check(camera, pixel, tolerance)
    assert served == (away > 0 and r <= 1)


@cases(15)
@given(st.floats(0.5, 89.5), metres, place)
def test_cone(half_angle_deg, distance, pixel):
    camera = cameras.create(
        "noncentral-conical-mirror",
        width=SIZE,
        height=SIZE,
        half_angle_deg=half_angle_deg,
        distance=distance,
        focal=FOCAL,
    )
    r = np.hypot(*(np.array(pixel) - SIZE / 2)) / FOCAL
    edge = np.tan(np.radians(half_angle_deg))
    assume(abs(r / edge - 1) > 1e-12)
    # A few roundings of 1e-16, no more at 45 degrees or at the edge than anywhere else.
    served = check(camera, pixel, 1e-15)
    assert served == (0 < r < edge and r <= 1)


def test_a_ball_shows_the_camera_in_its_middle():
    ball = cameras.create(
        "noncentral-spherical-mirror", width=101, height=101, mirror_radius=0.5, distance=0.3
    )
    np.testing.assert_array_equal(ball.unproject(np.array([50.5, 50.5])).directions, (0, 0, -1))


def test_the_cone_ends_at_its_rim():
    """The last ring that is served meets the mirror just inside its rim."""
    camera = cameras.create(
        "noncentral-conical-mirror",
        width=SIZE,
        height=SIZE,
        half_angle_deg=60,
        distance=0.3,
        focal=FOCAL,
        mirror_radius=0.2,
    )
    u = np.linspace(SIZE / 2, SIZE, 101)[1:]
    served = camera.valid(np.stack([u, np.full_like(u, SIZE / 2)], axis=-1))
    for x, ok in zip(u, served, strict=True):
        hit, _ = bounce(camera, (x, SIZE / 2))
        assert ok == (hit[0] <= 0.2)
    assert served.any()
    assert not served.all()
