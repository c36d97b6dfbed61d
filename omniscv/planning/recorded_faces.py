"""Cube faces out of what a recording holds."""

from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from omniscv.geometry import Array, cube_rotations
from omniscv.sources.base import View

_POSITION_DECIMALS = 6  # a micrometre
_SAME = 1e-6  # matrix entries

Position = tuple[float, ...]
Kind = tuple[int, int, float]


class RecordedViews:
    """What a recording holds, and its world-aligned faces by position, and by size and field of view.

    Args:
        views: the recorded views.
    """

    def __init__(self, views: Sequence[View]) -> None:
        self.views = views
        self._held = frozenset(views)
        rotations = [R_w_c for _, R_w_c in cube_rotations()]
        self._at: dict[Position, dict[Kind, dict[int, View]]] = defaultdict(lambda: defaultdict(dict))
        for view in views:
            if view.fov_deg < 90:
                continue
            for face, R_w_c in enumerate(rotations):
                if np.abs(view.pose.R_w_c - R_w_c).max() < _SAME:
                    self._at[_position(view.pose.t_w_c)][_kind(view)][face] = view

    def hold(self, views: Iterable[View]) -> bool:
        """Return whether all of some views are recorded."""
        return self._held.issuperset(views)

    def faces(self, center_w: Array, wanted: Sequence[View]) -> tuple[View, ...]:
        """Return the six views at a centre: the wanted ones if they are there, else the fullest, finest set.

        Those that the recording lacks are the wanted ones: requesting them shows what is missing.
        """
        kinds = self._at.get(_position(center_w), {})
        if not kinds:
            return tuple(wanted)
        best = max(kinds, key=lambda kind: (kind == _kind(wanted[0]), len(kinds[kind]), kind[0]))
        return tuple(kinds[best].get(face, view) for face, view in enumerate(wanted))


def _position(position: Array) -> Position:
    return tuple((np.round(position, _POSITION_DECIMALS) + 0.0).tolist())


def _kind(view: View) -> Kind:
    return view.width, view.height, round(view.fov_deg, 6)
