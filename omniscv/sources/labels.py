"""Convert object masks to labels.

A colour within the tolerance of exactly one object's, or its own, has its label. Unknown ones are counted.
"""

from collections import Counter
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry.arrays import Pixels, run
from omniscv.sources.base import Color, ObjectTable

Labels = NDArray[np.uint16]
_SEVERAL = np.iinfo(np.uint16).max


def labels_of(mask: NDArray[Any], table: ObjectTable) -> tuple[Labels, dict[Color, int]]:
    """Return the labels (...) uint16 of an object mask (..., 3) uint8, 0 where no object has the colour.

    ``table`` has the objects' colours. The unknown colours are returned as well, each with the number of its
    pixels; black is not counted, because servers show it where there is no object.
    """
    colors_of = tuple(table.colors[name] for name in table.names())
    label_of = _label_of_colors(colors_of, table.tolerance)
    colors = np.ascontiguousarray(mask).reshape(-1, 3)
    labels = np.empty(mask.shape[:-1], np.uint16)
    run(_look_up, (colors, labels.reshape(-1)), label_of)
    unknown_pixels = colors[labels.reshape(-1) == 0].astype(np.uint32)
    codes = unknown_pixels[:, 0] << 16 | unknown_pixels[:, 1] << 8 | unknown_pixels[:, 2]
    unknown_codes, counts = np.unique(codes[codes != 0], return_counts=True)
    unknown: dict[Color, int] = {}
    for code, count in zip(unknown_codes.tolist(), counts.tolist(), strict=True):
        unknown[code >> 16, code >> 8 & 255, code & 255] = count
    return labels, unknown


def labels_of_ids(ids: NDArray[np.uint16], table: ObjectTable) -> tuple[Labels, NDArray[np.uint8]]:
    """Return the labels (...) of instance ids (...), and (..., 3) uint8 RGB of the objects' colours.

    ``table`` has the ids, labels and colours; an id of no object has the label 0, and black.
    """
    label_of = np.zeros(1 << 16, np.uint16)
    color_of = np.zeros((1 << 16, 3), np.uint8)
    for label, name in enumerate(table.names(), start=1):
        if name in table.ids:
            label_of[table.ids[name]] = label
            color_of[table.ids[name]] = table.colors[name]
    return label_of[ids], color_of[ids]


@lru_cache(maxsize=1)
def _label_of_colors(colors: tuple[Color, ...], off: int) -> Labels:
    """Return (2^24,) the label of every colour within ``off`` of an object's; pages are made when written."""
    label_of = np.zeros(1 << 24, np.uint16)
    cube = label_of.reshape(256, 256, 256)
    neighbours = []
    for red, green, blue in colors:
        neighbours.append(cube[_around(red, off), _around(green, off), _around(blue, off)])
    for label, near in enumerate(neighbours, start=1):
        near[...] = np.where(near == 0, label, _SEVERAL)
    for near in neighbours:
        near[near == _SEVERAL] = 0
    cube[0, 0, 0] = 0
    count = Counter(colors)
    for label, color in enumerate(colors, start=1):
        cube[color] = label if count[color] == 1 else 0
    return label_of


def _around(level: int, off: int) -> slice:
    """Return the levels of a channel that are at most ``off`` beside a level."""
    return slice(max(0, level - off), level + off + 1)


@njit("uint8[:, ::1], out uint16[::1], uint16[::1]", nogil=True)
def _look_up(colors: Pixels, labels: Labels, label_of: Labels) -> None:
    for i in range(len(colors)):
        red, green, blue = np.uint32(colors[i, 0]), np.uint32(colors[i, 1]), np.uint32(colors[i, 2])
        labels[i] = label_of[red << 16 | green << 8 | blue]
