"""Drawing speed against accuracy: every way as a dot, the Pareto front, and the default."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Row = TypeVar("Row")

INK, FRONT, DEFAULT = "#1c2330", "#9aa3b2", "#d1495b"
COLORS = ("#00798c", "#edae49", "#66a182", "#6a4c93", "#3d5a80", "#bc4749", "#8d99ae", "#588157")


def front(rows: Sequence[Row], cost: Callable[[Row], float], error: Callable[[Row], float]) -> list[Row]:
    """The rows that no other is both cheaper and more accurate than, from cheap to accurate."""
    best: list[Row] = []
    for row in sorted(rows, key=lambda row: (cost(row), error(row))):
        if not best or error(row) < error(best[-1]):
            best.append(row)
    return best


def draw(
    axes: Axes,
    rows: Sequence[Row],
    cost: Callable[[Row], float],
    error: Callable[[Row], float],
    kind: Callable[[Row], str],
    label: Callable[[Row], str],
    is_default: Callable[[Row], bool],
) -> None:
    """Draws rows into axes with both scales logarithmic: a colour for each kind, a ring for the default."""
    kinds = list(dict.fromkeys(kind(row) for row in rows))
    axes.set_xscale("log")
    axes.set_yscale("log")
    best = front(rows, cost, error)
    axes.plot([cost(r) for r in best], [error(r) for r in best], "-", color=FRONT, lw=5, alpha=0.5, zorder=1)
    for index, each in enumerate(kinds):
        mine = [row for row in rows if kind(row) == each]
        color = COLORS[index % len(COLORS)]
        axes.plot(
            [cost(r) for r in mine], [error(r) for r in mine], "o-", color=color, lw=0.8, ms=5, label=each
        )
        for row in mine:
            axes.annotate(
                label(row), (cost(row), error(row)), (4, 3), textcoords="offset points", size=6, color=INK
            )
    for row in rows:
        if is_default(row):
            axes.plot(cost(row), error(row), "o", ms=13, mfc="none", mec=DEFAULT, mew=2, zorder=5)
    axes.grid(True, which="major", lw=0.4, alpha=0.5)
