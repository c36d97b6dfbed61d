"""The evaluation ``layout``: scores of predicted room layouts, beside the paper's scores of CFL.

Panoramas of a room of four walls and of an L of six, from 5 viewpoints in 2 orientations each, are written
with their truth into ``OUT/layout``. The option ``predictions`` is a folder of layouts that a network
predicted for them (``predictions.py``). ``perfect`` is the true layout, drawn as a prediction is. It scores
less than 1, because CFL applies different thresholds to truth and prediction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from omniscv.arguments import within
from omniscv.errors import ArgumentError
from omniscv.evaluate import INK, RED, Figure, Report, Row, Settings, chart
from omniscv.evaluate.layout import panoramas, predictions
from omniscv.evaluate.layout.panoramas import Panorama
from omniscv.evaluate.layout.predictions import Prediction, visible_curves
from omniscv.truth.metrics import LayoutScores, layout_scores, map_scores

OPTIONS = frozenset({"predictions"})

MAP_SCORES = {"iou": "IoU", "accuracy": "Acc", "precision": "P", "recall": "R", "f1": "F1"}
"""Measures of a map, in the paper's order."""

_LAYOUT_SCORES = {
    "iou_2d": ("2D IoU", ""),
    "iou_3d": ("3D IoU", ""),
    "corner_error": ("corner error", "%"),
    "pixel_error": ("pixel error", "%"),
    "rmse_m": ("depth RMSE", "m"),
    "delta_1": ("depth delta1", ""),
    "walls_right": ("number of walls right", ""),
}

PAPER: Mapping[tuple[str, str], Sequence[float]] = {
    ("edges", "6-wall"): (0.424, 0.881, 0.694, 0.519, 0.592),
    ("edges", "4-wall"): (0.474, 0.901, 0.766, 0.554, 0.642),
    ("corners", "6-wall"): (0.370, 0.974, 0.547, 0.526, 0.534),
    ("corners", "4-wall"): (0.506, 0.985, 0.643, 0.698, 0.669),
}
"""CFL's scores on the paper's synthetic rooms, in the order of ``MAP_SCORES``."""

_METHODS = ("predictions", "perfect")


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
    chart = draw(rendered, predicted, settings.out / "layout.png")
    return Report(figures(rows), rows, about, [out, chart])


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
        measured |= {f"{name}_{key}": of_map and getattr(of_map, key) for key in MAP_SCORES}
    if corners is None:
        return {**measured, **dict.fromkeys(LayoutScores._fields), "walls_right": None}
    of_room = layout_scores(corners, panorama.corners, width, width // 2)
    return {**measured, **of_room._asdict(), "walls_right": float(len(corners) == len(panorama.corners))}


def figures(rows: Sequence[Row]) -> list[Figure]:
    """Return the means of each method for each kind of room.

    Args:
        rows: one per panorama and method: ``group``, ``method``, ``edges_iou`` to ``corners_f1``, and the
            keys of the layout scores; None where a measure is not known.
    """
    means = []
    for group in dict.fromkeys(row["group"] for row in rows):
        for method in _METHODS:
            mine = [row for row in rows if (row["group"], row["method"]) == (group, method)]
            name = f"{group} rooms, {method}: "
            for map_name in ("edges", "corners"):
                paper = PAPER.get((map_name, group), (None,) * len(MAP_SCORES))
                for (key, label), theirs in zip(MAP_SCORES.items(), paper, strict=True):
                    means.append(_mean(mine, f"{map_name}_{key}", f"{name}{map_name} {label}", "", theirs))
            if method != "perfect":  # its corners are exact
                means += [
                    _mean(mine, key, name + label, unit) for key, (label, unit) in _LAYOUT_SCORES.items()
                ]
    return [mean for mean in means if mean.n]


def _mean(rows: Sequence[Row], key: str, name: str, unit: str, paper: float | None = None) -> Figure:
    values = [row[key] for row in rows if row[key] is not None]
    return Figure(name, float(np.mean(values)) if values else float("nan"), unit, paper, len(values))


def draw(panoramas: Sequence[Panorama], predicted: Mapping[str, Prediction], path: Path) -> Path:
    """Draw the layouts in the first panorama of each kind of room; return the path.

    Args:
        panoramas: with their true layouts.
        predicted: by name of the panorama.
        path: of the picture.
    """
    first = {panorama.group: panorama for panorama in reversed(panoramas)}
    with chart(path, 900, 270) as drawing:
        panels = drawing.subplots(1, len(first), squeeze=False)[0]
        for axes, panorama in zip(panels, reversed(first.values()), strict=True):
            _draw_panorama(axes, panorama, predicted.get(panorama.name))
    return path


def _draw_panorama(axes: Axes, panorama: Panorama, prediction: Prediction | None) -> None:
    height, width = panorama.lit.shape[:2]
    axes.imshow(panorama.lit, extent=(0, width, height, 0))
    layouts, title = [(panorama.corners, "white", 2.6)], f"{panorama.name}: the true layout (white)"
    if prediction is not None and prediction.corners is not None:
        layouts.append((prediction.corners, RED, 1.1))
        title += ", the predicted one (orange)"
    for corners, color, line_width in layouts:
        for curve in visible_curves(corners, width):
            axes.plot(*curve.T, color=color, lw=line_width, solid_capstyle="round")
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    axes.set_title(title, size=8, color=INK)
