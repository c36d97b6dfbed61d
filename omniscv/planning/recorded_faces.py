"""Cube faces out of what a recording holds."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

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

    def centers(self) -> tuple[Position, ...]:
        """Return the centres (x, y, z), metres, at which all faces are recorded, in their order."""
        full = len(cube_rotations())
        return tuple(
            at for at, kinds in self._at.items() if any(len(held) == full for held in kinds.values())
        )

    def faces(self, center_w: Array, wanted: Sequence[View], truth_scale: int = 1) -> tuple[View, ...]:
        """Return the six views at a centre: the wanted ones if they are there, else the fullest, finest set.

        Those that the recording lacks are the wanted ones: requesting them shows what is missing.

        Args:
            center_w: (3,) the centre.
            wanted: six views.
            truth_scale: how many times finer ground truth is requested. A set that is recorded both ways
                comes first; one that is recorded once is taken for ground truth.
        """
        kinds, best = self._at.get(_position(center_w), {}), _kind(wanted[0])
        if not kinds or best in kinds or _kind(wanted[0].scaled(truth_scale)) in kinds:
            return tuple(wanted)

        def finer(kind: Kind) -> Kind:
            return truth_scale * kind[0], truth_scale * kind[1], kind[2]

        coarse = [kind for kind in kinds if finer(kind) in kinds]
        coarse = coarse or [
            (width // truth_scale, height // truth_scale, fov) for width, height, fov in kinds
        ]
        best = max(coarse, key=lambda kind: (len(kinds.get(finer(kind), {})), kind[0]))
        found = kinds.get(finer(best), {})
        return tuple(
            replace(found[face], width=best[0], height=best[1]) if face in found else view
            for face, view in enumerate(wanted)
        )


def _position(position: Array) -> Position:
    return tuple((np.round(position, _POSITION_DECIMALS) + 0.0).tolist())


def _kind(view: View) -> Kind:
    return view.width, view.height, round(view.fov_deg, 6)
