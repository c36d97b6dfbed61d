"""Intervals of figures, judged by worst truths that are built, and by truths that are drawn."""

import itertools
from dataclasses import fields

import numpy as np
import pytest

from omniscv import score
from omniscv.cameras import create
from omniscv.errors import ArgumentError
from omniscv.score import ALIGNMENTS, DepthMeasures, align
from omniscv.score.intervals import Truths, interval
from omniscv.score.measures import measures

NAMES = tuple(field.name for field in fields(DepthMeasures))
ROUNDING = 1e-11  # relative, of sums of a thousand terms
COUNT = 600


def smooth(rng, count, step):
    return np.repeat(rng.normal(size=count // step + 1), step)[:count]


@pytest.fixture(scope="module")
def pixels():
    """Predictions that are 5 % off, as networks are, in twice the unit; truths, their errors, and weights."""
    rng = np.random.default_rng(3)
    t = np.exp(0.4 * smooth(rng, COUNT, 30) + 1) * rng.uniform(1, 1.02, COUNT)
    p = 2 * t * np.exp(0.05 * smooth(rng, COUNT, 8))
    return p, t, t * rng.uniform(0.001, 0.01, COUNT), rng.uniform(0.2, 1, COUNT)


def figures_of(p, t, w, how="none"):
    return np.array([getattr(measures(align(p, t, w, how), t, w), name) for name in NAMES])


def ends(within):
    low = np.array([getattr(within.low, name) for name in NAMES])
    return low, np.array([getattr(within.high, name) for name in NAMES])


WORST = {
    "abs_rel": lambda p, t: abs(p - t) / t,
    "sq_rel": lambda p, t: (p - t) ** 2 / t,
    "rmse": lambda p, t: abs(p - t),
    "rmse_log": lambda p, t: abs(np.log(p / t)),
    "mae": lambda p, t: abs(p - t),
    "delta105": lambda p, t: abs(np.log(p / t)),
    "inlier3": lambda p, t: abs(np.log(p / t)),
}


@pytest.mark.parametrize("name", WORST)
def test_worst_and_best_truths_reach_the_ends(pixels, name):
    p, t, e, w = pixels
    p = p / 2
    within = interval(p, Truths(t - e, t + e, w))
    best = np.clip(p, t - e, t + e)
    worst = np.where(WORST[name](p, t - e) > WORST[name](p, t + e), t - e, t + e)
    figures = [getattr(measures(p, chosen, w), name) for chosen in (best, worst)]
    assert getattr(within.low, name) == pytest.approx(min(figures), rel=ROUNDING)
    assert getattr(within.high, name) == pytest.approx(max(figures), rel=ROUNDING)
    assert getattr(within.low, name) < getattr(within.high, name)


def test_the_greatest_silog_is_that_of_the_worst_corner_but_for_a_pixels_share():
    rng = np.random.default_rng(8)
    p, t = rng.uniform(1, 3, (2, 12))
    e = t * rng.uniform(0.01, 0.1, 12)
    w = rng.uniform(0.5, 1, 12)
    within = interval(p, Truths(t - e, t + e, w))
    corners = []
    for signs in itertools.product((-1, 1), repeat=12):
        corners.append(measures(p, t + np.array(signs) * e, w).silog)
    width = 100 * np.log((t + e) / (t - e)).max()
    assert max(corners) - 1e-9 <= within.high.silog <= max(corners) + width * (w / w.sum()).max()


def test_the_least_silog_is_attained(pixels):
    p, t, e, w = pixels
    within = interval(p, Truths(t - e, t + e, w))
    least = min(
        measures(p, np.clip(p / scale, t - e, t + e), w).silog for scale in np.linspace(1.9, 2.1, 2001)
    )
    # The grid of scales, 1e-4 apart, is off by less than that squared.
    assert within.low.silog == pytest.approx(least, abs=1e-4)
    assert within.low.silog <= least + 1e-9


def drawn_corners(pixels, how, count):
    """Truths at the ends of their bounds, in patterns that follow errors and depths, as worst ones do.

    In some, pixels near the threshold of a share all cross it or none does, or the farthest ones, which
    squares are made of, go their own way.
    """
    p, t, e, w = pixels
    rng = np.random.default_rng(5)
    q = align(p, t, w, how)
    residual = np.sign(q - t)
    depth = (p - p.mean()) / p.std()
    for number in range(count):
        a, b, c = rng.choice([-4, -2, -1, 0, 1, 2, 4], 3)
        pattern = a * residual + b * depth / 2 + c / 2
        if number % 3 == 1:
            is_far = p > np.quantile(p, rng.uniform(0.4, 0.98))
            pattern = np.where(is_far, rng.choice([-1, 1]) * residual, pattern)
        if number % 3 == 2:
            away = np.abs(np.log(q / t)) - np.log(rng.choice([1.03, 1.05, 1.1, 1.25]))
            pattern = np.where(np.abs(away) < 0.02, rng.choice([-1, 1]) * residual, pattern)
        yield np.where(pattern > 0, t + e, t - e)


@pytest.mark.parametrize("how", ALIGNMENTS)
def test_no_drawn_truth_leaves_the_interval(pixels, how):
    p, t, e, w = pixels
    low, high = ends(interval(p, Truths(t - e, t + e, w), how))
    rng = np.random.default_rng(4)
    for chosen in drawn_corners(pixels, how, 500):
        figures = figures_of(p, chosen, w, how)
        assert (low - 1e-12 <= figures).all()
        assert (figures <= high + 1e-9).all()
    for _ in range(500):
        figures = figures_of(p, rng.uniform(t - e, t + e), w, how)
        assert (low - 1e-12 <= figures).all()
        assert (figures <= high + 1e-9).all()


@pytest.mark.parametrize("how", ALIGNMENTS[1:])
def test_with_an_alignment_it_is_at_most_twice_the_spread_of_drawn_corners(pixels, how):
    p, t, e, w = pixels
    low, high = ends(interval(p, Truths(t - e, t + e, w), how))
    drawn = np.array([figures_of(p, chosen, w, how) for chosen in drawn_corners(pixels, how, 1000)])
    spread = drawn.max(axis=0) - drawn.min(axis=0)
    assert (high - low <= 2 * spread + 1e-9).all()


def test_an_alignment_that_a_truth_lets_lose_pixels_has_no_interval():
    t = np.array([1.0, 2.0, 3.0])
    p = np.array([0.01, 2.0, 3.9])
    assert interval(p, Truths(0.2 * t, 1.8 * t, np.ones(3)), "scale-shift") is None


def test_scores_have_intervals_where_the_truth_has_bounds_and_compare_doubtful_pixels_on_demand():
    camera = create("equirectangular", width=32, height=16)
    truth = np.full((16, 32), 2.0)
    error = np.full((16, 32), 0.002)
    error[0] = 0.5
    error[1] = np.inf
    doubt = error > 0.02
    plain = score.depth(1.1 * truth, truth, camera, doubt=doubt, error=error)
    assert plain.in_doubt == 64
    assert plain.by_solid_angle_within.low.abs_rel == pytest.approx(2.2 / 2.002 - 1)
    assert plain.by_solid_angle_within.high.abs_rel == pytest.approx(2.2 / 1.998 - 1)
    bounded = score.depth(1.1 * truth, truth, camera, doubt=doubt, error=error, bounded=True)
    assert bounded.in_doubt == 32
    assert bounded.by_pixel_within.high.mae == pytest.approx((14 * 0.202 + 0.7) / 15)
    assert score.depth(1.1 * truth, truth, camera).by_pixel_within is None
    assert bounded.to_dict()["by_pixel_within"]["high"]["mae"] == bounded.by_pixel_within.high.mae
    with pytest.raises(ArgumentError, match="bounded: expected the truth's error"):
        score.depth(truth, truth, camera, bounded=True)


def test_pixel_sums_do_not_leave_intervals_of_exact_truth(pixels):
    """Without an error, both ends are the figure itself."""
    p, t, _, w = pixels
    within = interval(p, Truths(t, t, w))
    assert ends(within)[0] == pytest.approx(ends(within)[1], rel=1e-6)
    assert ends(within)[0] == pytest.approx(figures_of(p, t, w), rel=1e-6)
