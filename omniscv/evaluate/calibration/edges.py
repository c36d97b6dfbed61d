"""Edges in colour images: chains of points, and the points of each straight line.

An edge point is a maximum of the gradient's magnitude along the row or column that is nearer to the
gradient's direction, to a part of a pixel at the top of a parabola through three pixels (Devernay 1995, A
non-maxima suppression method for edge detection with sub-pixel accuracy). Neighbours join a chain while the
gradient turns little from one to the next, so that chains end at corners.

A chain can show several lines. RANSAC separates them without a calibration: three points determine r_vl and a
line's image (:meth:`LineImages.r_vl_of_triples`). The triple that most points agree with takes these points
from the chain, until too few are left. Its r_vl is used for grouping only.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from omniscv.evaluate.calibration.estimation import LineImages
from omniscv.geometry.pose import Array

_SIGMA_PX = 1.0  # of the blur before the gradient
_LEAST_CONTRAST = 4.0  # of 255, per pixel of the blurred image
_MARGIN_PX = 4  # from the image circle, whose rim is no edge of the scene
_MOST_TURN = np.cos(np.radians(20))  # of the gradient between neighbours of a chain
_NEIGHBOURS = ((0, 1), (1, -1), (1, 0), (1, 1))

_TRIPLES = 48
_NEAR_PX = 0.8
_MOST_LINES = 6  # of a chain
_MOST_POINTS = 120  # of a line; more would not make it more accurate


def find_edges(lit: NDArray[np.uint8], valid: NDArray[np.bool_]) -> list[Array]:
    """Return the chains of edge points of an image, (N_i, 2) px each.

    Args:
        lit: (H, W, 3) colours.
        valid: (H, W) inside the field of view.
    """
    blurred = cv2.GaussianBlur(lit.astype(np.float32), (0, 0), _SIGMA_PX)
    both = np.stack([cv2.Scharr(blurred, cv2.CV_32F, *axis) / 32 for axis in ((1, 0), (0, 1))], axis=-1)
    most = np.argmax((both**2).sum(axis=-1), axis=-1)  # the channel that changes most
    gradient = np.take_along_axis(both, most[..., None, None], axis=2)[:, :, 0].astype(np.float64)
    size = np.hypot(gradient[..., 0], gradient[..., 1])
    inside = cv2.erode(
        np.pad(valid, 1).astype(np.uint8), np.ones((3, 3), np.uint8), iterations=_MARGIN_PX, borderValue=0
    )[1:-1, 1:-1].astype(bool)
    row, column, offset = _maxima(size, gradient, inside)
    unit = gradient[row, column] / size[row, column, None]
    chain = _chains(row, column, unit, size.shape)
    pixels = np.stack([column + 0.5, row + 0.5], axis=-1) + offset
    return np.split(pixels[np.argsort(chain, kind="stable")], np.cumsum(np.bincount(chain))[:-1])


def group_by_line(
    chains: Sequence[Array], model: LineImages, limits: tuple[float, float], least: int
) -> list[Array]:
    """Return the points of each likely line, (N_i, 2) px from the image's middle.

    Args:
        chains: of edge points, (N_i, 2) px from the image's middle.
        model: of the camera.
        limits: px, bounds of r_vl.
        least: number of points of a line.
    """
    rng = np.random.default_rng(0)
    groups = []
    for chain in chains:
        points = chain
        for _ in range(_MOST_LINES):
            if len(points) < least:
                break
            near = _largest_consensus(points, model, limits, rng)
            if near.sum() < least:
                break
            line = points[near]
            groups.append(line[:: -(-len(line) // _MOST_POINTS)])
            points = points[~near]
    return groups


def _largest_consensus(
    points: Array, model: LineImages, limits: tuple[float, float], rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return (N,) whether points are near the image of a line through three of them."""
    triples = points[rng.integers(len(points), size=(_TRIPLES, 3))]
    r_vl = model.r_vl_of_triples(triples, *limits)
    triples, r_vl = triples[np.isfinite(r_vl)], r_vl[np.isfinite(r_vl), None]
    if not len(triples):
        return np.zeros(len(points), np.bool_)
    rows = np.concatenate([triples, -model.alpha(np.linalg.norm(triples, axis=-1), r_vl)[..., None]], axis=-1)
    normals = np.linalg.svd(rows)[2][:, 2]
    r = np.maximum(np.linalg.norm(points, axis=-1), 1e-9)
    with np.errstate(invalid="ignore"):
        alpha, slope = model.alpha(r, r_vl), model.slope(r, r_vl)
        across = normals[:, None, :2] - normals[:, None, 2:] * slope[..., None] * (points / r[:, None])
        value = normals[:, :2] @ points.T - normals[:, 2:] * alpha
        near = np.abs(value) <= _NEAR_PX * np.linalg.norm(across, axis=-1)
    return np.asarray(near[near.sum(axis=1).argmax()])


def _maxima(
    size: Array, gradient: Array, inside: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return rows and columns of the maxima, and (N, 2) px their offsets from the pixels' centres."""
    across = np.abs(gradient[..., 0]) >= np.abs(gradient[..., 1])
    strong = inside & (size >= _LEAST_CONTRAST)
    strong[[0, -1]], strong[:, [0, -1]] = False, False
    row, column = np.nonzero(strong)
    step = across[row, column].astype(np.intp)
    before, middle, after = (size[row + k * (1 - step), column + k * step] for k in (-1, 0, 1))
    top = (middle > before) & (middle >= after)
    shift = 0.5 * (before - after)[top] / (before - 2 * middle + after)[top]
    offset = np.stack([shift * step[top], shift * (1 - step[top])], axis=-1)
    return row[top], column[top], offset


def _chains(
    row: NDArray[np.intp], column: NDArray[np.intp], unit: Array, shape: tuple[int, ...]
) -> NDArray[np.intp]:
    """Return the chain of each point (N,): connected pixels between which the gradient turns little."""
    index = np.full(shape, -1, np.intp)
    index[row, column] = np.arange(len(row))
    starts, ends = [], []
    for down, right in _NEIGHBOURS:
        neighbour = index[(row + down) % shape[0], (column + right) % shape[1]]
        start = np.flatnonzero(neighbour >= 0)
        alike = (unit[start] * unit[neighbour[start]]).sum(axis=-1) >= _MOST_TURN
        starts.append(start[alike])
        ends.append(neighbour[start[alike]])
    start, end = np.concatenate(starts), np.concatenate(ends)
    graph = coo_matrix((np.ones(len(start)), (start, end)), shape=(len(row), len(row)))
    return np.asarray(connected_components(graph, directed=False)[1], np.intp)
