"""Light of codes and back: IEC 61966-2-1, and the film curve at the points of its published form."""

import numpy as np
import pytest

from omniscv import light

LEVELS = np.arange(256, dtype=np.uint8)


@pytest.mark.parametrize("transfer", ["srgb", "linear", "film", "unknown"])
def test_every_code_comes_back(transfer):
    np.testing.assert_array_equal(light.encode(light.decode(LEVELS, transfer), transfer), LEVELS)


def test_light_becomes_the_nearest_code_and_is_clipped():
    some = np.random.default_rng(1).random(100_000, np.float32)
    np.testing.assert_array_equal(light.encode(some, "srgb"), np.rint(255 * light.light_to_srgb(some)))
    shown = light.encode(np.array([-1, np.nan, 0, 1, 7, np.inf], np.float32), "srgb")
    assert shown.tolist() == [0, 0, 0, 255, 255, 255]


def test_the_film_curve_has_its_published_values():
    x = [0.01, 0.02, 0.05, 0.1, 0.18, 0.3, 0.5, 1, 2, 4, 8]
    shown = [0.00166, 0.00535, 0.02484, 0.07591, 0.18, 0.33494, 0.51841, 0.72336, 0.86161, 0.94415, 0.98989]
    codes = [5.46, 16.41, 43.66, 77.86, 117.65, 156.53, 190.58, 221.04, 238.81, 248.64, 253.86]
    assert light.film_curve(x) == pytest.approx(shown, abs=6e-6)
    assert light.light_of_codes(codes, "film") == pytest.approx(x, rel=4e-3)


def test_exposures_are_merged_by_their_rounding_errors_and_to_the_limit():
    stops = (0, 2, 4, 6)
    codes = [light.encode(np.full((1, 1, 3), 0.05 * 2**stop, np.float32), "srgb") for stop in stops]
    assert [int(picture[0, 0, 0]) for picture in codes] == [63, 124, 231, 255]
    assert light.merge(codes, stops, "srgb")[0, 0] == pytest.approx([0.050025] * 3, abs=2e-6)
    clipped = [np.array([[[0] * 3, [255] * 3]], np.uint8)] * 2
    np.testing.assert_allclose(light.merge(clipped, (0, -2), "srgb"), [[[0] * 3, [4] * 3]])


@pytest.mark.parametrize(
    ("stops", "error"), [((-4, -3, -2, -1, 0, 1, 2, 3, 4), 0.007), ((4, 2, 0, -2, -4), 0.0095)]
)
def test_steps_of_exposure_bound_the_error(stops, error):
    """Of 1 EV and of 2 EV, between codes at the ends; one exposure alone errs by tens of per cent."""
    scene = np.geomspace(0.04, 12, 3000, dtype=np.float32).reshape(50, 20, 3).repeat(3, axis=1)
    scene[..., 1:] = scene[..., :1]
    pictures = [light.encode(scene * np.float32(2.0**stop), "srgb") for stop in stops]
    assert np.abs(light.merge(pictures, stops, "srgb") / scene - 1).max() < error
