"""What colours say of a layout: a pixel's surface is the one that has more of its colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omniscv.evaluate.room_hypotheses import Hypothesis, Support, row_of, visible_walls
from omniscv.geometry.pose import Array

_LEVELS = 12  # of each channel of L*a*b*
_OTHER = 0.2  # share of a surface that may have any colour of the image: furniture before it
_WEIGHT = 4.0  # of a column in which every pixel is e times as likely, against a line
_CEILING, _FLOOR = 4, 5  # 0 to 3 are the walls of a direction


def region_support(edges: Support, colors: NDArray[np.uint8], room: Hypothesis) -> Support:
    """Return what lines say and what colours say, given the colours that a room's surfaces would have.

    Of a column, the likelihood of the pixels above an edge and below it is a difference of sums, so that it
    belongs to the edge's pixel like a line's.

    Args:
        edges: what lines say.
        colors: (H, W, 3) uint8 RGB of the turned panorama.
        room: whose surfaces are looked at.
    """
    likely = _likely(_codes(colors), surfaces(room, *colors.shape[:2]))  # (6, H, W)
    sums = np.cumsum(likely, axis=1) - likely  # of the rows before each
    weight = _WEIGHT / colors.shape[0]
    walls, ceiling, floor = sums[:4], sums[_CEILING], sums[_FLOOR]
    whole = likely[_FLOOR].sum(axis=0)
    upper, lower = ceiling - walls, walls + whole - floor
    return edges._replace(upper=edges.upper + weight * upper, lower=edges.lower + weight * lower)


def surfaces(room: Hypothesis, rows: int, columns: int) -> NDArray[np.intp]:
    """Return (H, W) the surface that a pixel shows: 0 to 3 walls by direction, 4 ceiling, 5 floor."""
    azimuths = (np.arange(columns) + 0.5) * 2 * np.pi / columns
    direction, away = visible_walls(room.corners(), azimuths)
    v = np.arange(rows)[:, None] + 0.5
    shown = np.where(v < row_of(room.height / away, rows), _CEILING, direction)
    return np.where(v > row_of(-1 / away, rows), _FLOOR, shown)


def _codes(colors: NDArray[np.uint8]) -> NDArray[np.intp]:
    """(H, W) which of the ``_LEVELS``^3 colours a pixel has."""
    import cv2

    lab = cv2.cvtColor(colors, cv2.COLOR_RGB2Lab).astype(np.intp)
    low, high = lab.min(axis=(0, 1)), lab.max(axis=(0, 1))
    level = (lab - low) * _LEVELS // (high - low + 1)
    return np.asarray(level @ [_LEVELS**2, _LEVELS, 1])


def _likely(codes: NDArray[np.intp], shown: NDArray[np.intp]) -> Array:
    """(6, H, W) log of how much likelier a pixel's colour is on a surface than in the whole image."""
    from scipy.ndimage import gaussian_filter

    rows = len(codes)
    weights = np.broadcast_to(
        np.cos((np.arange(rows)[:, None] + 0.5) / rows * np.pi - np.pi / 2), codes.shape
    )
    counts = np.zeros((6, _LEVELS**3))
    for surface in range(6):
        on = shown == surface
        counts[surface] = np.bincount(codes[on], weights[on], _LEVELS**3)
    cubes = counts.reshape(6, _LEVELS, _LEVELS, _LEVELS)
    counts = gaussian_filter(cubes, (0, 0.5, 0.5, 0.5), mode="nearest").reshape(6, -1) + 1e-3
    shares = counts / counts.sum(axis=1, keepdims=True)
    everywhere = counts.sum(axis=0) / counts.sum()
    return np.asarray(np.log(_OTHER + (1 - _OTHER) * shares / everywhere)[:, codes])
