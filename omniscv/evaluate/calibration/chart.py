"""The paper's plot of calibrations: estimated over true r_vl, with error bars and the line of truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.storage.local import whole_file

COLORS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7")
"""Okabe and Ito's, which the colour-blind tell apart."""
_MARKERS = "osD^vX"
_TOLERANCE_PERCENT = 2.0


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the plot of what rendered images gave: a dot for the mean of a value's images, a bar for their
    standard deviation."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    mine = [row for row in rows if row["input"] == "rendered"]
    names = list(dict.fromkeys(row["model"] for row in mine))
    values = sorted({row["r_vl"] for row in mine})
    images = 1 + max(row["image"] for row in mine)
    figure = Figure(figsize=(10, 4.8), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axes, errors = figure.subplots(1, 2, width_ratios=(1, 1.15))
    ends = [values[0] - 0.1, values[-1] + 0.1]
    axes.plot(ends, ends, color="#1c2330", lw=1, label="truth")
    errors.axhspan(-_TOLERANCE_PERCENT, _TOLERANCE_PERCENT, color="#9aa3b2", alpha=0.2, lw=0)
    errors.axhline(0, color="#1c2330", lw=1)
    worst = []
    for i, name in enumerate(names):
        table = np.array(
            [[r["estimate"] for r in mine if r["model"] == name and r["r_vl"] == v] for v in values]
        )
        mean, spread, true = table.mean(axis=1), table.std(axis=1), np.array(values)
        style = {"color": COLORS[i], "marker": _MARKERS[i], "ms": 5, "capsize": 2, "elinewidth": 1}
        axes.errorbar(true, mean, spread, ls="", label=name, **style)
        shifted = true + 0.008 * (i - (len(names) - 1) / 2)
        errors.errorbar(shifted, 100 * (mean / true - 1), 100 * spread / true, ls="", **style)
        worst.append(float(np.abs(100 * (mean / true - 1)).max()))
    unit = "image circle's radius"
    axes.set(xlabel=f"true $r_{{vl}}$ / {unit}", ylabel=f"estimated $r_{{vl}}$ / {unit}", aspect="equal")
    errors.set(xlabel=f"true $r_{{vl}}$ / {unit}", ylabel="error of the mean, %")
    errors.set_title(f"grey: within {_TOLERANCE_PERCENT:g} %; bars: standard deviation", size=9)
    axes.legend(fontsize=8)
    for each in (axes, errors):
        each.grid(True, lw=0.4, alpha=0.5)
    within = float(np.max(worst))
    finding = (
        f"Lines in rendered rooms give r_vl within {within:.1f} % for {len(names)} camera models"
        if np.isfinite(within)
        else "Lines in rendered images do not give r_vl everywhere"
    )
    figure.suptitle(f"{finding}\n({images} image{'s' * (images > 1)} a value)", size=11)
    with whole_file(path) as part:
        figure.savefig(part)
