"""The evaluation ``layout``: scores of predicted room layouts, beside the paper's scores of CFL.

Panoramas of a room of four walls and of an L of six, from 5 viewpoints in 2 orientations each, are written
with their truth into ``OUT/layout``. The option ``predictions`` is a folder of layouts that a network
predicted for them (``predictions.py``). ``perfect`` is the true layout, drawn as a prediction is. It scores
less than 1, because CFL applies different thresholds to truth and prediction.
"""

from pathlib import Path

from omniscv.arguments import within
from omniscv.errors import ArgumentError
from omniscv.evaluate.layout import panoramas, predictions, results
from omniscv.evaluate.layout.panoramas import Panorama
from omniscv.evaluate.layout.predictions import Prediction
from omniscv.evaluate.registry import Settings
from omniscv.evaluate.report import Report, Row
from omniscv.truth.metrics import LayoutScores, layout_scores, map_scores

OPTIONS = frozenset({"predictions"})


def evaluate(settings: Settings) -> Report:
    """Render the panoramas, and score the predictions and the truth itself.

    Raises:
        ArgumentError: a source without a known room, or missing or malformed predictions.
        OmniscvError: of the source; shapely is not installed.
    """
    out, folder = settings.out / "layout", settings.options.get("predictions")
    if folder is not None and not Path(folder).is_dir():
        raise ArgumentError(f"predictions: expected a folder, got {folder}")
    rendered = list[Panorama]()
    for panorama in panoramas.render(settings):
        panoramas.write(panorama, out)
        rendered.append(panorama)
        settings.progress(len(rendered), panoramas.count(settings))
    width = rendered[0].lit.shape[1]
    names = [panorama.name for panorama in rendered]
    predicted = {} if folder is None else predictions.read(Path(folder), names, width)
    rows = [row for panorama in rendered for row in _rows(panorama, predicted.get(panorama.name))]
    about = {
        "size": [width, width // 2],
        "source": settings.source or list(panoramas.SCENES),
        "truth": "edge and corner maps by the paper's recipe, corners exact; in the folder layout",
        "to predict": [f"layout/img/{name}.png" for name in names],
    }
    chart = results.draw(rows, rendered, predicted, settings.out / "layout.png")
    return Report(results.figures(rows), rows, about, [out, chart])


def _rows(panorama: Panorama, prediction: Prediction | None) -> list[Row]:
    methods = {"perfect": Prediction(panorama.corners)}
    if prediction is not None:
        methods["predictions"] = prediction
    rows = list[Row]()
    for method, layout in methods.items():
        with within(f"{method} of {panorama.name}"):
            measured = scores(layout, panorama)
        rows.append({"image": panorama.name, "group": panorama.group, "method": method, **measured})
    return rows


def scores(prediction: Prediction, panorama: Panorama) -> dict[str, float | None]:
    """Return the measures of a prediction by name; None for those that its form does not have.

    Corners without maps are drawn as maps.
    """
    width, corners, maps = panorama.lit.shape[1], prediction.corners, prediction.maps
    if maps is None and corners is not None:
        edge_map, corner_map = predictions.draw_maps(corners, width)
        maps = edge_map / 255.0, corner_map / 255.0
    measured = dict[str, float | None]()
    for i, name in enumerate(("edges", "corners")):
        of_map = maps and map_scores(maps[i], panorama.maps[i])
        measured |= {f"{name}_{key}": of_map and getattr(of_map, key) for key in results.MAP_SCORES}
    if corners is None:
        return {**measured, **dict.fromkeys(LayoutScores._fields), "walls_right": None}
    of_room = layout_scores(corners, panorama.corners, width, width // 2)
    return {**measured, **of_room._asdict(), "walls_right": float(len(corners) == len(panorama.corners))}
