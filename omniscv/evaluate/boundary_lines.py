"""Lines in space from the labels of an image: to a small part of a pixel.

Two neighbouring pixels of different labels lie on either side of the edge, so that it passes their midpoint
at most half a pixel away, along the row or column that joins them. A few hundred such bounds leave only lines
that differ by much less than a pixel; the one whose greatest distance is least is in their midst. Least
squares take the bounds for noise, and come only as near as the root of their number allows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from omniscv.cameras import Camera
from omniscv.evaluate.line_refinement import ObservedLine
from omniscv.geometry.pose import Array

_ASTRAY_PX = 0.75  # a midpoint farther off is not of this edge
_ROUNDS = 3
_STEP = 1e-6  # metres and radians, of the derivatives of a line
_MOST = 0.2  # metres and radians, in a round


class BoundaryLine(ObservedLine):
    """Midpoints of neighbouring pixels, of which one is on either side of a line.

    Args:
        camera: what sees it.
        pixels: (N, 2) px: :func:`omniscv.evaluate.label_boundaries.boundary`.
    """

    def __init__(self, camera: Camera, pixels: Array) -> None:
        super().__init__(camera, pixels)
        in_a_row = self.pixels[:, 0] == np.round(self.pixels[:, 0])
        self._along = np.where(in_a_row[:, None], self.gradients[:, 0], self.gradients[:, 1])

    def refined(self, line: Array, turns: Array) -> Array:
        """As of observed lines, then with the least of the greatest distances."""
        best = super().refined(line, turns)
        for _ in range(_ROUNDS):
            off = self._off(best)
            near = np.abs(off) <= _ASTRAY_PX
            tried = self._least_greatest(best, turns, near)
            if np.abs(self._off(tried)[near]).max(initial=0) >= np.abs(off[near]).max(initial=0):
                break
            best = tried
        return best

    def _off(self, line: Array) -> Array:
        """(N,) px, signed, from the midpoints to the line's image, along the pair of pixels."""
        return np.asarray(self.rows @ line / np.abs(self._along @ line))

    def _least_greatest(self, line: Array, turns: Array, near: NDArray[np.bool_]) -> Array:
        """The line that minimizes the greatest distance, to first order: a linear program."""
        moved = self.moves(line, turns)
        count = 2 + len(turns)
        steps = np.array([moved(step) - moved(-step) for step in _STEP * np.eye(count)]) / (2 * _STEP)
        scale = np.abs(self._along @ line)[near, None]
        change, off = self.rows[near] @ steps.T / scale, (self.rows[near] @ line)[:, None] / scale
        one = np.ones((len(off), 1))
        program = linprog(
            [0.0] * count + [1.0],
            np.block([[change, -one], [-change, -one]]),
            np.concatenate([-off, off]),
            bounds=[(-_MOST, _MOST)] * count + [(0, None)],
        )
        return line if program.x is None else moved(program.x[:count])
