"""From mask colours to labels, by lookup: a colour that no object can have shown is counted, never guessed.

Plugin 0.3.10 bends colours: it paints ``floor((c/255)^2.2 * 255.999)`` and shows
``round((v/255)^(1/2.2) * 255)`` (protocol reference, section 5.2); later ones deviate by up to three in a
channel. A colour that is nobody's own is the object's whose own or bent colour it is nearest to, if that is
within the tolerance and no other object's is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    found, inverse, counts = np.unique(_pack(mask), return_inverse=True, return_counts=True)
    colors = np.stack([found >> 16, found >> 8 & 255, found & 255], axis=-1).astype(np.int64)
    own = np.array([table.colors[name] for name in table.names()], dtype=np.int64).reshape(-1, 3)
    labels = np.array([_label(color, own) for color in colors], dtype=np.uint16)
    unknown = {
        (int(r), int(g), int(b)): int(count)
        for (r, g, b), label, count in zip(colors, labels, counts, strict=True)
        if label == 0 and (r, g, b) != _BLACK
    }
    return labels[inverse].reshape(mask.shape[:-1]), unknown


def bent(colors: NDArray[np.int64]) -> NDArray[np.int64]:
    """(N, 3) what plugin 0.3.10 shows for colours 0..255."""
    painted = np.floor((colors / 255) ** 2.2 * 255.999)
    return np.asarray(np.rint((painted / 255) ** (1 / 2.2) * 255), dtype=np.int64)


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


def _pack(rgb: NDArray[np.uint8]) -> NDArray[np.uint32]:
    r, g, b = (rgb[..., i].astype(np.uint32) for i in range(3))
    return np.asarray(r << 16 | g << 8 | b, dtype=np.uint32)
