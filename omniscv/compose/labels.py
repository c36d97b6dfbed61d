"""From mask colours to labels, by lookup: a colour that no object can have shown is counted, never guessed.

Plugin 0.3.10 bends colours (:mod:`omniscv.captures.gamma`); later ones deviate by up to three in a channel.
A colour that is nobody's own is the object's whose own or bent colour it is nearest to, if that is within
the tolerance and no other object's is.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from omniscv.captures.gamma import bent
from omniscv.captures.source import ObjectTable

Color = tuple[int, int, int]
_BLACK: Color = (0, 0, 0)

TOLERANCE = 3
"""How far a channel may be off; the official client allows as much."""


def labels_of(mask: NDArray[np.uint8], table: ObjectTable) -> tuple[NDArray[np.uint16], dict[Color, int]]:
    """Labels of mask colours.

    Args:
        mask: (..., 3) uint8 RGB.
        table: the objects and their colours.

    Returns:
        labels (...) uint16, 0 where no object has the colour, and the unknown colours with the number of
        their pixels; black, which is also what servers show where nothing is, is not counted.
    """
    inverse, found, counts = _distinct(mask.reshape(-1, 3))
    colors = np.stack([found >> 16, found >> 8 & 255, found & 255], axis=-1)
    own = np.array([table.colors[name] for name in table.names()], dtype=np.int64).reshape(-1, 3)
    labels = np.array([_label(color, own) for color in colors], dtype=np.uint16)
    unknown = {
        (int(r), int(g), int(b)): int(count)
        for (r, g, b), label, count in zip(colors, labels, counts, strict=True)
        if label == 0 and (r, g, b) != _BLACK
    }
    return labels[inverse].reshape(mask.shape[:-1]), unknown


def _label(color: NDArray[np.int64], own: NDArray[np.int64]) -> int:
    """1 + the row of the one object that shows a colour; 0 for none, or for several alike."""
    if len(own) == 0:
        return 0
    off = np.abs(own - color).max(axis=1)
    if (color != 0).any():
        off = np.where(off == 0, 0, np.minimum(off, np.abs(bent(own) - color).max(axis=1)) + 1)
    exact = np.flatnonzero(off == 0)
    if len(exact):
        return int(exact[0]) + 1 if len(exact) == 1 else 0
    near = np.flatnonzero(off <= TOLERANCE + 1)
    return int(near[0]) + 1 if len(near) == 1 and (color != 0).any() else 0


def _distinct(
    flat: NDArray[np.uint8],
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
    """Which of the distinct colours each pixel has, the colours packed into numbers, and their counts."""
    slots = 1 << 12
    while True:
        which = np.empty(len(flat), np.int32)
        keys, counts = np.full(slots, -1, np.int64), np.zeros(slots, np.int64)
        if _count(flat, which, keys, counts):
            used = np.flatnonzero(counts)
            place = np.zeros(slots, np.int32)
            place[used] = np.arange(len(used))
            return place[which], keys[used], counts[used]
        slots *= 8  # as many colours as slots: a picture of something else than masks


@njit(cache=True, nogil=True)
def _count(
    flat: NDArray[np.uint8], which: NDArray[np.int32], keys: NDArray[np.int64], counts: NDArray[np.int64]
) -> bool:
    """Counts colours in a hash table with open addressing; False when it is more than half full."""
    slots, used = len(keys), 0
    last, slot = np.int64(-1), np.int64(0)
    for i in range(flat.shape[0]):
        color = np.int64(flat[i, 0]) << 16 | np.int64(flat[i, 1]) << 8 | np.int64(flat[i, 2])
        if color != last:
            slot = (color * 40503 >> 4) & (slots - 1)
            while keys[slot] != color:
                if keys[slot] < 0:
                    keys[slot] = color
                    used += 1
                    if 2 * used > slots:
                        return False
                    break
                slot = (slot + 1) & (slots - 1)
            last = color
        which[i] = slot
        counts[slot] += 1
    return True
