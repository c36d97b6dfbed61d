"""Round-trip error of every camera model as a parameter or a pixel runs into its limit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from omniscv import cameras
from omniscv.chart import drawing
from omniscv.chart.approach import SIZE
from omniscv.chart.limits import approaches

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TITLE = f"Camera models at the limits of their domains: largest round-trip error, images {SIZE} px wide"
QUICK = {"models": ("equirectangular", "division")}

STEPS = 10.0 ** -np.arange(0.25, 16, 0.25)
"""What is left to the limit, as a fraction."""
BOUND_PX = 1e-6
_FLOOR_PX = 1e-15  # where an error of 0 is drawn
_COLUMNS, _WIDTH_IN, _HEIGHT_IN, _DPI = 3, 12.0, 2.9, 110


@dataclass(frozen=True)
class Row:
    """An approach to a limit of a model.

    Attributes:
        model: its name.
        limit: the name of the limit.
        beyond: how the model answers one step past it: ``refused``, ``marked`` or ``in domain``.
        error_px: the largest error at each of ``STEPS``; NaN if no pixel is valid.
        known_px: what float64 can tell of the points themselves there, if more than 1e-6 px.
    """

    model: str
    limit: str
    beyond: str
    error_px: tuple[float, ...]
    known_px: tuple[float, ...] | None


def measure(
    progress: Callable[[int, int], None] | None = None, models: Sequence[str] | None = None
) -> list[Row]:
    """Measure every approach to a limit.

    Args:
        progress: called with (models done, models in total).
        models: their names; all that are registered if not given.
    """
    models = cameras.names() if models is None else models
    rows: list[Row] = []
    for done, name in enumerate(models, start=1):
        rows += [
            Row(
                name,
                way.limit,
                way.beyond(),
                tuple(way.error_px(left) for left in STEPS),
                tuple(way.known_px(STEPS).tolist()) if way.known_px else None,
            )
            for way in approaches(name)
        ]
        if progress:
            progress(done, len(models))
    return rows


def write(rows: Sequence[Row], out: Path) -> list[Path]:
    """Write the measurements and draw them: ``stability`` as JSON, SVG and PNG."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row.model for row in rows))
    lines = -(-len(names) // _COLUMNS)
    figure = Figure(figsize=(_WIDTH_IN, _HEIGHT_IN * lines), layout="constrained")
    panels = figure.subplots(lines, _COLUMNS, sharex=True, sharey=True, squeeze=False)
    for axes, name in zip(panels.flat, names, strict=False):
        _draw(axes, name, [row for row in rows if row.model == name])
    for axes in panels.flat[len(names) :]:
        axes.axis("off")
    for axes in panels[-1]:
        axes.set_xlabel("what is left to the limit, relative")
    for axes in panels[:, 0]:
        axes.set_ylabel("round trip, px")
    figure.suptitle(TITLE, fontsize=14)
    return drawing.write(rows, figure, out, "stability", _DPI)


def _draw(axes: Axes, name: str, rows: Sequence[Row]) -> None:
    for row in rows:
        (line,) = axes.loglog(STEPS, np.maximum(row.error_px, _FLOOR_PX), ".-", ms=3, lw=1)
        line.set_label(f"{row.limit}   (beyond: {row.beyond})")
        if row.known_px:
            axes.loglog(STEPS, row.known_px, ":", color="0.3", label="what float64 can tell apart")
    axes.axhline(BOUND_PX, color="0.4", ls="--", lw=0.8)
    axes.text(0.8, BOUND_PX / 2, "promise: 1e-6 px", fontsize=7, color="0.35", va="top")
    axes.axvspan(1e-18, 1e-16, color="#c1121f", alpha=0.12, lw=0)
    axes.axvline(1e-16, color="#c1121f", lw=1.5)
    axes.text(1e-17, 1e-9, "beyond", rotation=90, fontsize=8, color="#c1121f", ha="center", va="center")
    axes.set(xlim=(1.5, 1e-18), ylim=(_FLOOR_PX / 3, 1e3))
    axes.set_xticks(10.0 ** -np.arange(0, 17, 4))
    axes.grid(alpha=0.25)
    axes.set_title(name, fontsize=11, loc="left")
    axes.legend(fontsize=7.5, loc="upper left", framealpha=0.9)
