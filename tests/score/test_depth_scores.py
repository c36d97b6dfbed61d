"""Scores of depth, judged by sums in plain Python, closed forms of solid angles and planted mistakes."""

import math

import numpy as np
import pytest

import omniscv
from omniscv import Pose, score
from omniscv.cameras import create, model, names
from omniscv.errors import ArgumentError

PANORAMA = create("equirectangular", width=128, height=64)
PINHOLE = create("pinhole", width=64, height=48, fov_deg=100)
RNG = np.random.default_rng(7)


@pytest.fixture(scope="module")
def rooms():
    """Exact depth of a room by a panorama and a pinhole."""
    made = {}
    with omniscv.open_source("scene://four-wall") as scene:
        for camera in (PANORAMA, PINHOLE):
            image = omniscv.render(camera, Pose.from_angles((0.4, 0.3, 1.4), 25), scene, ("depth",))
            made[camera.name] = np.asarray(image.depth, np.float64)
    return made


def test_measures_are_their_definitions():
    p = RNG.uniform(1, 5, 40)
    t = RNG.uniform(1, 5, 40)
    w = RNG.uniform(0.1, 1, 40)
    found = score.measures.measures(p, t, w)
    total = math.fsum(w)
    logs = [math.log(a) - math.log(b) for a, b in zip(p, t, strict=True)]
    mean_log = math.fsum(x * weight for x, weight in zip(logs, w, strict=True)) / total
    expected = {"abs_rel": 0.0, "sq_rel": 0.0, "mae": 0.0, "delta1": 0.0, "delta2": 0.0, "inlier3": 0.0}
    square = variance = 0.0
    for a, b, weight, log in zip(p, t, w, logs, strict=True):
        share = weight / total
        expected["abs_rel"] += share * abs(a - b) / b
        expected["sq_rel"] += share * (a - b) ** 2 / b
        expected["mae"] += share * abs(a - b)
        expected["delta1"] += share * (max(a / b, b / a) < 1.25)
        expected["delta2"] += share * (max(a / b, b / a) < 1.5625)
        expected["inlier3"] += share * (max(a / b, b / a) < 1.03)
        square += share * (a - b) ** 2
        variance += share * (log - mean_log) ** 2
    for name, value in expected.items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-12)
    assert found.rmse == pytest.approx(math.sqrt(square), rel=1e-12)
    assert found.silog == pytest.approx(100 * math.sqrt(variance), rel=1e-10)


@pytest.mark.parametrize(
    ("camera", "expected", "relative"),
    [
        (PANORAMA, 4 * math.pi, 1e-6),
        (create("cube-map", width=96, height=64, layout="3x2"), 4 * math.pi, 1e-6),
        (create("pinhole", width=64, height=64, fov_deg=90), 4 * math.pi / 6, 1e-6),
        # Where a circle bounds the picture, its border pixels are measured in parts.
        (create("fisheye-equidistant", width=256, height=256, fov_deg=185), None, 1e-4),
    ],
    ids=["panorama", "cube", "face", "fisheye"],
)
def test_solid_angles_fill_the_field_of_view(camera, expected, relative):
    if expected is None:
        expected = 2 * math.pi * (1 - math.cos(math.radians(185 / 2)))
    assert score.solid_angles(camera).sum() == pytest.approx(expected, rel=relative)


def angle_around(camera):
    """The solid angle within a picture's border, by Archimedes: the integral of 1 - cos(angle) over azimuth
    around the middle ray."""
    along = np.linspace(0, 1, 100_001)[:-1]
    inside = 1e-9  # px
    u = np.concatenate([along, np.ones_like(along), 1 - along, np.zeros_like(along)]) * camera.width
    v = np.concatenate([np.zeros_like(along), along, np.ones_like(along), 1 - along]) * camera.height
    u = np.clip(u, inside, camera.width - inside)
    v = np.clip(v, inside, camera.height - inside)
    directions = camera.unproject(np.stack([u, v], axis=-1)).directions
    middle = camera.unproject([camera.center]).directions[0]
    across = np.linalg.qr(np.column_stack([middle, np.eye(3)[:, :2]]))[0][:, 1:]
    cosine = np.append(directions @ middle, directions[0] @ middle)
    azimuth = np.arctan2(directions @ across[:, 1], directions @ across[:, 0])
    azimuth = np.unwrap(np.append(azimuth, azimuth[0]))
    return abs(np.sum((1 - (cosine[1:] + cosine[:-1]) / 2) * np.diff(azimuth)))


@pytest.mark.parametrize("name", ["pinhole", "division", "field-of-view"])
def test_solid_angles_fill_what_the_rectangle_bounds(name):
    camera = model(name).example(1024)
    assert score.solid_angles(camera).sum() == pytest.approx(angle_around(camera), rel=1e-6)


def test_solid_angles_fill_a_cylinder():
    camera = create("cylindrical", width=2048, height=256, fov_v_deg=100)
    expected = 4 * math.pi * math.sin(math.radians(50))
    assert score.solid_angles(camera).sum() == pytest.approx(expected, rel=1e-6)


CIRCLES = {
    "fisheye-equidistant": 1e-4, "fisheye-stereographic": 1e-4, "fisheye-equisolid": 1e-4,
    "catadioptric-parabolic": 1e-4, "catadioptric-hyperbolic": 1e-4, "catadioptric-planar": 1e-4,
    "fisheye624": 1e-4, "ftheta": 1e-4,
    # At its rim, 90 degrees off the axis, a pixel's angle has no bound.
    "fisheye-orthographic": 1e-3,
}  # fmt: skip


@pytest.mark.parametrize("name", CIRCLES)
def test_solid_angles_fill_an_image_circle(name):
    camera = model(name).example(256)
    low, high = 0.0, 256.0
    for _ in range(60):
        radius = (low + high) / 2
        is_seen = camera.valid(camera.center + np.array([radius, 0]))
        low, high = (radius, high) if is_seen else (low, radius)
    rays = camera.unproject(camera.center + np.array([[0, 0], [low, 0]])).directions
    expected = 2 * math.pi * (1 - rays[0] @ rays[1])
    assert score.solid_angles(camera).sum() == pytest.approx(expected, rel=CIRCLES[name])


@pytest.mark.parametrize("name", sorted(name for name in names() if model(name).central))
def test_solid_angles_of_all_central_cameras_are_positive_where_pixels_are_valid(name):
    camera = model(name).example(48)
    areas = score.solid_angles(camera)
    assert (areas[camera.valid()] > 0).all()
    assert (areas[~camera.valid()] >= 0).all()
    assert areas.sum() <= 4 * math.pi * 1.001


@pytest.mark.parametrize("align", ["median", "scale", "scale-shift"])
def test_a_planted_scale_is_found(rooms, align):
    scores = score.depth(3.7 * rooms["equirectangular"], rooms["equirectangular"], PANORAMA, align=align)
    assert scores.by_pixel.abs_rel < 1e-9
    assert scores.by_solid_angle.abs_rel < 1e-9


def test_a_planted_scale_and_shift_of_disparity_are_found(rooms):
    disparity = 0.4 / rooms["equirectangular"] + 0.1
    scores = score.depth(
        disparity, rooms["equirectangular"], PANORAMA, form="disparity", align="disparity-scale-shift"
    )
    assert scores.by_solid_angle.abs_rel < 1e-9


def test_planar_depth_is_read_along_the_ray(rooms):
    planar = rooms["pinhole"] * PINHOLE.unproject().directions[..., 2]
    assert score.depth(planar, rooms["pinhole"], PINHOLE, form="planar").by_pixel.abs_rel < 1e-12
    with pytest.raises(ArgumentError, match="'equirectangular' has no plane"):
        score.depth(rooms["equirectangular"], rooms["equirectangular"], PANORAMA, form="planar")


def test_pixels_in_doubt_are_left_out_and_those_without_a_value_counted(rooms):
    truth = rooms["equirectangular"]
    predicted = truth.copy()
    predicted[:10] *= 9
    predicted[20, :5] = (0, -1, np.inf, np.nan, 1e-300)
    doubt = np.zeros(truth.shape, bool)
    doubt[:10] = True
    scores = score.depth(predicted, truth, PANORAMA, doubt=doubt)
    assert (scores.in_doubt, scores.missing) == (10 * 128, 4)
    assert scores.by_pixel.abs_rel == pytest.approx(1 / scores.compared, rel=1e-6)


def test_depth_that_a_shift_makes_negative_is_left_out_and_counted(rooms):
    """A few predictions of nearly 0 beside sound ones: the line through all leaves them below 0."""
    truth = rooms["equirectangular"]
    predicted = truth + 5
    predicted[30, :20] = 0.01
    scores = score.depth(predicted, truth, PANORAMA, align="scale-shift")
    assert scores.lost == 20
    assert scores.compared == truth.size - 20
    assert scores.by_pixel.rmse_log < 0.2


class Tensor:
    """What a torch tensor has that is needed here: an array only after it is detached and moved."""

    def __init__(self, values, steps=("detach", "cpu")):
        self.values = values
        self.steps = steps

    def detach(self):
        return Tensor(self.values, self.steps[1:] if self.steps[:1] == ("detach",) else self.steps)

    def cpu(self):
        return Tensor(self.values, self.steps[1:] if self.steps[:1] == ("cpu",) else self.steps)

    def __array__(self, dtype=None, copy=None):
        assert not self.steps
        return np.asarray(self.values, dtype)


def test_tensors_with_a_gradient_on_a_gpu_are_taken(rooms):
    truth = rooms["equirectangular"]
    scores = score.depth(Tensor(1.1 * truth), Tensor(truth), PANORAMA)
    assert scores.by_pixel.abs_rel == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"predicted": np.ones((3, 4))}, "predicted: expected .* as its camera has"),
        ({"predicted": np.zeros((64, 128))}, "expected a pixel with a value"),
        ({"form": "depth"}, "form: expected"),
        ({"align": "best"}, "align: expected"),
    ],
    ids=["size", "no value", "form", "alignment"],
)
def test_what_cannot_be_scored_is_refused(rooms, arguments, expected):
    given = {"predicted": rooms["equirectangular"], "truth": rooms["equirectangular"], "camera": PANORAMA}
    given |= arguments
    with pytest.raises(ArgumentError, match=expected):
        score.depth(given.pop("predicted"), given.pop("truth"), given.pop("camera"), **given)
