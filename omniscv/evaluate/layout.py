"""The evaluation ``layout``: the paper's 3D layout recovery, beside its table of CFL's results.

Panoramas of a room of four walls and of an L of six, from 5 places in 2 orientations each, are written with
their truth into ``OUT/layout``. A baseline without learned weights predicts their layouts; a folder of other
predictions (option ``predictions``, see :mod:`omniscv.evaluate.layout_predictions`) is scored beside it.
``perfect`` is the true layout, drawn as a prediction is: what one without an error scores, for CFL counts
truth and prediction from two thresholds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omniscv.arguments import within
from omniscv.errors import ArgumentError
from omniscv.evaluate import layout_chart, layout_predictions, layout_set
from omniscv.evaluate.figures import Report
from omniscv.evaluate.layout_baseline import predict
from omniscv.evaluate.layout_drawing import maps_of
from omniscv.evaluate.layout_predictions import Prediction
from omniscv.evaluate.layout_set import Shot
from omniscv.evaluate.layout_table import MAP_SCORES, figures
from omniscv.evaluate.registry import Settings
from omniscv.geometry.pose import Array
from omniscv.truth.metrics import LayoutScores, MapScores, layout_scores, map_scores

OPTIONS = frozenset({"predictions"})


def evaluate(settings: Settings) -> Report:
    """Render the panoramas, predict their layouts, score them.

    Raises:
        ArgumentError: a source without a known room, or predictions that are missing or are none.
        OmniscvError: of the source; shapely is not installed.
    """
    folder, given = settings.out / "layout", settings.options.get("predictions")
    if given is not None and not Path(given).is_dir():
        raise ArgumentError(f"predictions: expected a folder, got {given}")
    shots, total = list[Shot](), 2 * layout_set.count(settings)
    for shot in layout_set.shots(settings):
        layout_set.write(shot, folder)
        shots.append(shot)
        settings.progress(len(shots), total)
    width = shots[0].lit.shape[1]
    names = [shot.name for shot in shots]
    others = {} if given is None else layout_predictions.read(Path(given), names, width)
    rows, layouts = list[dict[str, Any]](), dict[str, Array]()
    for i, shot in enumerate(shots):
        layouts[shot.name] = predict(shot.lit)
        predicted = {"baseline": Prediction(layouts[shot.name]), "perfect": Prediction(shot.corners)}
        if shot.name in others:
            predicted["predictions"] = others[shot.name]
        for method, prediction in predicted.items():
            with within(f"{method} of {shot.name}"):
                measured = scores(prediction, shot)
            rows.append({"image": shot.name, "group": shot.group, "method": method, **measured})
        settings.progress(len(shots) + i + 1, total)
    about = {
        "size": [width, width // 2],
        "source": settings.source or list(layout_set.SCENES),
        "truth": "edge and corner maps by the paper's recipe, corners exact; in the folder layout",
        "to predict": [f"layout/img/{name}.png" for name in names],
    }
    written = [folder, layout_chart.draw(rows, shots, layouts, settings.out / "layout.png")]
    return Report(figures(rows), rows, about, written)


def scores(prediction: Prediction, shot: Shot) -> dict[str, float | None]:
    """Return the measures of a prediction by name; None of those that its form does not have.

    Of corners that come without maps, maps are drawn as those of the exact truth are.
    """
    width, corners, maps = shot.lit.shape[1], prediction.corners, prediction.maps
    if maps is None and corners is not None:
        edge_map, corner_map = maps_of(corners, width)
        maps = edge_map / 255.0, corner_map / 255.0
    measured = dict[str, float | None]()
    for i, kind in enumerate(("edges", "corners")):
        of_map: MapScores | None = maps and map_scores(maps[i], shot.maps[i])
        measured |= {f"{kind}_{key}": of_map and getattr(of_map, key) for key in MAP_SCORES}
    of_room: LayoutScores | None = None
    if corners is not None:
        of_room = layout_scores(corners, shot.corners, width, width // 2)
    measured |= {key: of_room and getattr(of_room, key) for key in LayoutScores._fields}
    right = None if corners is None else float(len(corners) == len(shot.corners))
    return {**measured, "walls_right": right}
