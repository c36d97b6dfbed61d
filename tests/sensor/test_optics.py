"""Lenses: shading by each projection's closed form, blur and glare of light, lateral colour."""

import numpy as np
import pytest

from omniscv.cameras import create
from omniscv.errors import ArgumentError
from omniscv.sensor import Sensor, optics


def at_degrees(camera, degrees, by="natural"):
    """Natural shading at pixels so many degrees off the axis."""
    shares = optics.shading(camera, by)
    theta = np.degrees(np.arccos(np.clip(camera.unproject().directions[..., 2], -1, 1)))
    near = np.nanargmin(np.abs(theta - degrees))
    return shares.ravel()[near], np.radians(theta.ravel()[near])


LAWS = {
    "fisheye-equidistant": lambda t: np.sin(t) / t,
    "fisheye-stereographic": lambda t: np.cos(t / 2) ** 4,
    "fisheye-equisolid": lambda t: 1.0,
    "fisheye-orthographic": lambda t: 1 / np.cos(t),
    "pinhole": lambda t: np.cos(t) ** 4,
}


@pytest.mark.parametrize("name", LAWS)
def test_natural_shading_is_the_projections_own(name):
    fov = {"pinhole": 100, "fisheye-orthographic": 170}.get(name, 230)
    camera = create(name, width=101, height=101, fov_deg=fov)
    for degrees in (4, 30, 45, 60, 80, 90, 110):
        if degrees < fov / 2:
            share, theta = at_degrees(camera, degrees)
            assert share == pytest.approx(LAWS[name](theta), rel=2e-4)


def test_a_table_is_interpolated():
    camera = create("fisheye-equidistant", width=101, height=101, fov_deg=180)
    share, theta = at_degrees(camera, 40, ((0.0, 1.0), (90.0, 0.1)))
    assert share == pytest.approx(1 - np.degrees(theta) / 100, abs=1e-3)


def test_a_panorama_has_no_natural_shading():
    with pytest.raises(ArgumentError, match=r"shading: expected a fisheye .* got equirectangular"):
        optics.shading(create("equirectangular", width=16, height=8), "natural")


def test_blur_keeps_light_and_has_its_width():
    valid = np.ones((65, 65), bool)
    point = np.zeros((65, 65, 3), np.float32)
    point[32, 32] = 1
    blurred = optics.blur(point, (2.0,), valid)[..., 0]
    x = np.arange(65) - 32
    assert blurred.sum() == pytest.approx(1, rel=1e-5)
    assert (blurred.sum(axis=0) * x**2).sum() == pytest.approx(4, rel=0.02)


def test_blur_of_an_even_field_is_the_field():
    camera = create("fisheye-equidistant", width=64, height=64, fov_deg=180)
    valid = camera.valid()
    even = np.repeat(np.float32(0.4) * valid[..., None], 3, axis=-1).astype(np.float32)
    for sigmas in ((1.5,), (0.0, 1.0, 3.0)):
        np.testing.assert_allclose(optics.blur(even, sigmas, valid), even, atol=1e-6)


def test_black_in_a_white_field_reads_the_glare():
    light = np.ones((100, 100, 3), np.float32)
    light[50, 50] = 0
    shown = optics.glare(light, 0.03, np.ones((100, 100), bool))
    assert shown[50, 50] == pytest.approx(0.03, rel=1e-3)
    assert shown[0, 0] == pytest.approx(1, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [("fisheye-equidistant", {"fov_deg": 170}), ("pinhole", {"focal": 40.0}),
     ("kannala-brandt", {"fx": 40.0, "fy": 41.0, "cx": 31.0, "cy": 33.0, "k": [0.01, 0, 0, 0]})],
)  # fmt: skip
def test_lateral_colour_is_seen_by_lenses_of_other_focal_lengths(name, parameters):
    """That their three images make the colours, a job's test tells."""
    camera, sensor = create(name, width=64, height=64, **parameters), Sensor(lateral=(0.004, -0.003))
    ray, ahead = np.array([0.1, 0.2, 1.0]), np.array([0.0, 0.0, 1.0])
    for share, other in zip(sensor.lateral, sensor.lateral_cameras(camera), strict=True):
        (seen, _), (moved, _), (centre, _) = camera.project(ray), other.project(ray), camera.project(ahead)
        np.testing.assert_allclose(moved - centre, (seen - centre) * (1 + share), rtol=1e-9)


def test_lateral_colour_needs_a_focal_length():
    with pytest.raises(ArgumentError, match=r"lateral: expected a lens with a focal length"):
        Sensor(lateral=(0.001, 0)).lateral_cameras(create("equirectangular", width=16, height=8))


def test_a_rolling_shutter_has_its_lens():
    turning = {"readout": 0.03, "angular_velocity_deg": [0, 30, 0]}
    camera = create("rolling-shutter", 64, 48, base={"model": "pinhole", "fov_deg": 80}, **turning)
    plain = create("pinhole", width=64, height=48, fov_deg=80)
    np.testing.assert_array_equal(optics.shading(camera, "natural"), optics.shading(plain, "natural"))
    longer = optics.magnified(camera, 0.01)
    assert longer.base.focal == pytest.approx(1.01 * plain.focal)
    assert (longer.readout, longer.to_dict()["angular_velocity_deg"]) == (0.03, [0, 30, 0])
