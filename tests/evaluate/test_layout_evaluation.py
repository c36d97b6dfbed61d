"""The measures against cases by hand and known answers, and the whole evaluation through its command."""

import itertools
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import ndimage
from support.rooms import L_SHAPE, PLAIN, room_of_plan, room_of_scene

from omniscv import Pose, cameras, cli
from omniscv.errors import ArgumentError
from omniscv.evaluate import Settings, layout, run
from omniscv.evaluate.layout import PAPER, figures, scores
from omniscv.evaluate.layout.predictions import Prediction, draw_maps
from omniscv.truth import project_layout
from omniscv.truth.layout_labels import cor_id, exact_maps, original_maps
from omniscv.truth.metrics import map_scores

PANORAMA = cameras.create("equirectangular", 512, 256)
RECORDING = Path(__file__).parents[2] / "captures" / "four-wall.sqlite"
RECORDED = [((0, 0, 1.5), (0.8, -0.6, 1.2)), (17, 62, 48, 93)]  # places, yaws
CABIN = """
room:
  floor: [[-0.65, -0.65], [0.65, -0.65], [0.65, 0.65], [-0.65, 0.65]]
  height: 2.4
  walls: [{kind: plain, colors: [[0.8, 0.7, 0.6]]}]
  floor_texture: {kind: plain, colors: [[0.4, 0.3, 0.2]]}
  ceiling_texture: {kind: plain, colors: [[0.95, 0.94, 0.9]]}
objects:
  Crate:
    solids:
      - {box: [0.3, 0.3, 0.3], at: [0.45, 0.4, 0.15], texture: {kind: plain, colors: [[0.7, 0.5, 0.2]]}}
"""


def shot_of(plan, yaw_deg=20.0):
    lit = np.zeros((256, 512, 3), np.uint8)
    return layout.with_truth(
        "shot", lit, room_of_plan(plan), PANORAMA, Pose.from_angles((0, 0, 1.5), yaw_deg)
    )


def test_map_scores_of_eight_by_eight_pixels_by_hand():
    """True: 8 pixels, of which 2 are faint (3 of 255 is above 0.01); another, 2 of 255, is not. Found: 6 of
    the true ones, and 3 others; what is 0.1 is not found."""
    truth, prediction = np.zeros((8, 8), np.uint8), np.zeros((8, 8))
    truth[2, :6], truth[3, :2], truth[7, 7] = 255, 3, 2
    prediction[2, :5], prediction[3, 0], prediction[3, 1] = 0.11, 1.0, 0.1
    prediction[5, :2], prediction[7, 7] = 0.5, 0.5
    measured = map_scores(prediction, truth)
    assert measured.precision == 6 / 9
    assert measured.recall == 6 / 8
    assert measured.accuracy == (64 - 3 - 2) / 64
    assert measured.iou == 6 / 11
    assert measured.f1 == pytest.approx(12 / 17)
    assert map_scores(truth > 2, truth) == (1, 1, 1, 1, 1)


def test_the_true_layout_has_the_best_scores():
    """Its maps less than 1: CFL's thresholds differ, and the paper's recipe draws wider than ours."""
    shot = shot_of(L_SHAPE)
    measured = scores(Prediction(shot.corners), shot)
    assert measured["iou_2d"] == pytest.approx(1)
    assert measured["iou_3d"] == pytest.approx(1)
    assert [measured[key] for key in ("corner_error", "pixel_error", "rmse_m")] == pytest.approx([0, 0, 0])
    assert measured["delta_1"] == measured["walls_right"] == 1
    assert measured["edges_precision"] > 0.98
    assert 0.6 < measured["edges_iou"] < 0.8
    drawn = tuple((pixels >= 3).astype(float) for pixels in shot.maps)
    assert all(scores(Prediction(maps=drawn), shot)[f"{kind}_iou"] == 1 for kind in ("edges", "corners"))


def test_maps_by_the_papers_recipe_are_where_the_exact_ones_are():
    """Drawn as wide, they agree. Every corner has a blob of the recipe, within a pixel."""
    pose = Pose.from_angles((0.3, 0.2, 1.5), 25.0)
    record = project_layout(room_of_plan(PLAIN), PANORAMA, pose)
    edges, corners = original_maps(record, PANORAMA, pose)
    exact, _ = exact_maps(record, PANORAMA, edge_sigma=0.0065, corner_sigma=0.009)
    both, either = (exact >= 3) & (edges >= 3), (exact >= 3) | (edges >= 3)
    assert both.sum() / either.sum() > 0.85
    for corner in record["corners"]:
        if corner["visible_room"]:
            column, row = np.array(corner["pixel"], int)
            around = corners[row - 15 : row + 16, column - 15 : column + 16]
            assert around[12:19, 12:19].max() > 100
            middle = np.array([column, row]) - 14.5 + ndimage.center_of_mass(around)[::-1]
            assert np.abs(middle - corner["pixel"]).max() <= 1


def test_maps_alone_have_no_scores_of_corners():
    shot = shot_of(PLAIN)
    measured = scores(Prediction(maps=tuple(pixels / 255 for pixels in draw_maps(shot.corners, 512))), shot)
    rows = [{"group": "4-wall", "method": "predictions", **measured}]
    by_name = {figure.name.partition(": ")[2]: figure for figure in figures(rows)}
    keys = itertools.product(("edges", "corners"), ("IoU", "Acc", "P", "R", "F1"))
    assert set(by_name) == set(map(" ".join, keys))
    assert by_name["edges F1"].value == measured["edges_f1"]
    assert by_name["edges F1"].paper == PAPER["edges", "4-wall"][-1] == 0.642


def test_panoramas_of_a_recording_are_at_its_viewpoints_in_a_fitted_room():
    """The file knows no room: it is fitted to panoramas of the two places."""
    shots = list(layout.render(Settings(Path(), quick=True, source=str(RECORDING))))
    assert [shot.name for shot in shots] == ["room-0-0", "room-0-1", "room-1-0", "room-1-1"]
    room = room_of_scene("four-wall")
    expected = [cor_id(room, PANORAMA, Pose.from_angles(*pose)) for pose in itertools.product(*RECORDED)]
    apart = [min(np.abs(shot.corners - corners).max() for corners in expected) for shot in shots]
    assert max(apart) < 0.5  # of 512 px: the fit is good to millimetres


def test_an_own_scene_is_evaluated_with_predictions_by_the_command(tmp_path, monkeypatch):
    """A cabin with free space for one viewpoint; its own truth is the prediction."""
    monkeypatch.setattr(layout, "_QUICK_WIDTH", 256)
    scene, out, given = tmp_path / "cabin.yaml", tmp_path / "out", tmp_path / "given"
    scene.write_text(CABIN)
    given.mkdir()
    for shot in layout.render(Settings(out, quick=True, source=f"scene://{scene}")):
        (given / f"{shot.name}.txt").write_text("".join(f"{x} {y}\n" for x, y in shot.corners.tolist()))
    arguments = ["--quick", "--source", f"scene://{scene}", "--predictions", str(given), "--out", str(out)]
    assert cli.run(["evaluate", "layout", *arguments]) == 0
    written = json.loads((out / "layout.json").read_text())
    values = {figure["name"]: figure["value"] for figure in written["figures"]}
    assert values["4-wall rooms, predictions: 3D IoU"] == pytest.approx(1)
    assert values["4-wall rooms, predictions: edges F1"] == values["4-wall rooms, perfect: edges F1"]
    assert {row["method"] for row in written["raw"]} == {"predictions", "perfect"}
    images = [out / name for name in written["about"]["to predict"]]
    assert images
    for path in images:
        assert cv2.imread(str(path)).shape == (128, 256, 3)
        assert (out / "layout" / "label_cor" / f"{path.stem}.txt").exists()
    assert cv2.imread(str(out / "layout.png")) is not None


def test_sources_without_a_room_and_missing_folders_are_refused(tmp_path):
    with pytest.raises(
        ArgumentError, match="scene://direction: expected a recording, or a scene with a known"
    ):
        run("layout", Settings(tmp_path, quick=True, source="scene://direction"))
    options = {"predictions": tmp_path / "none"}
    with pytest.raises(ArgumentError, match="predictions: expected a folder"):
        run("layout", Settings(tmp_path, quick=True, options=options))
