"""Edges in colour images, to a part of a pixel, as chains of points.

An edge point is a maximum of the gradient's magnitude along the row or column that is nearer to the
gradient's direction, where a parabola through three pixels has its top (Devernay 1995, A non-maxima
suppression method for edge detection with sub-pixel accuracy). Neighbours join a chain while the gradient
turns little from one to the next, so that chains end at corners.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from omniscv.geometry.pose import Array

_SIGMA_PX = 1.0
_LEAST_CONTRAST = 4.0  # of 255, per pixel of the blurred image
_MOST_TURN = np.cos(np.radians(20))  # of the gradient between neighbours of a chain
_NEIGHBOURS = ((0, 1), (1, -1), (1, 0), (1, 1))


class EdgePoints(NamedTuple):
    """Points on edges.

    Attributes:
        pixels: (N, 2) px.
        gradients: (N, 2) unit, from dark to light.
        chain: (N,) which chain a point belongs to.
    """

    pixels: Array
    gradients: Array
    chain: NDArray[np.intp]


def find_edges(lit: NDArray[np.uint8], valid: NDArray[np.bool_], margin_px: int = 4) -> EdgePoints:
    """Return the edge points of a picture.

    Args:
        lit: (H, W, 3) colours.
        valid: (H, W) where the picture shows something.
        margin_px: so near to what is not valid no edge counts: it would be the image circle's.
    """
    gradient = _gradient(lit)
    size = np.hypot(gradient[..., 0], gradient[..., 1])
    inside = cv2.erode(
        np.pad(valid, 1).astype(np.uint8), np.ones((3, 3), np.uint8), iterations=margin_px, borderValue=0
    )[1:-1, 1:-1].astype(bool)
    row, column, offset = _maxima(size, gradient, inside)
    unit = gradient[row, column] / size[row, column, None]
    pixels = np.stack([column + 0.5, row + 0.5], axis=-1) + offset
    return EdgePoints(pixels, unit, _chains(row, column, unit, size.shape))


def _gradient(lit: NDArray[np.uint8]) -> Array:
    """(H, W, 2) grey levels per px, of the channel that changes most."""
    blurred = cv2.GaussianBlur(lit.astype(np.float32), (0, 0), _SIGMA_PX)
    both = np.stack([cv2.Scharr(blurred, cv2.CV_32F, *axis) / 32 for axis in ((1, 0), (0, 1))], axis=-1)
    most = np.argmax((both**2).sum(axis=-1), axis=-1)
    return np.take_along_axis(both, most[..., None, None], axis=2)[:, :, 0].astype(np.float64)


def _maxima(
    size: Array, gradient: Array, inside: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Rows and columns of the pixels with an edge, and (N, 2) px how far it is from their centres."""
    across = np.abs(gradient[..., 0]) >= np.abs(gradient[..., 1])
    strong = inside & (size >= _LEAST_CONTRAST)
    strong[[0, -1]], strong[:, [0, -1]] = False, False
    row, column = np.nonzero(strong)
    step = across[row, column].astype(np.intp)
    before, own, after = (size[row + s * (1 - step), column + s * step] for s in (-1, 0, 1))
    top = (own > before) & (own >= after)
    shift = 0.5 * (before - after)[top] / (before - 2 * own + after)[top]
    offset = np.stack([shift * step[top], shift * (1 - step[top])], axis=-1)
    return row[top], column[top], offset


def _chains(
    row: NDArray[np.intp], column: NDArray[np.intp], unit: Array, shape: tuple[int, ...]
) -> NDArray[np.intp]:
    """(N,) connected pixels between which the gradient turns little."""
    index = np.full(shape, -1, np.intp)
    index[row, column] = np.arange(len(row))
    starts, ends = [], []
    for down, right in _NEIGHBOURS:
        other = index[(row + down) % shape[0], (column + right) % shape[1]]
        own = np.flatnonzero(other >= 0)
        alike = (unit[own] * unit[other[own]]).sum(axis=-1) >= _MOST_TURN
        starts.append(own[alike])
        ends.append(other[own[alike]])
    start, end = np.concatenate(starts), np.concatenate(ends)
    graph = coo_matrix((np.ones(len(start)), (start, end)), shape=(len(row), len(row)))
    return np.asarray(connected_components(graph, directed=False)[1], np.intp)
