"""The pixels of each mode, from what a view's rays meet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mock_server.render import ViewHits

LARGEST_HALF = 65504.0
"""The largest half float: what depth saturates at, and what the sky's depth is."""

_GRAY_CM = 10_000.0
"""Where the depth view mode becomes white."""

Bytes = NDArray[np.uint8]


def normals(view: ViewHits) -> Bytes:
    """(H, W, 3) ``0.5 n + 0.5`` of the normals in Unreal's world axes; middle gray for the sky."""
    return np.round(255 * (0.5 + 0.5 * view.normal * (1, -1, 1))).astype(np.uint8)


def gray_depth(view: ViewHits) -> Bytes:
    """(H, W, 3) what the depth view mode shows."""
    gray = np.round(255 * np.minimum(100 * view.depth / _GRAY_CM, 1.0)).astype(np.uint8)
    return np.repeat(gray[..., None], 3, axis=2)


def rescaled(distance: NDArray[np.float64]) -> Bytes:
    """(H, W, 3) distances as gray from 0 to the picture's own largest: for the eye, not for measuring."""
    limited = np.minimum(distance, LARGEST_HALF)
    return np.repeat(np.round(255 * limited / limited.max()).astype(np.uint8)[..., None], 3, axis=2)


def stored(depth: NDArray[np.float64], half: bool) -> NDArray[np.float32]:
    """Depth in the server's unit as it comes out of the engine's buffers: float32, through half floats."""
    limited = np.minimum(depth, LARGEST_HALF)
    return (limited.astype(np.float16) if half else limited).astype(np.float32)


def through_vertex_colors(colors: Bytes) -> Bytes:
    """What painted vertices show (protocol reference, section 5.2): to linear light in 8 bits, and back."""
    linear = np.floor((colors / 255.0) ** 2.2 * 255.999)
    return np.asarray(np.round((linear / 255.0) ** (1 / 2.2) * 255), dtype=np.uint8)
