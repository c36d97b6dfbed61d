"""Run-length encoded masks in the compressed form of COCO.

Runs go down the columns; the first run is of pixels that are not set. Counts from the fourth on are stored as
differences to the count before the last. A number is stored in groups of five bits, the lowest first; a sixth
bit is set if more groups follow. A group is a printable character from ``0``.
Source: the documentation of the format in cocodataset/cocoapi, common/maskApi.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

_GROUPS = 7
"""Groups of five bits: enough for differences of counts below 2^31."""


def encode(mask: Mask) -> dict[str, Any]:
    """Return ``{"size": [height, width], "counts": text}`` of a mask (H, W)."""
    height, width = mask.shape
    columns = np.flatnonzero(mask.any(axis=0))
    first, last = (columns[0], columns[-1] + 1) if len(columns) else (0, 0)
    runs = mask[:, first:last].ravel(order="F")
    starts = np.flatnonzero(np.diff(runs, prepend=False, append=False)) + first * height
    ends = [] if len(starts) and starts[-1] == mask.size else [mask.size]
    edges = np.concatenate([[0], starts, ends]).astype(np.int64)
    return {"size": [height, width], "counts": _text(edges[1:] - edges[:-1])}


def _text(counts: NDArray[np.int64]) -> str:
    left = counts.copy()
    left[3:] -= counts[1:-2]
    characters = np.zeros((len(left), _GROUPS), np.uint8)
    going = np.ones(len(left), bool)
    for group in range(_GROUPS):
        low = left & 31
        left >>= 5
        more = going & np.where(low & 16, left != -1, left != 0)
        characters[going, group] = (low + 32 * more + 48)[going]
        going = more
    return characters[characters > 0].tobytes().decode("ascii")
