"""Scores of two pixels by hand, and the threshold of each share."""

import math

import pytest

from omniscv import score
from omniscv.cameras import create

TWO_PIXELS = create("pinhole", width=2, height=1, fov_deg=90)
EXACT = 1e-12  # rounding of a few sums


def test_figures_of_two_pixels():
    by_pixel = score.depth([[1.0, 4.0]], [[2.0, 4.0]], TWO_PIXELS).by_pixel
    assert by_pixel.abs_rel == pytest.approx(0.25, abs=EXACT)
    assert by_pixel.sq_rel == pytest.approx(0.25, abs=EXACT)
    assert by_pixel.mae == pytest.approx(0.5, abs=EXACT)
    assert by_pixel.rmse == pytest.approx(math.sqrt(0.5), abs=EXACT)
    assert by_pixel.rmse_log == pytest.approx(math.log(2) / math.sqrt(2), abs=EXACT)
    assert by_pixel.silog == pytest.approx(50 * math.log(2), abs=100 * EXACT)  # percent


@pytest.mark.parametrize(
    ("factor", "expected"),
    [
        (1.02, [1, 1, 1, 1, 1, 1]),
        (1.04, [0, 1, 1, 1, 1, 1]),
        (1.07, [0, 0, 1, 1, 1, 1]),
        (1.2, [0, 0, 0, 1, 1, 1]),
        (1.5, [0, 0, 0, 0, 1, 1]),
        (1 / 1.9, [0, 0, 0, 0, 0, 1]),
        (2.0, [0, 0, 0, 0, 0, 0]),
    ],
)
def test_shares_end_at_their_thresholds(factor, expected):
    shares = score.depth([[factor, factor]], [[1.0, 1.0]], TWO_PIXELS).by_pixel
    names = ("inlier3", "delta105", "delta110", "delta1", "delta2", "delta3")
    assert [getattr(shares, name) for name in names] == pytest.approx(expected, abs=EXACT)
