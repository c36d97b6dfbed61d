"""``project`` of the non-central models: the inverse of ``unproject``, and no pixel where none sees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.camera_contract import last_radius
from support.cases import cases

from omniscv import cameras

SIZE = 100
metres = st.floats(-2, 2).map(lambda e: 10**e)  # 1 cm to 100 m
far = st.floats(0, 9).map(lambda e: 10**e)
unit = st.floats(0, 1)
coordinate = st.one_of(
    st.floats(-3, 3), st.floats(-1e9, 1e9), st.sampled_from([0.0, 0.3, 0.5, 0.8, -1e9, 1e9])
)
point = st.tuples(coordinate, coordinate, coordinate)

panorama = st.builds(
    lambda radius: cameras.create("noncentral-panorama", width=SIZE, height=SIZE, radius=radius), metres
)
cone = st.builds(
    lambda half_angle_deg, distance: cameras.create(
        "noncentral-conical-mirror",
        width=SIZE,
        height=SIZE,
        half_angle_deg=half_angle_deg,
        distance=distance,
    ),
    st.floats(1, 89),
    metres,
)
ball = st.builds(
    lambda mirror_radius, distance: cameras.create(
        "noncentral-spherical-mirror",
        width=SIZE,
        height=SIZE,
        mirror_radius=mirror_radius,
        distance=distance,
    ),
    metres,
    metres,
)
any_camera = st.one_of(panorama, cone, ball)


def scale(camera):
    """The model's largest length, metres."""
    return max(camera.parameters().get(key) or 0.0 for key in ("radius", "distance", "mirror_radius"))


def start(camera, pixel, rays):
    """Where on a ray, metres from its origin, the light comes in free: beyond the mirror's surface."""
    if camera.name != "noncentral-conical-mirror":
        return 3 * scale(camera)
    r, slope = np.linalg.norm(pixel - camera.center) / camera.focal, np.tan(np.radians(camera.half_angle_deg))
    z_hit = camera.distance * slope / (slope - r)
    return 1.001 * r * z_hit / np.hypot(*rays.directions[:2])


@cases(25)
@given(any_camera, st.floats(-np.pi, np.pi), unit, far)
def test_a_point_on_a_ray_is_seen_by_its_pixel(camera, azimuth, part, away):
    """Pixels anywhere between the centre and the last one; points from beside the mirror to 1e9 m."""
    reach = last_radius(camera)
    pixel = camera.center + part * reach * (1 - 1e-12) * np.array([np.cos(azimuth), np.sin(azimuth)])
    rays = camera.unproject(pixel)
    if not rays.valid:
        assert camera.name == "noncentral-conical-mirror"
        assert np.linalg.norm(pixel - camera.center) < 1e-12  # the tip
        return
    seen, valid = camera.project(rays.origins + start(camera, pixel, rays) * away * rays.directions)
    assert valid
    np.testing.assert_allclose(seen, pixel, rtol=0, atol=1e-9)  # the contract asks 1e-6


@cases(30)
@given(any_camera, st.lists(point, min_size=1, max_size=20))
def test_the_ray_of_the_answer_passes_through_the_point(camera, points):
    """Whatever the point: a valid pixel has a ray, and the point lies on its forward half."""
    points = np.array(points)
    pixels, valid = camera.project(points)
    assert np.isnan(pixels[~valid]).all()
    rays = camera.unproject(pixels[valid])
    assert rays.valid.all()
    offset = points[valid] - rays.origins
    along = (offset * rays.directions).sum(axis=1)
    missed = np.linalg.norm(offset - along[:, None] * rays.directions, axis=1)
    assert (along > 0).all()
    # 1e-12 rad: roundings of 1e-16 in a pixel, as seen through the most curved mirror drawn here (1 cm
    # seen from 100 m: 1e4 rad per radian), beside roundings of a metre's size.
    assert (missed <= 1e-12 * (np.linalg.norm(offset, axis=1) + scale(camera))).all()


def closest_rays(camera, points, samples=4001):
    """For each point, the least angle (rad) between it and a ray of its own azimuth, over all radii."""
    reach = last_radius(camera)
    r = np.sin(np.linspace(0, np.pi / 2, samples)[1:]) * reach * (1 - 1e-12)  # dense where rays spread
    least = np.empty(len(points))
    for i, (x, y, z) in enumerate(points):
        toward = np.array([x, y]) / np.hypot(x, y)
        rays = camera.unproject(camera.center + r[:, None] * toward)
        offset = np.array([x, y, z]) - rays.origins
        offset /= np.linalg.norm(offset, axis=1, keepdims=True)
        least[i] = np.nanmin(
            np.linalg.norm(np.cross(offset, rays.directions), axis=1)
            + 2 * ((offset * rays.directions).sum(axis=1) < 0)
        )
    return least


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("noncentral-conical-mirror", {"half_angle_deg": 35, "distance": 0.3}),
        ("noncentral-conical-mirror", {"half_angle_deg": 60, "distance": 0.3, "mirror_radius": 0.2}),
        ("noncentral-spherical-mirror", {"mirror_radius": 0.5, "distance": 0.3}),
    ],
)
def test_a_point_is_unseen_only_where_no_ray_comes_near(name, parameters):
    """Against all rays tried one after the other: nothing visible is lost, nothing hidden is found."""
    camera = cameras.create(name, width=SIZE, height=SIZE, **parameters)
    points = np.random.default_rng(3).normal(size=(120, 3)) * (2, 2, 3) + (0, 0, 1)
    if name == "noncentral-spherical-mirror":
        outside = np.linalg.norm(points - (0, 0, 0.8), axis=1) > 0.5
    else:
        outside = np.hypot(*points[:, :2].T) > (points[:, 2] - 0.3) * np.tan(
            np.radians(camera.half_angle_deg)
        )
    points = points[outside]
    _, valid = camera.project(points)
    least = closest_rays(camera, points)
    assert 0.2 < valid.mean() < 0.95
    assert least[valid].max() < 2e-3  # half a step of the radii tried
    assert least[~valid].min() > 1e-4  # none of these points lies on the border of the field of view


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("noncentral-conical-mirror", {"half_angle_deg": 60, "distance": 0.3}),
        ("noncentral-spherical-mirror", {"mirror_radius": 0.5, "distance": 0.3}),
    ],
)
def test_a_point_within_the_mirror_is_not_seen(name, parameters):
    """Between the axis and the mirror's surface the ray is a drawn line, not light."""
    camera = cameras.create(name, width=SIZE, height=SIZE, **parameters)
    rays = camera.unproject()
    x, y, z = np.moveaxis(rays.origins[rays.valid] + 0.03 * rays.directions[rays.valid], -1, 0)
    if name == "noncentral-spherical-mirror":
        within = np.sqrt(x**2 + y**2 + (z - 0.8) ** 2) < 0.5
    else:
        within = np.hypot(x, y) < (z - 0.3) * np.tan(np.radians(60))
    _, valid = camera.project(np.stack([x, y, z], axis=-1))
    assert within.mean() > 0.3
    assert not valid[within].any()


def test_the_panorama_at_radius_0_is_the_equirectangular_to_the_bit():
    still = cameras.create("noncentral-panorama", width=65, height=33, radius=0)
    plain = cameras.create("equirectangular", width=65, height=33)
    for ours, theirs in (
        (still.unproject().directions, plain.unproject().directions),
        (still.unproject().origins, plain.unproject().origins),
    ):
        np.testing.assert_array_equal(ours, theirs)
    points = np.random.default_rng(0).normal(size=(10_000, 3)) * np.logspace(-9, 9, 10_000)[:, None]
    points[:5] = (0, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, -1), (-0.0, 0, -1)
    for ours, theirs in zip(still.project(points), plain.project(points), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_panorama_rays_never_enter_the_cylinder_of_their_circle():
    camera = cameras.create("noncentral-panorama", width=SIZE, height=SIZE, radius=1.0)
    points = np.array([[0.5, 0, 0.5], [0, 3, 0], [0.9999, -7, 0], [0, 0, 0]])
    assert not camera.project(points)[1].any()
    pixels, valid = camera.project(np.array([[0, -2, 1], [0, 2, 1], [0, 0, 1], [0, 0, 1 + 1e-9]]))
    np.testing.assert_array_equal(valid, (True, True, False, True))
    np.testing.assert_array_equal(pixels[[0, 1, 3]], [[50, 0], [50, 100], [50, 50]])
