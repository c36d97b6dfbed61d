"""Find captures of another view: pictures from before a move, which a server sent once more.

A picture that two views share byte for byte is right for both where they look alike. Where it belongs to one
of them, it contradicts the other: depth bends or jumps at nearly all edges of a mask of the same view.
"""

from collections import defaultdict
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.sources.base import Capture
from omniscv.sources.recording.rows import Row, view_from_json
from omniscv.sources.recording.store import Store
from omniscv.sources.recording.views import in_words

_MODES = ("depth", "object_mask")
_PX, _LEAST_EDGES = 64, 30
"""Pixels of a side that are compared, about; pixels at edges of a mask, below which nothing is said."""
_BEND = 0.01  # relative second difference of inverse depth: half floats stay below 0.002
_FITS, _CONTRADICTS = 0.9, 0.75
"""Shares of the edges of a mask that depth has too: in one view 0.84 to 1, in two mostly less than 0.6."""


def stale_captures(store: Store) -> Iterator[str]:
    """Yield a line for each capture of depth or masks that shows another view.

    Args:
        store: with undamaged captures.
    """
    views: dict[tuple[str, str], dict[str, Row]] = defaultdict(dict)
    equal: dict[tuple[str, int], list[Row]] = defaultdict(list)
    for row in store.listing():
        if row.mode in _MODES and row.stops is None:
            views[row.asked, row.state][row.mode] = row
            equal[row.mode, row.payload_checksum].append(row)
    for (mode, _), rows in equal.items():
        whole = [views[row.asked, row.state] for row in rows if len(views[row.asked, row.state]) == 2]
        if len({of_view[mode].captured for of_view in whole}) < 2 or not _has_edges(_capture(store, rows[0])):
            continue
        shares = [_common_edges(*(_capture(store, of_view[each]) for each in _MODES)) for of_view in whole]
        best = int(np.nan_to_num(shares).argmax())
        for of_view, share in zip(whole, shares, strict=True):
            if share < _CONTRADICTS and shares[best] >= _FITS:
                own, other = (
                    in_words(view_from_json(each[mode].captured)) for each in (of_view, whole[best])
                )
                yield f"{mode} of {own}: expected its own picture, got that of {other}"


def _capture(store: Store, row: Row) -> Capture:
    return next(store.rows([row.number])).capture()


def _has_edges(capture: Capture) -> bool:
    edges = _bends if capture.mode == "depth" else _borders
    return bool(edges(capture.pixels).any())


def _common_edges(depth: Capture, mask: Capture) -> float:
    """Return the share of a mask's edges at which depth bends or jumps; NaN where there are few."""
    if depth.pixels.shape[:2] != mask.pixels.shape[:2]:
        return float("nan")
    borders = _borders(mask.pixels)
    near = cv2.dilate(_bends(depth.pixels).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return float(near[borders].mean()) if borders.sum() >= _LEAST_EDGES else float("nan")


def _few(pixels: NDArray[np.generic]) -> NDArray[np.generic]:
    step = max(1, max(pixels.shape[:2]) // _PX)
    return pixels[step // 2 :: step, step // 2 :: step]


def _bends(depth: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Return (h, w) where inverse depth, which is linear on planes, is not."""
    inverse = 1 / np.maximum(_few(depth).astype(np.float64), 1e-3)
    bends = np.zeros(inverse.shape, np.bool_)
    for values, out in ((inverse, bends), (inverse.T, bends.T)):
        before, here, after = values[:-2], values[1:-1], values[2:]
        out[1:-1] |= abs(before - 2 * here + after) > _BEND * np.minimum(np.minimum(before, here), after)
    return bends


def _borders(mask: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Return (h, w) where the next pixel to the right or below has another colour or id."""
    few = _few(mask)
    codes = few.reshape(*few.shape[:2], -1)
    borders = np.zeros(codes.shape[:2], np.bool_)
    borders[:, :-1] |= (codes[:, 1:] != codes[:, :-1]).any(axis=2)
    borders[:-1] |= (codes[1:] != codes[:-1]).any(axis=2)
    return borders
