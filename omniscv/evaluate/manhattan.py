"""The Manhattan directions of a room: the vertical, and two level ones at right angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omniscv.evaluate.panorama_lines import Segments
from omniscv.geometry.pose import Array

VERTICAL = 2
"""The class of upright lines; 0 and 1 are those along the heading and across it."""

_BINS = 360  # of a quarter turn
_BLUR_DEG = 0.75
_UPRIGHT, _LEVEL = np.sin(np.radians(5.0)), np.sin(np.radians(80.0))  # of a normal's vertical part
_NEAR_RAD = np.radians(1.5)  # between a line and its vanishing point
_NEAREST_POINT = np.cos(np.radians(4.0))  # segments at a vanishing point fit to it whatever they are


def heading(segments: Segments) -> float:
    """Return the azimuth of one of a room's two level directions, radians in [0, pi/2), to the right.

    A level line's great circle meets the horizon at its vanishing point, ``n x up``. Every segment votes with
    its length for that azimuth, modulo a quarter turn; the votes near the peak are averaged.
    """
    upright = np.abs(segments.normals[:, 1])
    used = (upright > _UPRIGHT) & (upright < _LEVEL)
    n, weights = segments.normals[used], segments.lengths[used] ** 2
    quarter = np.arctan2(n[:, 2], -n[:, 0]) % (np.pi / 2)  # of n x (0, 1, 0) = (-n_z, 0, n_x)
    if not len(quarter):
        return 0.0
    votes = np.bincount((quarter / (np.pi / 2) * _BINS).astype(int) % _BINS, weights, _BINS)
    offsets = (np.arange(_BINS) + _BINS // 2) % _BINS - _BINS // 2
    blur = np.exp(-0.5 * (offsets * 90 / _BINS / _BLUR_DEG) ** 2)
    smooth = np.fft.irfft(np.fft.rfft(votes) * np.fft.rfft(blur), _BINS)
    peak = (np.argmax(smooth) + 0.5) / _BINS * np.pi / 2
    apart = (quarter - peak + np.pi / 4) % (np.pi / 2) - np.pi / 4
    near = np.abs(apart) < np.radians(2 * _BLUR_DEG)
    return float((peak + np.average(apart[near], weights=weights[near])) % (np.pi / 2))


def directions(azimuth: float) -> Array:
    """Return (3, 3) the unit directions of the classes, camera frame, one per row."""
    sine, cosine = np.sin(azimuth), np.cos(azimuth)
    return np.array([[sine, 0, cosine], [cosine, 0, -sine], [0, 1, 0]])


def classes(segments: Segments, azimuth: float) -> NDArray[np.bool_]:
    """Return (3, S) which segments run along which direction: the great circle meets its vanishing point."""
    towards = directions(azimuth)
    middle = segments.starts + segments.ends
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    meets = np.abs(towards @ segments.normals.T) < np.sin(_NEAR_RAD)
    return np.asarray(meets & (np.abs(towards @ middle.T) < _NEAREST_POINT))
