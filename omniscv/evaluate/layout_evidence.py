"""What speaks for edges of a layout, pixel by pixel, in a panorama turned to the room's heading."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import create
from omniscv.evaluate import manhattan
from omniscv.evaluate.panorama_lines import Segments, line_segments
from omniscv.geometry.pose import Array

_SIGMA_RAD = np.radians(1.0)
"""Width of a line: as much as detected segments are off the edges that they show."""


class Evidence(NamedTuple):
    """Of one panorama. Columns are azimuths to the right of the heading: column i is at (i + 0.5) 2 pi / W.

    Attributes:
        lines: (3, H, W) float64, 0 to 1, how near a segment is that runs along the heading, across it, up.
        colors: (H, W, 3) uint8 RGB.
        azimuth: of the heading, radians to the right of the panorama's middle.
    """

    lines: Array
    colors: NDArray[np.uint8]
    azimuth: float


def evidence(lit: NDArray[np.uint8], width: int) -> Evidence:
    """Return the evidence of a panorama (H, W, 3) RGB at a smaller width, px: a multiple of 4."""
    import cv2

    segments = line_segments(lit)
    azimuth = manhattan.heading(segments)
    member = manhattan.classes(segments, azimuth)
    lines = np.stack([_drawn(segments, each, azimuth, width) for each in member])
    small = cv2.resize(lit, (width, width // 2), interpolation=cv2.INTER_AREA)
    return Evidence(lines, _turned(small, azimuth), azimuth)


def _drawn(segments: Segments, chosen: NDArray[np.bool_], azimuth: float, width: int) -> Array:
    """(H, W) ``exp(-d^2 / 2 sigma^2)`` of the distance to the nearest of some segments."""
    import cv2

    camera = create("equirectangular", width, width // 2)
    marked = np.ones((width // 2, width), np.uint8)
    for i in np.flatnonzero(chosen):
        start, end, length = segments.starts[i], segments.ends[i], segments.lengths[i]
        share = np.linspace(0, 1, int(np.ceil(2 * length * width / (2 * np.pi))) + 1)[:, None]
        pixels, _ = camera.project((1 - share) * start + share * end)
        u = (pixels[:, 0] - _columns(azimuth, width)) % width
        marked[np.minimum(pixels[:, 1].astype(int), width // 2 - 1), np.minimum(u.astype(int), width - 1)] = 0
    margin = width // 16
    beside = cv2.copyMakeBorder(marked, 0, 0, margin, margin, cv2.BORDER_WRAP)
    away = cv2.distanceTransform(beside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[:, margin:-margin]
    sigma = _SIGMA_RAD * width / (2 * np.pi)
    return np.asarray(np.exp(-0.5 * (away.astype(np.float64) / sigma) ** 2))


def _turned(lit: NDArray[np.uint8], azimuth: float) -> NDArray[np.uint8]:
    """The nearest columns, so that the heading comes to the left edge."""
    return np.roll(lit, -round(_columns(azimuth, lit.shape[1])), axis=1)


def _columns(azimuth: float, width: int) -> float:
    """u of an azimuth, px."""
    return (azimuth / (2 * np.pi) + 0.5) * width
