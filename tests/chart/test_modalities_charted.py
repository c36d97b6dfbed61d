"""Central cameras in all modalities: what is measured, and what must hold of it."""

import pytest

from omniscv.chart import filters


@pytest.fixture(scope="module")
def rows():
    return filters.measure(width=48, smallest_face=8)


def test_every_way_is_measured(rows):
    assert {(r.model, r.scale, r.filter, r.truth_scale) for r in rows} == {
        (model, *way) for model in filters.models(48) for way in filters.WAYS
    }
    assert [r.model for r in rows if r.default] == list(filters.models(48))
    for row in rows:
        assert 20 < row.psnr_db < 45  # means of pixels, at twice or four times the face size
        assert 0.01 < row.flip < 0.15
        assert 0.5 < row.seam < 1.6
        assert row.depth_median < 1e-6 < row.depth_q99


def test_filters_differ_in_colour_alone(rows):
    """Averaging is best where the image is coarser than the faces; labels are never blended."""
    for model in filters.models(48):
        for scale in filters.SCALES:
            mine = {r.way: r for r in rows if (r.model, r.scale, r.truth_scale) == (model, scale, 1)}
            assert mine["nearest"].psnr_db < mine["bilinear"].psnr_db < mine["area"].psnr_db
            assert mine["area"].flip <= mine["bilinear"].flip < mine["nearest"].flip
            assert len({(r.face_size, r.wrong_labels) for r in mine.values()}) == 1


def test_finer_faces_are_more_accurate_where_nothing_is_averaged(rows):
    """Labels and depth of the finest faces are better than those of the coarsest, for every model."""
    for model in filters.models(48):
        mine = [r for r in rows if r.model == model and r.way == "bilinear"]
        assert mine[-1].wrong_labels < mine[0].wrong_labels
        assert mine[-1].depth_q99 < mine[0].depth_q99


def test_finer_truth_is_more_accurate_and_colours_stay(rows):
    for model in filters.models(48):
        mine = {r.truth_scale: r for r in rows if (r.model, r.scale, r.filter) == (model, 1.0, "bilinear")}
        assert mine[4].wrong_labels < mine[2].wrong_labels < mine[1].wrong_labels
        assert mine[4].psnr_db == mine[2].psnr_db == mine[1].psnr_db
        assert mine[2].megapixels == pytest.approx((1 + 4 + 4) / 3 * mine[1].megapixels)
