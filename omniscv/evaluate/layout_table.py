"""The paper's table of CFL's results, and the same measures of other methods, as means over panoramas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from omniscv.evaluate.figures import Figure

MAP_SCORES = {"iou": "IoU", "accuracy": "Acc", "precision": "P", "recall": "R", "f1": "F1"}
"""Measures of a map, in the paper's order."""

LAYOUT_SCORES = {
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
    ("edges", "real"): (0.452, 0.894, 0.633, 0.588, 0.607),
    ("corners", "6-wall"): (0.370, 0.974, 0.547, 0.526, 0.534),
    ("corners", "4-wall"): (0.506, 0.985, 0.643, 0.698, 0.669),
    ("corners", "real"): (0.382, 0.967, 0.758, 0.425, 0.544),
}
"""CFL's results, in the order of ``MAP_SCORES``: on the paper's two synthetic rooms, on real panoramas."""

METHODS = "baseline", "predictions", "perfect"


def figures(rows: Sequence[Mapping[str, Any]]) -> list[Figure]:
    """Return the means of each method for each kind of room.

    Args:
        rows: of one panorama and method each: ``group``, ``method``, ``edges_iou`` to ``corners_f1``, and the
            keys of ``LAYOUT_SCORES``; None where a measure is not known.
    """
    found = []
    for group in dict.fromkeys(row["group"] for row in rows):
        for method in METHODS:
            mine = [row for row in rows if (row["group"], row["method"]) == (group, method)]
            name = f"{group} rooms, {method}: "
            for kind in ("edges", "corners"):
                paper = PAPER.get((kind, group), (None,) * len(MAP_SCORES))
                for (key, label), theirs in zip(MAP_SCORES.items(), paper, strict=True):
                    found.append(_mean(mine, f"{kind}_{key}", f"{name}{kind} {label}", "", theirs))
            if method != "perfect":  # its corners are exact
                found += [
                    _mean(mine, key, name + label, unit) for key, (label, unit) in LAYOUT_SCORES.items()
                ]
    return [each for each in found if each.n]


def _mean(
    rows: Sequence[Mapping[str, Any]], key: str, name: str, unit: str, paper: float | None = None
) -> Figure:
    values = [row[key] for row in rows if row[key] is not None]
    return Figure(name, float(np.mean(values)) if values else float("nan"), unit, paper, len(values))
