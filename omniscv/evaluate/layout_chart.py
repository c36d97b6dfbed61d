"""The paper's table of CFL's results as a chart, with ours, below two panoramas and their layouts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from omniscv.evaluate.layout_drawing import curves_of
from omniscv.evaluate.layout_set import Shot
from omniscv.evaluate.layout_table import MAP_SCORES, METHODS, PAPER
from omniscv.geometry.pose import Array
from omniscv.storage.local import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_INK, _TRUE, _FOUND = "#1c2330", "#ffffff", "#d55e00"
# Okabe and Ito's colours, which the colour-blind tell apart.
_BARS = {
    "paper": ("#56b4e9", "CFL, in the paper"),
    "baseline": ("#d55e00", "baseline without learned weights"),
    "predictions": ("#009e73", "your predictions"),
    "perfect": ("#c9ced6", "the true layout itself"),
}


def draw(
    rows: Sequence[Mapping[str, Any]], shots: Sequence[Shot], layouts: Mapping[str, Array], path: Path
) -> Path:
    """Draw the chart and return its path.

    Args:
        rows: the raw values; see :func:`omniscv.evaluate.layout_table.figures`.
        shots: of which the first of each kind of room is shown.
        layouts: the baseline's corners by name.
        path: of the picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    groups = list(dict.fromkeys(shot.group for shot in shots))
    figure = Figure(figsize=(9, 6.6), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    (above,), (below,) = figure.subfigures(2, 1, squeeze=False, height_ratios=(1, 1.75))
    for axes, group in zip(above.subplots(1, len(groups), squeeze=False)[0], groups, strict=True):
        shot = next(each for each in shots if each.group == group)
        _panorama(axes, shot, layouts[shot.name])
    grid = below.subplots(2, len(groups), squeeze=False, sharey=True)
    for line, kind in zip(grid, ("edges", "corners"), strict=True):
        for axes, group in zip(line, groups, strict=True):
            _bars(axes, [row for row in rows if row["group"] == group], kind, group)
    handles, labels = grid[0][0].get_legend_handles_labels()
    below.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8, frameon=False)
    figure.suptitle(_finding(rows, groups), size=11, color=_INK)
    with whole_file(path) as part:
        figure.savefig(part)
    return path


def _finding(rows: Sequence[Mapping[str, Any]], groups: Sequence[str]) -> str:
    """One sentence: how the baseline compares with CFL in the paper."""
    means = {group: _means(rows, group, "baseline", "edges")[-1] for group in groups}
    ours = ", ".join(f"{value:.2f} ({group})" for group, value in means.items())
    theirs = ", ".join(f"{PAPER['edges', group][-1]:.2f}" for group in groups if ("edges", group) in PAPER)
    return f"Edges F1 of lines and colours alone: {ours}" + (
        f"; of CFL in the paper: {theirs}" if theirs else ""
    )


def _means(rows: Sequence[Mapping[str, Any]], group: str, method: str, kind: str) -> list[float]:
    mine = [row for row in rows if (row["group"], row["method"]) == (group, method)]
    columns = ([row[f"{kind}_{key}"] for row in mine] for key in MAP_SCORES)
    return [float(np.mean([value for value in column if value is not None] or [0.0])) for column in columns]


def _bars(axes: Axes, rows: Sequence[Mapping[str, Any]], kind: str, group: str) -> None:
    heights = {method: _means(rows, group, method, kind) for method in METHODS}
    heights = {"paper": list(PAPER.get((kind, group), ())), **heights}
    shown = [method for method in heights if any(heights[method])]
    width = 0.8 / len(shown)
    for i, method in enumerate(shown):
        color, label = _BARS[method]
        at = np.arange(len(MAP_SCORES)) + (i - (len(shown) - 1) / 2) * width
        bars = axes.bar(at, heights[method], width, color=color, label=label)
        axes.bar_label(bars, [f"{value:.2f}".lstrip("0") for value in heights[method]], size=6)
    axes.set_xticks(np.arange(len(MAP_SCORES)), list(MAP_SCORES.values()), size=8)
    axes.set_ylim(0, 1.12)
    axes.tick_params(labelsize=7)
    axes.set_title(f"{kind}, {group} rooms", size=8, color=_INK)
    axes.spines[["top", "right"]].set_visible(False)


def _panorama(axes: Axes, shot: Shot, corners: Array) -> None:
    height, width = shot.lit.shape[:2]
    axes.imshow(shot.lit, extent=(0, width, height, 0))
    for each, color, line in ((shot.corners, _TRUE, 2.6), (corners, _FOUND, 1.1)):
        for curve in curves_of(each, width):
            axes.plot(*curve.T, color=color, lw=line, solid_capstyle="round")
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    axes.set_title(f"{shot.name}: the true layout (white), the baseline's (orange)", size=8, color=_INK)
