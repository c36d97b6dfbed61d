"""Round-trip error of every camera model as a parameter or a pixel runs into its limit."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from omniscv import cameras
from omniscv.chart import drawing
from omniscv.chart.limits import approaches
from omniscv.progress import Steps, counted

QUICK = {"models": ("equirectangular", "division")}

STEPS = 10.0 ** -np.arange(0.25, 16, 0.25)
"""What is left to the limit, as a fraction."""
BOUND_PX = 1e-6  # the promised error of a round trip
_FLOOR_PX = 1e-15  # where an error of 0 is drawn
_COLUMNS = 6  # of panels
_HEIGHT_IN = 1.08  # inches of a line of panels
_BEYOND = {"refused": drawing.COLORS[0], "marked": drawing.COLORS[1], "in domain": drawing.COLORS[2]}


@dataclass(frozen=True)
class Row:
    """An approach to a limit of a model.

    Attributes:
        model: its name.
        limit: the name of the limit.
        beyond: what the model does one step past it: ``refused``, ``marked`` or ``in domain``.
        error_px: the largest error at each of ``STEPS``; NaN if no pixel is valid.
        known_px: error of the points themselves in float64 there, if more than 1e-6 px.
    """

    model: str
    limit: str
    beyond: str
    error_px: tuple[float, ...]
    known_px: tuple[float, ...] | None


def measure(progress: Steps | None = None, models: Sequence[str] | None = None) -> list[Row]:
    """Measure every approach to a limit of models.

    Args:
        progress: is told how many models are done; None: nobody.
        models: by name; None: all that are registered.
    """
    rows: list[Row] = []
    for name in counted(cameras.names() if models is None else models, progress):
        for approach in approaches(name):
            known = tuple(approach.known_px(STEPS).tolist()) if approach.known_px else None
            error_px = tuple(map(approach.error_px, STEPS))
            rows.append(Row(name, approach.limit, approach.beyond(), error_px, known))
    return rows


def write(rows: Sequence[Row], out: Path) -> list[Path]:
    """Write the measurements ``rows`` and draw them, all models on one screen: ``stability`` as JSON, SVG and
    PNG in the folder ``out``."""
    names = list(dict.fromkeys(row.model for row in rows))
    lines = len(names) // _COLUMNS + 1  # at least one panel is left for the legend
    figure, panels = drawing.figure(_COLUMNS, 0.9 + _HEIGHT_IN * lines, finding(rows), lines, shared=True)
    for axes, name in zip(panels, names, strict=False):
        _draw(axes, name, [row for row in rows if row.model == name])
    for axes in panels[len(names) :]:
        axes.axis("off")
    for beyond, color in _BEYOND.items():
        panels[-1].plot([], [], color=color, label=beyond)
    panels[-1].plot([], [], ":", color="0.3", label="float64's end")
    panels[-1].legend(title="beyond:", loc="center", fontsize=7.5, title_fontsize=7.5, frameon=False)
    figure.supxlabel("what is left to the limit, relative: from 1 (left) to 1e-16 (red line)", size=8.5)
    figure.supylabel("round trip, px; dashed: the promise, 1e-6", size=8.5)
    return drawing.write(rows, figure, out, "stability")


def finding(rows: Sequence[Row]) -> str:
    """Return the title, which states the result."""
    below = sum(not np.nanmax(row.error_px) > BOUND_PX for row in rows)
    models = len({row.model for row in rows})
    return f"{models} camera models run into {len(rows)} limits: {below} times the error stays below 1e-6 px"


def _draw(axes: Axes, name: str, rows: Sequence[Row]) -> None:
    """Draw the errors of a model along its approaches."""
    for row in rows:
        axes.loglog(STEPS, np.maximum(row.error_px, _FLOOR_PX), lw=0.9, color=_BEYOND[row.beyond])
        if row.known_px:
            axes.loglog(STEPS, row.known_px, ":", color="0.3", lw=0.9)
    axes.axhline(BOUND_PX, color="0.4", ls="--", lw=0.7)
    axes.axvspan(1e-18, 1e-16, color="#c1121f", alpha=0.15, lw=0)
    axes.set(xlim=(1.5, 1e-18), ylim=(_FLOOR_PX / 3, 1e3))
    axes.set_xticks([1, 1e-8, 1e-16], ["1", "1e-8", "1e-16"])
    axes.set_yticks([1e-12, 1e-6, 1], ["1e-12", "1e-6", "1"])
    axes.minorticks_off()
    axes.tick_params(labelsize=6.5, colors=drawing.INK, length=2)
    axes.grid(alpha=0.25)
    title = name.replace("noncentral", "nc").replace("catadioptric", "cata")
    axes.set_title(title, fontsize=7.5, loc="left", pad=2)
