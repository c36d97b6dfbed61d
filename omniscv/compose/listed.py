"""Rays as a list, where no image gives them rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array


class Listed:
    """What :class:`omniscv.compose.maps.Maps` asks of a grid, for a list of rays.

    Args:
        directions: (N, 3), any length.
    """

    def __init__(self, directions: Array) -> None:
        self.directions = directions[None]
        self.valid = np.ones((1, len(directions)), np.bool_)
        self.steps = np.zeros((1, len(directions)), np.float32)
        self.all = np.arange(len(directions))

    @staticmethod
    def pixels(own: NDArray[np.int64], width: int) -> NDArray[np.int64]:
        """The list itself."""
        return own

    @staticmethod
    def none() -> Listed:
        """A list has no finer grid."""
        return Listed(np.zeros((0, 3)))
