"""Cube faces out of what a record holds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from omniscv.captures.view import View
from omniscv.geometry import Array, cube_rotations
from omniscv.plan.cube import Face

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
        rotations = [R_w_c for _, R_w_c in cube_rotations()]
        for view in views:
            if view.fov_deg < 90:
                continue
            for face, R_w_c in enumerate(rotations):
                if np.abs(view.pose.R_w_c - R_w_c).max() < _SAME:
                    self._at[_place(view.pose.t_w_c)][_kind(view)][face] = view

    def views(self, center_w: Array, wanted: Face) -> tuple[View, ...]:
        """Six views at a centre: the wanted ones if they are there, else the fullest, finest set.

        Faces that the record lacks are the wanted ones: asking the source for them says what is missing.
        """
        ideal = wanted.views(center_w)
        kinds = self._at.get(_place(center_w), {})
        if not kinds:
            return ideal
        best = max(kinds, key=lambda kind: (kind == _kind(ideal[0]), len(kinds[kind]), kind[0]))
        return tuple(kinds[best].get(face, ideal[face]) for face in range(6))


def _place(position: Array) -> Place:
    return tuple((np.round(position, _POSITION_DECIMALS) + 0.0).tolist())


def _kind(view: View) -> Kind:
    return view.width, view.height, round(view.fov_deg, 6)
