"""From mask colours to labels, by lookup: a colour that no object has is counted, never guessed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omniscv.captures.source import ObjectTable

Color = tuple[int, int, int]
_BLACK: Color = (0, 0, 0)


def labels_of(mask: NDArray[np.uint8], table: ObjectTable) -> tuple[NDArray[np.uint16], dict[Color, int]]:
    """Labels of mask colours.

    Args:
        mask: (..., 3) uint8 RGB.
        table: the objects and the colours that masks show for them.

    Returns:
        labels (...) uint16, 0 where no object has the colour, and the unknown colours with the number of
        their pixels; black, which is also what servers show where nothing is, is not counted.
    """
    packed = _pack(mask)
    names = table.names()
    codes = np.array([_pack(np.array(table.colors[name], dtype=np.uint8)) for name in names], dtype=np.uint32)
    order = np.argsort(codes, kind="stable")
    found, inverse = np.unique(packed, return_inverse=True)
    place = np.searchsorted(codes[order], found) if len(names) else np.zeros(len(found), dtype=np.intp)
    known = np.zeros(len(found), dtype=bool)
    label = np.zeros(len(found), dtype=np.uint16)
    inside = place < len(names)
    known[inside] = codes[order][place[inside]] == found[inside]
    label[known] = 1 + order[place[known]]
    counts = np.bincount(inverse.ravel(), minlength=len(found))
    unknown = {
        color: int(count)
        for code, count, is_known in zip(found.tolist(), counts, known, strict=True)
        if not is_known and (color := (code >> 16, code >> 8 & 255, code & 255)) != _BLACK
    }
    return label[inverse].reshape(mask.shape[:-1]), unknown


def _pack(rgb: NDArray[np.uint8]) -> NDArray[np.uint32]:
    r, g, b = (rgb[..., i].astype(np.uint32) for i in range(3))
    return np.asarray(r << 16 | g << 8 | b, dtype=np.uint32)
