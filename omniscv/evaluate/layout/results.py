"""Means of layout scores beside the paper's table of CFL, as figures and as a chart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from omniscv.evaluate.layout.panoramas import Panorama
from omniscv.evaluate.layout.predictions import Prediction, visible_curves
from omniscv.evaluate.report import GREEN, INK, RED, SKY, Figure, Row, chart

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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

_METHODS = {"predictions": ("your predictions", GREEN), "perfect": ("the true layout itself", "#c9ced6")}
_BARS = {"paper": ("CFL, in the paper", SKY), **_METHODS}


def figures(rows: Sequence[Row]) -> list[Figure]:
    """Return the means of each method for each kind of room.

    Args:
        rows: one per panorama and method: ``group``, ``method``, ``edges_iou`` to ``corners_f1``, and the
            keys of the layout scores; None where a measure is not known.
    """
    means = []
    for group in dict.fromkeys(row["group"] for row in rows):
        for method in _METHODS:
            mine, name = _of(rows, group, method), f"{group} rooms, {method}: "
            for map_name in ("edges", "corners"):
                paper = PAPER.get((map_name, group), (None,) * len(MAP_SCORES))
                for (key, label), theirs in zip(MAP_SCORES.items(), paper, strict=True):
                    means.append(_mean(mine, f"{map_name}_{key}", f"{name}{map_name} {label}", "", theirs))
            if method != "perfect":  # its corners are exact
                means += [
                    _mean(mine, key, name + label, unit) for key, (label, unit) in _LAYOUT_SCORES.items()
                ]
    return [mean for mean in means if mean.n]


def _of(rows: Sequence[Row], group: str, method: str) -> list[Row]:
    return [row for row in rows if (row["group"], row["method"]) == (group, method)]


def _mean(rows: Sequence[Row], key: str, name: str, unit: str, paper: float | None = None) -> Figure:
    values = [row[key] for row in rows if row[key] is not None]
    return Figure(name, float(np.mean(values)) if values else float("nan"), unit, paper, len(values))


def draw(
    rows: Sequence[Row], panoramas: Sequence[Panorama], predicted: Mapping[str, Prediction], path: Path
) -> Path:
    """Draw the scores as bars, below the first panorama of each kind of room; return the path.

    Args:
        rows: as for :func:`figures`.
        panoramas: with their true layouts.
        predicted: by name of the panorama.
        path: of the picture.
    """
    first = {panorama.group: panorama for panorama in reversed(panoramas)}
    groups = list(dict.fromkeys(panorama.group for panorama in panoramas))
    with chart(path, 900, 660) as drawing:
        (above,), (below,) = drawing.subfigures(2, 1, squeeze=False, height_ratios=(1, 1.75))
        for axes, group in zip(above.subplots(1, len(groups), squeeze=False)[0], groups, strict=True):
            _draw_panorama(axes, first[group], predicted.get(first[group].name))
        grid = below.subplots(2, len(groups), squeeze=False, sharey=True)
        for line, map_name in zip(grid, ("edges", "corners"), strict=True):
            for axes, group in zip(line, groups, strict=True):
                _draw_bars(axes, rows, map_name, group)
        handles, labels = grid[0][0].get_legend_handles_labels()
        below.legend(
            handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8, frameon=False
        )
        drawing.suptitle("Maps of edges and corners, scored as the paper scores CFL's", size=11, color=INK)
    return path


def _draw_bars(axes: Axes, rows: Sequence[Row], map_name: str, group: str) -> None:
    heights = {"paper": list(PAPER.get((map_name, group), ()))}
    for method in _METHODS:
        if mine := _of(rows, group, method):
            means = [_mean(mine, f"{map_name}_{key}", key, "") for key in MAP_SCORES]
            heights[method] = [mean.value for mean in means if mean.n]
    heights = {method: values for method, values in heights.items() if values}
    width = 0.8 / len(heights)
    for i, (method, values) in enumerate(heights.items()):
        label, color = _BARS[method]
        at = np.arange(len(MAP_SCORES)) + (i - (len(heights) - 1) / 2) * width
        bars = axes.bar(at, values, width, color=color, label=label)
        axes.bar_label(bars, [f"{value:.2f}".lstrip("0") for value in values], size=6)
    axes.set_xticks(np.arange(len(MAP_SCORES)), list(MAP_SCORES.values()), size=8)
    axes.set_ylim(0, 1.12)
    axes.tick_params(labelsize=7)
    axes.set_title(f"{map_name}, {group} rooms", size=8, color=INK)
    axes.spines[["top", "right"]].set_visible(False)


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
