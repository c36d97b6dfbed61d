"""Cube faces out of what a record holds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from omniscv.captures.view import View
from omniscv.geometry import Array
from omniscv.plan.cube import ROTATIONS, Face

_POSITION_DECIMALS = 6  # a micrometre
_SAME = 1e-6  # matrix entries

Place = tuple[float, ...]
Kind = tuple[int, int, float]


class RecordedFaces:
    """The world-aligned faces in a record, by place, and by size and field of view.

    Args:
        views: the recorded views; others than world-aligned ones of 90 degrees or more are passed over.
    """

    def __init__(self, views: Sequence[View]) -> None:
        self._at: dict[Place, dict[Kind, dict[int, View]]] = defaultdict(lambda: defaultdict(dict))
        for view in views:
            if view.fov_deg < 90:
                continue
            for face, R_w_c in enumerate(ROTATIONS):
                if np.abs(view.pose.R_w_c - R_w_c).max() < _SAME:
                    self._at[_place(view.pose.t_w_c)][_kind(view)][face] = view

    def views(self, center_w: Array, wanted: Face) -> tuple[View, ...]:
        """The views at a centre: the wanted ones if they are there, else the fullest, finest set.

        Of the six, those that the record lacks are the wanted ones: asking the source for them says what is
        missing. Up and down turned half round follow where the record has them.
        """
        ideal = wanted.views(center_w)
        kinds = self._at.get(_place(center_w), {})
        if not kinds:
            return ideal
        best = max(kinds, key=lambda kind: (kind == _kind(ideal[0]), len(kinds[kind]), kind[0]))
        held = kinds[best]
        six = tuple(held.get(face, ideal[face]) for face in range(6))
        return (*six, held[6], held[7]) if 6 in held and 7 in held else six


def _place(position: Array) -> Place:
    return tuple((np.round(position, _POSITION_DECIMALS) + 0.0).tolist())


def _kind(view: View) -> Kind:
    return view.width, view.height, round(view.fov_deg, 6)
