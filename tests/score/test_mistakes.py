"""Planted mistakes are named on predictions as noisy as a network's, and sound ones have none."""

import cv2
import numpy as np
import pytest

import omniscv
from omniscv import Pose, cameras, score

PANORAMA = cameras.create("equirectangular", width=128, height=64)
PINHOLE = cameras.create("pinhole", width=96, height=72, fov_deg=100)
FISHEYE = cameras.create("fisheye-equidistant", width=96, height=96, fov_deg=180)
STEREOGRAPHIC = cameras.create("fisheye-stereographic", width=96, height=96, fov_deg=180)
HALF_A_PIXEL = cameras.create("fisheye-equidistant", width=96, height=96, fov_deg=180, center=(48.5, 48.5))
WIDER = cameras.create("pinhole", width=96, height=72, fov_deg=123)


@pytest.fixture(scope="module")
def rooms():
    """Exact depth of a room, by each camera."""
    images = {}
    pose = Pose.from_angles((0.4, 0.3, 1.4), 25)
    with omniscv.open_source("scene://six-wall") as scene:
        for camera in (PANORAMA, PINHOLE, FISHEYE, STEREOGRAPHIC, HALF_A_PIXEL, WIDER):
            image = omniscv.render(camera, pose, scene, ("depth",))
            images[camera] = np.asarray(image.depth, np.float64)
    return images


def noisy(depth, share=0.05, seed=7):
    """Depth with a smooth error of a share, as networks have it."""
    rng = np.random.default_rng(seed)
    coarse = rng.normal(size=(depth.shape[0] // 8 + 2, depth.shape[1] // 8 + 2))
    smooth = cv2.resize(coarse, depth.shape[::-1], interpolation=cv2.INTER_CUBIC)
    return depth * np.exp(share * smooth / smooth.std())


def between_pixels(depth):
    """A panorama read half a pixel further to the right and down, as a wrong resizing does."""
    right = (depth + np.roll(depth, -1, axis=1)) / 2
    return (right + np.roll(right, -1, axis=0)) / 2


def axis(camera):
    return camera.unproject().directions[..., 2]


PLANTED = {
    "planar": (PINHOLE, lambda rooms: rooms[PINHOLE] * axis(PINHOLE)),
    "range": (PINHOLE, lambda rooms: rooms[PINHOLE] / axis(PINHOLE)),
    "disparity": (PANORAMA, lambda rooms: 1 / rooms[PANORAMA]),
    "unit 1000": (PANORAMA, lambda rooms: 1000 * rooms[PANORAMA]),
    "unit 0.01": (FISHEYE, lambda rooms: 0.01 * rooms[FISHEYE]),
    "mirrored": (PINHOLE, lambda rooms: np.fliplr(rooms[PINHOLE])),
    "flipped": (PANORAMA, lambda rooms: np.flipud(rooms[PANORAMA])),
    "rolled": (PANORAMA, lambda rooms: np.rot90(rooms[PANORAMA], 2)),
    "shifted by 1 columns": (PANORAMA, lambda rooms: np.roll(rooms[PANORAMA], 1, axis=1)),
    "shifted by -20 columns": (PANORAMA, lambda rooms: np.roll(rooms[PANORAMA], -20, axis=1)),
    "pixel": (PANORAMA, lambda rooms: between_pixels(rooms[PANORAMA])),
    "clipped": (PANORAMA, lambda rooms: np.minimum(rooms[PANORAMA], np.quantile(rooms[PANORAMA], 0.8))),
    "lens": (FISHEYE, lambda rooms: rooms[STEREOGRAPHIC]),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("word", PLANTED)
def test_a_planted_mistake_is_named(rooms, word, seed):
    camera, plant = PLANTED[word]
    (mistake,) = score.find_mistakes(noisy(plant(rooms), seed=seed), rooms[camera], camera)
    assert mistake.word == word
    assert mistake.line().startswith(f"reads as {word}")


@pytest.mark.parametrize(
    ("word", "camera", "planted", "detail"),
    [
        ("pixel", FISHEYE, HALF_A_PIXEL, "-0.5, -0.5 px"),
        ("lens", FISHEYE, STEREOGRAPHIC, "fisheye-stereographic of 180 degrees"),
        ("lens", PINHOLE, WIDER, None),
    ],
    ids=["half a pixel, exactly rendered", "another model", "another field of view"],
)
def test_cameras_that_are_wrong_are_named(rooms, word, camera, planted, detail):
    (mistake,) = score.find_mistakes(noisy(rooms[planted]), rooms[camera], camera)
    assert mistake.word == word
    if detail is not None:
        assert mistake.detail == detail


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("camera", [PANORAMA, PINHOLE, FISHEYE], ids=lambda camera: camera.name)
@pytest.mark.parametrize("factor", [1, 1.3], ids=["right scale", "wrong scale"])
def test_a_sound_prediction_has_no_mistake(rooms, camera, seed, factor):
    predicted = factor * noisy(rooms[camera], 0.03 + 0.03 * (seed % 5), seed)
    assert not score.find_mistakes(predicted, rooms[camera], camera)


@pytest.mark.parametrize("sigma", [0.5, 1.0])
@pytest.mark.parametrize("camera", [PANORAMA, FISHEYE], ids=lambda camera: camera.name)
def test_a_blurred_prediction_has_no_mistake(rooms, camera, sigma):
    for seed in range(5):
        blurred = cv2.GaussianBlur(noisy(rooms[camera], seed=seed), (0, 0), sigma)
        assert not score.find_mistakes(blurred, rooms[camera], camera)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (2, 1), (3, 5), (9, 8)])
def test_pictures_of_a_few_pixels_are_searched(width, height):
    camera = cameras.create("pinhole", width=width, height=height, fov_deg=60)
    truth = np.linspace(1, 3, width * height).reshape(height, width)
    assert not score.find_mistakes(1.1 * truth, truth, camera)
    assert score.find_mistakes(np.full((height, width), np.nan), truth, camera) == []
