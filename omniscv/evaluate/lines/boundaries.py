"""Where the labels of an image change: points on the outlines of what it shows, pair by pair of labels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry.pose import Array

Labels = NDArray[np.uint16]


def boundary(labels: Labels, a: int, b: int) -> Array:
    """Return (N, 2) px the midpoints between neighbouring pixels of which one is of a label, one of another.

    Args:
        labels: (H, W).
        a, b: the labels.
    """
    return _midpoints(*(_between(*pair, a, b) for pair in _neighbours(labels)))


def outline(labels: Labels, a: int) -> Array:
    """Return (N, 2) px the midpoints between neighbouring pixels of which only one has the label ``a``."""
    return _midpoints(*((first == a) != (second == a) for first, second in _neighbours(labels)))


def _neighbours(labels: Labels) -> tuple[tuple[Labels, Labels], tuple[Labels, Labels]]:
    """Pixels with those to their right, and with those below them."""
    return (labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])


def _midpoints(beside: NDArray[np.bool_], below: NDArray[np.bool_]) -> Array:
    row, column = np.nonzero(beside)
    right = np.stack([column + 1.0, row + 0.5], axis=-1)
    row, column = np.nonzero(below)
    return np.concatenate([right, np.stack([column + 0.5, row + 1.0], axis=-1)])


def _between(first: Labels, second: Labels, a: int, b: int) -> NDArray[np.bool_]:
    return np.asarray((first == a) & (second == b) | (first == b) & (second == a))
