"""The views of a recording, and the cube faces among them."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from omniscv.geometry import Array, cube_rotations
from omniscv.sources.base import View

_POSITION_DECIMALS = 6  # a micrometre
_SAME = 1e-6  # matrix entries

Position = tuple[float, ...]
Shape = tuple[int, int, float]


class RecordedViews:
    """A recording's views, and its world-aligned faces by position, and by size and field of view.

    Args:
        views: the recorded views.
    """

    def __init__(self, views: Sequence[View]) -> None:
        self.views = views
        self._held = frozenset(views)
        rotations = [R_w_c for _, R_w_c in cube_rotations()]
        self._at: dict[Position, dict[Shape, dict[int, View]]] = defaultdict(lambda: defaultdict(dict))
        for view in views:
            if view.fov_deg < 90:
                continue
            for face, R_w_c in enumerate(rotations):
                if np.abs(view.pose.R_w_c - R_w_c).max() < _SAME:
                    self._at[_position(view.pose.t_w_c)][_shape(view)][face] = view

    def hold(self, views: Iterable[View]) -> bool:
        """Return whether all of these views are recorded."""
        return self._held.issuperset(views)

    def centers(self) -> tuple[Position, ...]:
        """Return the centres (x, y, z), metres, at which all faces are recorded, in their order."""
        full = len(cube_rotations())
        return tuple(
            at for at, sets in self._at.items() if any(len(faces) == full for faces in sets.values())
        )

    def faces(self, center_w: Array, six: Sequence[View], truth_scale: int = 1) -> tuple[View, ...]:
        """Return the six views at a centre: the given ones if recorded, else the fullest, finest set.

        Missing faces of that set are the given ones: requesting them shows what is missing.

        Args:
            center_w: (3,) the centre.
            six: views.
            truth_scale: how many times finer ground truth is requested. A set that is recorded both ways
                comes first; one that is recorded once is taken for ground truth.
        """
        sets = self._at.get(_position(center_w), {})
        if not sets or _shape(six[0]) in sets or _shape(six[0].scaled(truth_scale)) in sets:
            return tuple(six)

        def finer(shape: Shape) -> Shape:
            return truth_scale * shape[0], truth_scale * shape[1], shape[2]

        coarse = [shape for shape in sets if finer(shape) in sets]
        coarse = coarse or [(width // truth_scale, height // truth_scale, fov) for width, height, fov in sets]
        best = max(coarse, key=lambda shape: (len(sets.get(finer(shape), {})), shape[0]))
        recorded = sets.get(finer(best), {})
        return tuple(
            replace(recorded[face], width=best[0], height=best[1]) if face in recorded else view
            for face, view in enumerate(six)
        )


def _position(position: Array) -> Position:
    return tuple((np.round(position, _POSITION_DECIMALS) + 0.0).tolist())


def _shape(view: View) -> Shape:
    return view.width, view.height, round(view.fov_deg, 6)
