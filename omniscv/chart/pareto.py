"""Speed against accuracy, written and drawn: every way as a dot, the Pareto front, and the default."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK, FRONT, DEFAULT = "#1c2330", "#9aa3b2", "#d1495b"
COLORS = ("#00798c", "#edae49", "#66a182", "#6a4c93", "#3d5a80", "#bc4749", "#8d99ae", "#588157")


Row = TypeVar("Row")


class Chart(NamedTuple):
    """What is drawn: a line of panels for each group of rows, a colour for each kind, a label at each dot.

    ``group`` and ``kind`` are names of the rows' attributes; a field ``default`` marks the ringed row.
    """

    name: str
    title: str
    group: str
    kind: str
    label: Callable[[Any], object]
    panels: Sequence[Panel]


class Panel(NamedTuple):
    """What is drawn against what."""

    title: str
    x_label: str
    cost: Callable[[Any], float]
    error: Callable[[Any], float]


def front(rows: Sequence[Row], cost: Callable[[Row], float], error: Callable[[Row], float]) -> list[Row]:
    """Return the rows that no other is both cheaper and more accurate than, from cheap to accurate."""
    best: list[Row] = []
    for row in sorted(rows, key=lambda row: (cost(row), error(row))):
        if not best or error(row) < error(best[-1]):
            best.append(row)
    return best


def write(rows: Sequence[Any], out: Path, chart: Chart) -> list[Path]:
    """Write measurements, dataclasses, and draw them: ``chart-NAME.json`` and ``chart-NAME.png``."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    data, picture = out / f"chart-{chart.name}.json", out / f"chart-{chart.name}.png"
    data.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
    groups = list(dict.fromkeys(getattr(row, chart.group) for row in rows))
    figure = Figure(figsize=(4 * len(chart.panels), 3.3 * len(groups)), dpi=105, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(groups), len(chart.panels), squeeze=False)
    for group, line in zip(groups, grid, strict=True):
        for panel, axes in zip(chart.panels, line, strict=True):
            _draw(axes, chart, panel, [row for row in rows if getattr(row, chart.group) == group])
            axes.set_title(f"{group}: {panel.title}", size=8)
    grid[0][0].legend(fontsize=7)
    figure.suptitle(chart.title, size=10)
    figure.savefig(picture)
    return [data, picture]


def _draw(axes: Axes, chart: Chart, panel: Panel, rows: Sequence[Any]) -> None:
    _, _, cost, error = panel
    best = front(rows, cost, error)
    axes.plot([cost(r) for r in best], [error(r) for r in best], "-", color=FRONT, lw=5, alpha=0.5, zorder=1)
    for index, kind in enumerate(dict.fromkeys(getattr(row, chart.kind) for row in rows)):
        mine = [row for row in rows if getattr(row, chart.kind) == kind]
        x, y = [cost(row) for row in mine], [error(row) for row in mine]
        axes.plot(x, y, "o-", color=COLORS[index % len(COLORS)], lw=0.8, ms=5, label=kind)
        for row, at in zip(mine, zip(x, y, strict=True), strict=True):
            axes.annotate(str(chart.label(row)), at, (4, 3), textcoords="offset points", size=6, color=INK)
            if row.default:
                axes.plot(*at, "o", ms=13, mfc="none", mec=DEFAULT, mew=2, zorder=5)
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel(panel.x_label, size=7)
    axes.tick_params(labelsize=6, which="both")
    axes.grid(True, which="major", lw=0.4, alpha=0.5)
