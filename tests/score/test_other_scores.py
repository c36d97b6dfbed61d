"""Scores of edges, points, normals and labels, judged by loops in plain Python and by cases by hand."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from omniscv import cameras, score
from omniscv.errors import ArgumentError
from omniscv.score import edges

RNG = np.random.default_rng(11)
CAMERA = cameras.create("equirectangular", width=16, height=8)
EXACT = 1e-12  # rounding of some sums


def step_pictures():
    t = np.where(RNG.uniform(size=(9, 14)) < 0.3, 3.0, 2.0) * RNG.uniform(1, 1.08, (9, 14))
    return t * RNG.uniform(0.9, 1.1, t.shape), t, RNG.uniform(size=t.shape) < 0.9


@pytest.mark.parametrize("wraps", [False, True])
def test_boundary_f1_is_its_definition(wraps):
    p, t, valid = step_pictures()
    height, width = t.shape
    total = weights = 0.0
    for threshold in np.linspace(1.05, 1.25, 10):
        recall = precision = 0.0
        for dv, du in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            both = of_p = of_t = 0
            for v in range(height):
                for u in range(width):
                    w, x = v + dv, u + du
                    if wraps:
                        x %= width
                    if not (0 <= w < height and 0 <= x < width and valid[v, u] and valid[w, x]):
                        continue
                    in_p = p[w, x] / p[v, u] > threshold
                    in_t = t[w, x] / t[v, u] > threshold
                    both += in_p and in_t
                    of_p += in_p
                    of_t += in_t
            recall += both / max(of_t, 1) / 4
            precision += both / max(of_p, 1) / 4
        total += threshold * 2 * recall * precision / (recall + precision)
        weights += threshold
    assert edges.boundary_f1(p, t, valid, wraps) == pytest.approx(total / weights, abs=EXACT)
    assert edges.boundary_f1(3 * t, t, valid, wraps) == pytest.approx(1)


@pytest.mark.parametrize("radius", [1, 2])
def test_windowed_f1_is_its_definition(radius):
    p, t, valid = step_pictures()
    height, width = t.shape
    total = weights = 0.0
    for threshold in np.linspace(0.05, 0.25, 10):
        both = of_p = of_t = 0
        for v in range(radius, height - radius):
            for u in range(radius, width - radius):
                for dv in range(-radius, radius + 1):
                    for du in range(-radius, radius + 1):
                        if du * du + dv * dv > radius * radius or not (valid[v, u] and valid[v + dv, u + du]):
                            continue
                        in_p = p[v + dv, u + du] / p[v, u] > 1 + threshold
                        in_t = t[v + dv, u + du] / t[v, u] > 1 + threshold
                        both += in_p and in_t
                        of_p += in_p
                        of_t += in_t
        total += threshold * 2 * both / (of_p + of_t)
        weights += threshold
    assert edges.windowed_f1(p, t, valid, radius) == pytest.approx(total / weights, abs=EXACT)


def test_points_are_those_of_all_pairs():
    p = RNG.normal(size=(50, 3))
    t = RNG.normal(size=(40, 3))
    away = np.linalg.norm(p[:, None] - t[None], axis=-1)
    scores = score.points(p, t, (0.3, 0.6))
    assert scores.chamfer_m == pytest.approx((away.min(axis=1).mean() + away.min(axis=0).mean()) / 2)
    for index, distance in enumerate((0.3, 0.6)):
        precision = (away.min(axis=1) < distance).mean()
        recall = (away.min(axis=0) < distance).mean()
        assert scores.f_score[index] == pytest.approx(2 * precision * recall / (precision + recall))
    assert set(scores.figures()) == {"chamfer_m", "f_score_0.3m", "f_score_0.6m"}
    assert score.points(t, t).f_score == (1, 1, 1, 1)
    with pytest.raises(ArgumentError, match="expected clouds with points"):
        score.points(np.empty((0, 3)), t)


def test_a_cloud_lies_along_rays_and_is_thinned_by_a_grid():
    camera = cameras.create("equirectangular", width=64, height=32)
    where = np.ones((32, 64), bool)
    points = score.cloud(np.full((32, 64), 2.0), camera, where)
    assert points.shape == (2048, 3)
    assert np.linalg.norm(points, axis=1) == pytest.approx(2)
    assert len(score.cloud(np.full((32, 64), 2.0), camera, where, most=600)) == 512


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.fixture
def true_normals():
    return unit(RNG.normal(size=(8, 16, 3)))


def test_normals_are_scored_by_their_angles(true_normals):
    predicted = 4 * unit(true_normals + 0.3 * RNG.normal(size=true_normals.shape))
    predicted[0, 0] = 0
    doubt = np.zeros((8, 16), bool)
    doubt[3] = True
    scores = score.normals(predicted, true_normals, CAMERA, doubt)
    angles = []
    weights = []
    areas = score.solid_angles(CAMERA)
    for v in range(8):
        for u in range(16):
            if v != 3 and (v or u):
                cosine = math.fsum(unit(predicted[v, u]) * true_normals[v, u])
                angles.append(math.degrees(math.acos(cosine)))
                weights.append(areas[v, u])
    share = np.array(weights) / math.fsum(weights)
    assert (scores.compared, scores.in_doubt, scores.missing) == (111, 16, 1)
    assert scores.by_pixel.mean_deg == pytest.approx(np.mean(angles), rel=1e-9)
    assert scores.by_pixel.median_deg == pytest.approx(np.median(angles), rel=1e-9)  # of an odd number
    assert scores.by_solid_angle.mean_deg == pytest.approx(share @ angles, rel=1e-9)
    for name, limit in (("below5", 5), ("below11", 11.25), ("below22", 22.5), ("below30", 30)):
        assert getattr(scores.by_pixel, name) == pytest.approx(np.mean(np.array(angles) < limit))
    assert scores.by_pixel.rmse_deg == pytest.approx(np.sqrt(np.mean(np.square(angles))))


@pytest.mark.parametrize(
    ("change", "detail"),
    [
        (lambda n: n * np.array([1, -1, -1]), "x, -y, -z"),
        (lambda n: n[..., [2, 0, 1]], "y, z, x"),
        (lambda n: -n, "-x, -y, -z"),
        (lambda n: n @ Rotation.from_euler("xyz", (20, -35, 130), degrees=True).as_matrix(), "turned"),
    ],
    ids=["OpenGL", "permuted", "inward", "world"],
)
def test_normals_of_another_frame_are_named(true_normals, change, detail):
    noisy = unit(true_normals + 0.05 * RNG.normal(size=true_normals.shape))
    assert not score.find_frame(noisy, true_normals, CAMERA)
    turned = change(noisy)
    (mistake,) = score.find_frame(turned, true_normals, CAMERA)
    assert mistake.word == "frame"
    assert mistake.detail.startswith(detail)
    assert mistake.so < 8 < mistake.as_said


def test_labels_of_eight_pixels_by_hand():
    """Truth 1 1 1 2 | 2 2 0 1, predicted 1 1 2 2 | 2 1 1 1, of which the third pixel's truth is in doubt."""
    camera = cameras.create("pinhole", width=4, height=2, fov_deg=20)
    truth = np.array([[1, 1, 1, 2], [2, 2, 0, 1]])
    predicted = np.array([[1, 1, 2, 2], [2, 1, 1, 1]])
    doubt = np.array([[0, 0, 1, 0], [0, 0, 0, 0]], bool)
    scores = score.labels(predicted, truth, camera, doubt)
    assert (scores.compared, scores.in_doubt) == (6, 1)
    assert scores.by_pixel.iou == {1: 3 / 4, 2: 2 / 3}
    assert scores.by_pixel.miou == pytest.approx((3 / 4 + 2 / 3) / 2)
    assert scores.by_pixel.macc == pytest.approx((1 + 2 / 3) / 2)
    assert scores.by_pixel.accuracy == pytest.approx(5 / 6)
    # The doubtful pixel is predicted 2: right if it is 2, else it is in the union of 1 and of 2.
    assert scores.by_pixel.miou_high == pytest.approx((3 / 4 + 3 / 4) / 2)
    assert scores.by_pixel.miou_low == pytest.approx((3 / 5 + 2 / 4) / 2)


def test_intervals_of_labels_hold_every_choice_of_doubtful_ones():
    camera = cameras.create("pinhole", width=12, height=8, fov_deg=60)
    truth = np.repeat(np.repeat(RNG.integers(1, 4, (2, 3)), 4, axis=0), 4, axis=1)
    predicted = np.where(RNG.uniform(size=truth.shape) < 0.8, truth, RNG.integers(1, 4, truth.shape))
    doubt = np.zeros(truth.shape, bool)
    doubt[:, [3, 4, 7, 8]] = True
    scores = score.labels(predicted, truth, camera, doubt)
    present = np.unique(truth[~doubt])
    for _ in range(300):
        chosen = truth.copy()
        for v, u in zip(*np.nonzero(doubt), strict=True):
            near = truth[max(0, v - 1) : v + 2, max(0, u - 1) : u + 2]
            chosen[v, u] = RNG.choice(near.ravel())
        iou = []
        for label in present:
            both = ((chosen == label) & (predicted == label)).sum()
            iou.append(both / ((chosen == label) | (predicted == label)).sum())
        assert scores.by_pixel.miou_low - EXACT <= np.mean(iou) <= scores.by_pixel.miou_high + EXACT


def test_panoptic_quality_by_hand():
    """Class 1: instance 1 of 6 pixels is met by 5 of 10's 6; class 2: 2 of 4 pixels is missed, 20 is none."""
    truth = np.array([[1, 1, 1, 1, 1, 1], [2, 2, 2, 2, 0, 0]])
    predicted = np.array([[10, 10, 10, 10, 10, 20], [10, 20, 0, 0, 30, 30]])
    quality = score.panoptic(predicted, truth, {10: 1, 20: 2, 30: 2}, {1: 1, 2: 2})
    iou = 5 / 7
    assert quality.by_class == {1: pytest.approx(iou), 2: 0}
    assert quality.pq == pytest.approx(iou / 2)
    assert score.panoptic(truth, truth, {1: 1, 2: 2}, {1: 1, 2: 2}).pq == 1
    with pytest.raises(ArgumentError, match="expected a class of instance 20"):
        score.panoptic(predicted, truth, {10: 1}, {1: 1, 2: 2})


def test_labels_that_are_no_whole_numbers_are_refused():
    with pytest.raises(ArgumentError, match="expected whole numbers"):
        score.labels(np.full((8, 16), 0.5), np.ones((8, 16), int), CAMERA)
