"""The measures against cases by hand and known answers, and the whole evaluation through its command."""

import json

import numpy as np
import pytest
from support.rooms import L_SHAPE, PLAIN, room_of_plan

from omniscv import Pose, cameras
from omniscv.errors import ArgumentError
from omniscv.evaluate import layout_set
from omniscv.evaluate.layout import scores
from omniscv.evaluate.layout_predictions import Prediction
from omniscv.evaluate.layout_table import PAPER, figures
from omniscv.evaluate.registry import Settings, run
from omniscv.truth.metrics import map_scores

PANORAMA = cameras.create("equirectangular", 512, 256)


def shot_of(plan, yaw_deg=20.0):
    lit = np.zeros((256, 512, 3), np.uint8)
    return layout_set.known_shot(
        "shot", lit, room_of_plan(plan), PANORAMA, Pose.from_angles((0, 0, 1.5), yaw_deg)
    )


def test_map_scores_of_eight_by_eight_pixels_by_hand():
    """True: 8 pixels, of which 2 are faint (3 of 255 is above 0.01); another, 2 of 255, is not. Found: 6 of
    the true ones, and 3 others; what is 0.1 is not found."""
    truth, found = np.zeros((8, 8), np.uint8), np.zeros((8, 8))
    truth[2, :6], truth[3, :2], truth[7, 7] = 255, 3, 2
    found[2, :5], found[3, 0], found[3, 1] = 0.11, 1.0, 0.1
    found[5, :2], found[7, 7] = 0.5, 0.5
    measured = map_scores(found, truth)
    assert measured.precision == 6 / 9
    assert measured.recall == 6 / 8
    assert measured.accuracy == (64 - 3 - 2) / 64
    assert measured.iou == 6 / 11
    assert measured.f1 == pytest.approx(12 / 17)
    assert map_scores(truth > 2, truth) == (1, 1, 1, 1, 1)


@pytest.mark.parametrize("plan", [PLAIN, L_SHAPE], ids=["four", "six"])
def test_the_true_layout_has_the_best_scores(plan):
    """Its maps less than 1: CFL's thresholds differ, and the paper's recipe draws wider than ours."""
    shot = shot_of(plan)
    found = scores(Prediction(shot.corners), shot)
    assert found["iou_2d"] == pytest.approx(1)
    assert found["iou_3d"] == pytest.approx(1)
    assert [found[key] for key in ("corner_error", "pixel_error", "rmse_m")] == pytest.approx([0, 0, 0])
    assert found["delta_1"] == found["walls_right"] == 1
    assert found["edges_precision"] > 0.98
    assert 0.6 < found["edges_iou"] < 0.8
    drawn = tuple((each >= 3).astype(float) for each in shot.maps)
    assert all(scores(Prediction(maps=drawn), shot)[f"{kind}_iou"] == 1 for kind in ("edges", "corners"))


def test_maps_by_the_papers_recipe_are_where_the_exact_ones_are():
    shot = shot_of(L_SHAPE)
    for original, exact in zip(shot.maps, shot.exact, strict=True):
        assert (original[exact > 200] > 0.35 * 255).all()
        assert not original[exact == 0].max() > 0.2 * 255


def test_rolling_the_panorama_lowers_the_score_step_by_step():
    shot = shot_of(PLAIN)
    maps = [each / 255 for each in shot.exact]
    for kind in ("edges", "corners"):
        rolled = (tuple(np.roll(each, k, axis=1) for each in maps) for k in (0, 2, 4, 8, 12, 16))
        values = [scores(Prediction(maps=each), shot)[f"{kind}_iou"] for each in rolled]
        assert (np.diff(values) <= 0).all()  # truth counts from 0.01, found from 0.1: 2 px fit in between
        assert (np.diff(values[1:]) < 0).all()


def test_measures_that_a_form_does_not_have_are_left_out():
    shot = shot_of(PLAIN)
    measured = scores(Prediction(maps=tuple(each / 255 for each in shot.exact)), shot)
    rows = [{"group": "4-wall", "method": "predictions", **measured}]
    found = {each.name.partition(": ")[2]: each for each in figures(rows)}
    assert set(found) == {
        f"{kind} {key}" for kind in ("edges", "corners") for key in ("IoU", "Acc", "P", "R", "F1")
    }
    assert found["edges F1"].value == measured["edges_f1"]
    assert found["edges F1"].paper == PAPER["edges", "4-wall"][-1] == 0.642


def test_a_recording_is_evaluated_and_what_is_written_is_scored_as_predictions(tmp_path):
    """The recording has two places; its room is fitted to what it shows."""
    settings = Settings(tmp_path, quick=True, source="captures/four-wall.sqlite")
    images = {f"room-{i}-{j}" for i in range(2) for j in range(2)}
    report = run("layout", settings)
    assert {row["image"] for row in report.rows} == images
    assert {row["group"] for row in report.rows} == {"4-wall"}
    assert report.about["to predict"] == sorted(f"layout/img/{name}.png" for name in images)
    files = report.write("layout", tmp_path)
    assert all(path.exists() for path in files)
    assert json.loads((tmp_path / "layout.json").read_text())["figures"]


def test_a_source_without_a_room_and_a_folder_that_is_none_are_refused(tmp_path):
    with pytest.raises(ArgumentError, match="layout: scene://direction: expected a scene whose room"):
        run("layout", Settings(tmp_path, quick=True, source="scene://direction"))
    options = {"predictions": tmp_path / "none"}
    with pytest.raises(ArgumentError, match="predictions: expected a folder"):
        run("layout", Settings(tmp_path, quick=True, options=options))
