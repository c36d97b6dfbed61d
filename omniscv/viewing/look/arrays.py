"""Arrays as a page holds them: exact bytes, compressed, as text.

A packed array is a mapping with ``type`` (``f4``, ``u4``, ``u2``, ``i2``, ``i1``, ``u1``), ``shape`` and
``data``: the base64 text of a zlib stream. Its bytes are those of the array with the channels first,
(C, H, W), each number read as an unsigned whole number less its left neighbour (modulo its range), split into
planes: the lowest byte of every number, then the next. Neighbours in images are alike, so planes are mostly
zeros: float32 depth takes half of what EXR takes, without a loss. ``codec.js`` reads it.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TYPES = ("f4", "u4", "u2", "i2", "i1", "u1")
_LEVEL = 5


def pack(values: NDArray[Any]) -> dict[str, Any]:
    """Return an array (H, W) or (H, W, C) of one of the types as plain JSON values; see the module.

    Booleans become ``u1``.
    """
    exact = values.astype(np.uint8) if values.dtype == np.bool_ else values
    kind = f"{exact.dtype.kind}{exact.dtype.itemsize}"
    if kind not in _TYPES:
        raise TypeError(f"values: expected one of the types {', '.join(_TYPES)}, got {kind}")
    planar = np.moveaxis(exact if exact.ndim == 3 else exact[..., None], -1, 0)
    whole = np.ascontiguousarray(planar).view(f"<u{exact.dtype.itemsize}")
    steps = whole.copy()
    steps[..., 1:] -= whole[..., :-1]
    planes = np.ascontiguousarray(steps.view(np.uint8).reshape(-1, exact.dtype.itemsize).T)
    return {"type": kind, "shape": list(planar.shape), "data": text(zlib.compress(planes.tobytes(), _LEVEL))}


def text(data: bytes) -> str:
    """Return bytes as base64."""
    return base64.b64encode(data).decode("ascii")


def rounded(values: NDArray[np.float32], bits: int) -> NDArray[np.float32]:
    """Return float32 values with so many binary digits of mantissa: within 2^-(bits + 1) of each, relative.

    Zeros and infinities stay what they are.
    """
    spare = np.uint32(23 - bits)
    whole = np.ascontiguousarray(values, dtype=np.float32).view(np.uint32)
    half = np.uint32(1) << (spare - np.uint32(1))
    kept = np.where(np.isfinite(values), (whole + half) >> spare << spare, whole)
    return kept.astype(np.uint32).view(np.float32)
