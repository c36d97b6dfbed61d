"""Truth drawn over an image, for a person to look at."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError

_COLORS = {"floor": (255, 190, 40), "ceiling": (60, 200, 255), "vertical": (110, 255, 110)}
_SHIFT = 4  # binary digits of a part of a pixel
_HIDDEN = 0.45  # of the colour's strength
_DASH = 10  # px of a curve that is drawn, and then left out


def draw_layout(picture: NDArray[np.uint8], record: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return a picture with a layout over it.

    Edges of the floor are amber, of the ceiling blue, between walls green; dashed behind furniture, thin and
    grey behind walls of the room. Corners are rings, filled where they are visible.

    Args:
        picture: (H, W, 3) uint8 RGB; not changed.
        record: of the layout in the image; see :mod:`omniscv.truth.layout_record`.

    Raises:
        ArgumentError: another picture.
    """
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        got = f"{picture.dtype} of shape {picture.shape}"
        raise ArgumentError(f"picture: expected (H, W, 3) uint8, got {got}")
    drawn = np.ascontiguousarray(picture).copy()
    width = max(1, round(min(picture.shape[:2]) / 256))
    for hidden_first in (True, False):
        for edge in record["edges"]:
            for piece in edge["pieces"]:
                if bool(piece["visible_room"]) is not hidden_first:
                    _draw_piece(drawn, piece, _COLORS[edge["kind"]], width)
    for corner in record["corners"]:
        if corner["in_image"]:
            _draw_corner(drawn, corner, width)
    return drawn


def _draw_piece(
    drawn: NDArray[np.uint8], piece: Mapping[str, Any], color: tuple[int, int, int], width: int
) -> None:
    pixels = np.array(piece["pixels"])
    if not piece["visible_room"]:
        _draw_curve(drawn, pixels, (150, 150, 150), 1)
    elif piece["visible"] in (True, None):
        _draw_curve(drawn, pixels, color, width)
    else:
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1)))
        dash = np.floor(along / (_DASH * width)).astype(int)
        for index in range(0, int(dash[-1]) + 1, 2):
            _draw_curve(drawn, pixels[dash == index], color, width, _HIDDEN + 0.3)


def _draw_curve(
    drawn: NDArray[np.uint8],
    pixels: NDArray[np.float64],
    color: tuple[int, int, int],
    width: int,
    strength: float = 1.0,
) -> None:
    import cv2

    points = np.round((pixels - 0.5) * (1 << _SHIFT)).astype(np.int32)  # OpenCV's pixel 0 has its centre at 0
    shade = tuple(round(strength * each) for each in color)
    cv2.polylines(drawn, [points], False, shade, width, cv2.LINE_AA, _SHIFT)


def _draw_corner(drawn: NDArray[np.uint8], corner: Mapping[str, Any], width: int) -> None:
    import cv2

    u, v = (round((each - 0.5) * (1 << _SHIFT)) for each in corner["pixel"])
    color = _COLORS[corner["kind"]] if corner["visible_room"] else (150, 150, 150)
    filled = corner["visible_room"] and corner["visible"] in (True, None)
    radius = (2 + 2 * width) << _SHIFT
    cv2.circle(drawn, (u, v), radius, color, -1 if filled else width, cv2.LINE_AA, _SHIFT)
