"""Drawing for the charts: dots with labels, plain numbers, Pareto fronts.

Pictures are 800 px wide on a page: SVG, and PNG with twice as many pixels. The colours of Okabe and Ito suit
colour-blind readers; shapes differ as well.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise, product
from pathlib import Path
from textwrap import wrap
from typing import Any, Literal, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from omniscv.compose.files import finite, write_json
from omniscv.storage.local import whole_file

INK = "#1c2330"
MUTED = "#6b7280"
SHADE = "#e9ebef"
RING = "#d55e00"
COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9")
MARKERS = ("o", "s", "^", "D", "v")

_WIDTH_IN = 8.0  # inches of a figure
_DPI = 100
_TITLE_CHARACTERS = 95  # of a line of the title
_STEEP = 0.3
"""Natural logarithm of the ratio of two dots' costs, under which the second's label would lie on the line."""


@dataclass(frozen=True)
class Dot:
    """A way to make an image.

    Attributes:
        series: dots of one series are joined.
        label: beside the dot; empty for none.
        x: the cost, > 0.
        y: the error, > 0.
        default: whether it is ringed.
        hollow: whether its inside is white.
    """

    series: str
    label: str
    x: float
    y: float
    default: bool = False
    hollow: bool = False


class Look(NamedTuple):
    """The style of a series."""

    color: str
    marker: str
    line: Literal["-", ""]


def front(ways: Sequence[Dot]) -> list[Dot]:
    """Return the Pareto front: the dots that no other beats in x and y, from cheap to accurate."""
    best: list[Dot] = []
    for dot in sorted(ways, key=lambda dot: (dot.x, dot.y)):
        if not best or dot.y < best[-1].y:
            best.append(dot)
    return best


def figure(
    columns: int, height_in: float, title: str, lines: int = 1, shared: bool = False
) -> tuple[Figure, list[Axes]]:
    """Return a figure 800 px wide and its panels, row by row.

    Args:
        columns: of panels.
        height_in: of the figure, inches of 100 px.
        title: is wrapped.
        lines: of panels.
        shared: whether all panels have the same scales.
    """
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle("\n".join(wrap(title, _TITLE_CHARACTERS)), x=0.01, ha="left", size=11, color=INK)
    return figure, list(figure.subplots(lines, columns, squeeze=False, sharex=shared, sharey=shared).flat)


def write(rows: Sequence[Any], figure: Figure, out: Path, name: str, dpi: int = 2 * _DPI) -> list[Path]:
    """Write measurements and their figure; return the paths. Equal figures have equal bytes.

    Args:
        rows: dataclasses, written as ``NAME.json``; NaN becomes null.
        figure: written as ``NAME.svg`` and ``NAME.png``.
        out: the folder, made if missing.
        name: of the files.
        dpi: px of the PNG for an inch.
    """
    data = write_json(out / f"{name}.json", finite(list(map(asdict, rows))))
    svg = out / f"{name}.svg"
    png = out / f"{name}.png"
    with whole_file(svg) as part, mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(part, metadata={"Date": None})
    with whole_file(png) as part:
        figure.savefig(part, dpi=dpi)
    return [data, svg, png]


def dots(axes: Axes, ways: Sequence[Dot], looks: dict[str, Look]) -> None:
    """Draw ways with their labels on logarithmic axes, and shade the region that they beat.

    Args:
        axes: of the panel.
        ways: dots, those of a series one after the other.
        looks: the style of each series, by name.
    """
    axes.set(xscale="log", yscale="log")
    for (series, look), hollow in product(looks.items(), (False, True)):
        _plot(
            axes, series, [dot for dot in ways if dot.series == series and dot.hollow == hollow], look, hollow
        )
    before: Dot | None = None
    for dot in ways:
        _label(axes, before, dot, looks[dot.series])
        before = dot
    axes.margins(0.18)
    for axis in (axes.xaxis, axes.yaxis):
        plain(axis)
    axes.grid(True, which="major", color="#d5d9e0", lw=0.5, zorder=0)
    axes.tick_params(labelsize=8, colors=INK)
    _shade(axes, ways)


def _plot(axes: Axes, series: str, group: Sequence[Dot], look: Look, hollow: bool) -> None:
    """Draw the dots of a series that are hollow, or those that are not."""
    axes.plot(
        [dot.x for dot in group],
        [dot.y for dot in group],
        ls=look.line or "none",
        marker=look.marker,
        color=look.color,
        mfc="white" if hollow else look.color,
        lw=1.2,
        ms=6,
        zorder=3,
        label=None if hollow or not group else series,
    )


def _label(axes: Axes, before: Dot | None, dot: Dot, look: Look) -> None:
    """Write a dot's label beside it, where the line to the dot before leaves room, and ring a default."""
    gap = 12 if dot.default else 8
    align = ("center", "baseline")
    offset = (0, gap)
    if not look.line:  # single dots apart from those of curves
        offset = (0, -gap)
        align = ("center", "top")
    elif before is not None and before.series == dot.series and abs(math.log(dot.x / before.x)) < _STEEP:
        offset = (-gap, 0)
        align = ("right", "center")
    red, green, blue = to_rgb(look.color)
    axes.annotate(
        dot.label, (dot.x, dot.y), offset, textcoords="offset points", ha=align[0], va=align[1],
        size=7.5, color=(0.72 * red, 0.72 * green, 0.72 * blue),
    )  # fmt: skip
    if dot.default:
        axes.plot(dot.x, dot.y, "o", ms=15, mfc="none", mec=RING, mew=2, zorder=4)


def plain(axis: Axis, ticks: Sequence[int] = (1, 2, 5)) -> None:
    """Label the ticks of a logarithmic axis with plain numbers: 1, 2, 5, 10, and so on."""
    axis.set_major_locator(LogLocator(subs=ticks))
    axis.set_major_formatter(FuncFormatter(lambda value, _: number(value)))
    axis.set_minor_formatter(NullFormatter())


def number(value: float) -> str:
    """Return a number without powers of ten, with commas from a thousand."""
    return f"{value:,.0f}" if value >= 1 else f"{value:.6f}".rstrip("0")


def _shade(axes: Axes, ways: Sequence[Dot]) -> None:
    """Shade the region in which a drawn way is both cheaper and more accurate."""
    best = front(ways)
    (x0, x1) = axes.get_xlim()
    (y0, y1) = axes.get_ylim()
    edge = [(best[0].x, y1)]
    for before, after in pairwise(best):
        edge += [(before.x, before.y), (after.x, before.y)]
    edge += [(best[-1].x, best[-1].y), (x1, best[-1].y), (x1, y1)]
    axes.fill(*zip(*edge, strict=True), color=SHADE, zorder=0, lw=0)
    axes.set(xlim=(x0, x1), ylim=(y0, y1))
