"""The chart of central cameras: what it measures is there, and what it draws is a picture."""

import json

import cv2
import pytest

from omniscv.chart import central, pareto


@pytest.fixture(scope="module")
def rows():
    return central.measure(width=48)


def test_every_way_is_measured(rows):
    assert {(r.model, r.filter, r.scale) for r in rows} == {
        (m, f, s) for m in central.models(48) for f in central.FILTERS for s in central.SCALES
    }
    assert [r.model for r in rows if r.default] == list(central.models(48))
    for row in rows:
        assert row.ms > 0
        assert 10 < row.psnr_db < 60
        assert 0 <= row.wrong_labels < 0.2
        assert 0 <= row.depth_median <= row.depth_q99


def test_finer_faces_are_more_accurate_where_nothing_is_averaged(rows):
    """Labels and depth of the finest faces are better than those of the coarsest, for every model."""
    for model in central.models(48):
        mine = [r for r in rows if r.model == model and r.filter == "bilinear"]
        assert mine[-1].wrong_labels < mine[0].wrong_labels
        assert mine[-1].depth_q99 < mine[0].depth_q99


def test_it_writes_json_and_a_picture(rows, tmp_path):
    data, picture = central.write(rows, tmp_path / "new")
    assert len(json.loads(data.read_text())) == len(rows)
    assert min(cv2.imread(str(picture)).shape[:2]) > 300


def test_the_front_holds_what_nothing_beats():
    points = [(1, 9), (2, 5), (2, 7), (3, 6), (4, 1), (5, 1)]
    assert pareto.front(points, lambda p: p[0], lambda p: p[1]) == [(1, 9), (2, 5), (4, 1)]
