"""Colours that are the mean of several rays of a pixel, against rays that the tests lay themselves."""

from dataclasses import replace

import numpy as np
import pytest

import omniscv
from mock_server import load_scene
from omniscv import light
from omniscv.compose.light_checks import BITS
from omniscv.errors import ArgumentError
from omniscv.sensor import Sensor
from omniscv.sources.base import SourceWrapper
from omniscv.testing import contracts

pytestmark = pytest.mark.rays

POSE = omniscv.Pose.from_angles((0.13, -0.21, 1.47), 20, -5, 3)
ROOM = load_scene("four-wall")
RING = omniscv.cameras.create("noncentral-panorama", width=64, height=32, radius=0.3)
PANORAMA = omniscv.cameras.create("equirectangular", width=64, height=32)
FISHEYE = omniscv.cameras.create("fisheye-equidistant", width=48, height=48, fov_deg=160)
CODE = 1 / 255


def quarter_points(across):
    """The offsets (du, dv), px, of rays from a pixel's middle."""
    middles = [(2 * index + 1) / (2 * across) - 0.5 for index in range(across)]
    return [(du, dv) for du in middles for dv in middles]


def shades_of(camera, across, scene=ROOM):
    """(k, H, W, 3) the exact colours of a pixel's rays, and (H, W) where all of them are in the image."""
    shades = []
    valid = camera.unproject().valid
    for offset in quarter_points(across):
        rays = camera.unproject(camera.pixels() + offset)
        valid &= rays.valid
        shades.append(scene.trace(POSE.to_world(rays.origins), rays.directions @ POSE.rotation.T).color)
    return np.array(shades), valid


@pytest.fixture(scope="module")
def room():
    with omniscv.open_source("scene://four-wall") as source:
        yield source


@pytest.mark.parametrize("camera", [RING, PANORAMA, FISHEYE], ids=["ring", "panorama", "fisheye"])
@pytest.mark.parametrize("rays", [1, 4, 9, 16])
def test_a_colour_is_the_mean_of_rays_through_equal_squares_of_its_pixel(camera, rays, room):
    image = omniscv.render(camera, POSE, room, ("lit",), color_rays=rays)
    shades, inside = shades_of(camera, round(rays**0.5))
    assert image.effort.captures == 0
    assert image.effort.traced == ("lit",)
    assert image.provenance["color_rays"] == rays
    assert inside.mean() > 0.6
    off = np.abs(image.lit * CODE - shades.mean(axis=0))[inside]
    assert off.max() <= 0.501 * CODE  # rounding, and float32


def test_pixels_at_the_end_of_the_field_of_view_have_colours_of_rays_within_it(room):
    """Squares beyond it take the ray of the pixel's middle."""
    image = omniscv.render(FISHEYE, POSE, room, ("lit",), color_rays=4)
    shades, inside = shades_of(FISHEYE, 2)
    (middle,), _ = shades_of(FISHEYE, 1)
    rim = image.valid & ~inside
    assert rim.sum() > 20
    for index, offset in enumerate(quarter_points(2)):
        beyond = ~FISHEYE.unproject(FISHEYE.pixels() + offset).valid
        shades[index][beyond] = middle[beyond]
    expected = shades.mean(axis=0)
    assert np.abs(image.lit * CODE - expected)[rim].max() <= 0.501 * CODE


def test_auto_captures_with_one_centre_and_takes_four_rays_with_several(room):
    ring = omniscv.render(RING, POSE, room, ("lit",))
    four = omniscv.render(RING, POSE, room, ("lit",), color_rays=4)
    captured = omniscv.render(RING, POSE, room, ("lit",), color_rays=0)
    panorama = omniscv.render(PANORAMA, POSE, room, ("lit",))
    assert ring.effort.captures == 0
    assert np.array_equal(ring.lit, four.lit)
    assert captured.effort.captures > 0
    assert panorama.effort.captures > 0
    assert "color_rays" not in panorama.provenance
    with omniscv.open_source("scene://four-wall?traces=0") as source:
        engine = omniscv.render(RING, POSE, source, ("lit",))
    assert np.array_equal(engine.lit, captured.lit)
    truth = shades_of(RING, 12)[0].mean(axis=0)
    errors = [np.abs(image.lit * CODE - truth).mean() for image in (ring, captured)]
    assert errors[0] < 0.7 * errors[1]  # 1.21 and 2.36 of 255 in the images


@pytest.mark.parametrize("options", [{"strategy": "cube", "face_size": 32}, {"viewpoints": 4}])
def test_images_that_share_centres_capture_colours(room, options):
    assert omniscv.render(RING, POSE, room, ("lit",), **options).effort.captures > 0
    with pytest.raises(ArgumentError, match="color_rays: expected auto, 0, or strategy 'auto' or 'exact'"):
        omniscv.render(RING, POSE, room, ("lit",), color_rays=4, **options)


def test_colours_by_rays_are_refused_where_no_rays_are(tmp_path, room):
    with omniscv.record(omniscv.open_source("scene://four-wall"), tmp_path / "room.sqlite") as source:
        assert omniscv.render(RING, POSE, source, ("lit",)).effort.captures > 0
        with pytest.raises(ArgumentError, match="color_rays: expected auto, 0, or a live source that shades"):
            omniscv.render(RING, POSE, source, ("lit",), color_rays=4)
        with pytest.raises(ArgumentError, match="expected one that shades rays, got"):
            omniscv.open_source("mock://four-wall").shade(np.zeros(3), np.array([[1.0, 0, 0]]))
    for value in (2, 4.0, True, "4"):
        with pytest.raises(ArgumentError, match="color_rays: expected 'auto' or one of 0, 1, 4, 9, 16"):
            omniscv.render(RING, POSE, room, ("lit",), color_rays=value)


def test_floating_point_colours_stay_so():
    with omniscv.open_source("scene://four-wall?lit=float32") as source:
        image = omniscv.render(RING, POSE, source, ("lit",))
    shades, inside = shades_of(RING, 2)
    assert image.lit.dtype == np.float32
    np.testing.assert_allclose(image.lit[inside], shades.mean(axis=0)[inside], atol=1e-6)


class OfTransfer(SourceWrapper):
    """A room whose colours are codes of another transfer."""

    def __init__(self, source, transfer):
        super().__init__(source)
        self.transfer = transfer

    @property
    def capabilities(self):
        return replace(self._source.capabilities, transfer=self.transfer)


@pytest.mark.parametrize("transfer", ["srgb", "film", "unknown"])
def test_means_are_of_light(transfer, room):
    """Codes are decoded before the mean and encoded after it; of an unknown transfer they are averaged."""
    image = omniscv.render(RING, POSE, OfTransfer(room, transfer), ("lit",))
    shades, inside = shades_of(RING, 2)
    mean = light.light_of_codes(255 * shades, transfer).mean(axis=0)
    below = light.light_of_codes(image.lit - 0.51, transfer)
    above = light.light_of_codes(image.lit + 0.51, transfer)
    assert ((below <= mean) & (mean <= above))[inside].all()
    if transfer == "srgb":
        plain = omniscv.render(RING, POSE, room, ("lit",))
        assert (plain.lit < image.lit)[inside].mean() > 0.02  # a mean of light is brighter than one of codes


class Brighter(SourceWrapper):
    """A room of half as much light again: what is brighter than a code of 255 is cut there."""

    def shade(self, origins_w, directions_w):
        return np.minimum(1.5 * self._source.shade(origins_w, directions_w), 1)


def test_pixels_of_which_a_ray_is_clipped_are_marked(room):
    """A mean of clipped codes looks like any other colour."""
    image = omniscv.render(RING, POSE, Brighter(room), ("lit",), checks="light")
    shades, inside = shades_of(RING, 2)
    clipped = (np.round(np.minimum(1.5 * 255 * shades, 255)) >= 255).any(axis=(0, 3))
    marked = (image["light"] & BITS["clipped"]) > 0
    assert 0.05 < clipped[inside].mean() < 0.95
    assert np.array_equal(marked[inside], clipped[inside])


def test_a_sensor_exposes_the_mean_light_of_a_pixel_s_rays():
    """Floating-point light is exposed as it is: a longer exposure saturates what is bright in the mean."""
    sensor = Sensor(electrons=1e12, full_well=1e12).exposed(2)  # shot noise is below a code
    with omniscv.open_source("scene://four-wall?lit=float32") as source:
        image = omniscv.render(RING, POSE, source, ("lit",))
    shades, inside = shades_of(RING, 2)
    expected = sensor.expose(shades.mean(axis=0).astype(np.float32))
    codes = sensor.expose(image.lit)
    assert np.abs(codes.astype(int) - expected)[inside].max() <= 1  # float32 beside a half
    assert 0.05 < (expected[inside] == 4095).mean() < 0.95


def test_centres_behind_a_wall_are_marked_beside_shaded_colours(room):
    behind = omniscv.Pose.from_angles((2.8, 0, 1.5))
    image = omniscv.render(RING, behind, room, ("lit",))
    outside = image.centers_w[..., 0] > 3
    assert 0.1 < outside.mean() < 0.5
    assert (image["occluded"] == outside).all()


def test_an_image_is_shaded_in_blocks(monkeypatch, room):
    whole = omniscv.render(RING, POSE, room, ("lit", "depth"))
    monkeypatch.setattr("omniscv.planning.plan._TRACED_RAYS", 1000)
    image = omniscv.render(RING, POSE, room, ("lit", "depth"))
    for name in whole.layers:
        assert np.array_equal(whole[name], image[name]), name


class OtherColors(SourceWrapper):
    """A source whose rays have colours that its pictures do not show."""

    def shade(self, origins_w, directions_w):
        return self._source.shade(origins_w, directions_w)[:, ::-1]


def test_the_contract_holds_and_finds_other_colours(room):
    contracts.check_source(room)
    with pytest.raises(AssertionError, match="rays have other colours than pictures show"):
        contracts.check_source(OtherColors(room))
