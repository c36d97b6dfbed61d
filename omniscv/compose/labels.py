"""From object masks to labels, by lookup: a colour that no object can have shown is counted, never guessed.

A colour that is nobody's own is the object's whose colour it is nearest to, if that is within the tolerance
that the source gives and no other object's is.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.sources.base import Color, ObjectTable

Labels = NDArray[np.uint16]
_SEVERAL = np.iinfo(np.uint16).max


def labels_of(mask: NDArray[Any], table: ObjectTable) -> tuple[Labels, dict[Color, int]]:
    """Return the labels of an object mask.

    Args:
        mask: (..., 3) uint8 RGB.
        table: the objects and their colours.

    Returns:
        labels (...) uint16, 0 where no object has the colour, and the unknown colours with the number of
        their pixels; black, which is also what servers show where nothing is, is not counted.
    """
    label_of = _label_of_colors(table)
    codes = mask[..., 0].astype(np.uint32) << 16
    codes |= mask[..., 1].astype(np.uint32) << 8
    codes |= mask[..., 2]
    labels = label_of[codes]
    strange, counts = np.unique(codes[(labels == 0) & (codes != 0)], return_counts=True)
    colors = [(int(code >> 16), int(code >> 8 & 255), int(code & 255)) for code in strange]
    return labels, dict(zip(colors, counts.tolist(), strict=True))


def labels_of_ids(ids: NDArray[np.uint16], table: ObjectTable) -> tuple[Labels, NDArray[np.uint8]]:
    """Return the labels (...) of instance ids (...), and (..., 3) uint8 RGB of the objects' colours."""
    label_of, color_of = np.zeros(1 << 16, np.uint16), np.zeros((1 << 16, 3), np.uint8)
    for label, name in enumerate(table.names(), start=1):
        if name in table.ids:
            label_of[table.ids[name]], color_of[table.ids[name]] = label, table.colors[name]
    return label_of[ids], color_of[ids]


def _label_of_colors(table: ObjectTable) -> Labels:
    """(2^24,) the label of every colour; its pages are only made where they are written or read."""
    label_of = np.zeros(1 << 24, np.uint16)
    cube, own = label_of.reshape(256, 256, 256), [table.colors[name] for name in table.names()]
    off = table.tolerance
    balls = [cube[tuple(slice(max(0, c - off), c + off + 1) for c in color)] for color in own]
    for label, near in enumerate(balls, start=1):
        near[...] = np.where(near == 0, label, _SEVERAL)
    for near in balls:
        near[near == _SEVERAL] = 0
    cube[0, 0, 0] = 0
    for label, color in enumerate(own, start=1):
        cube[color] = label if own.count(color) == 1 else 0
    return label_of
