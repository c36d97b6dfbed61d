"""The layers of a frame in the forms that a page reads.

``picture``  the bytes of a PNG or JPEG file, or of a PNG that is made: RGB
``ids``      uint16: labels, classes
``scalar``   float32, exact for depth; of depth_error 10 binary digits are kept
``vectors``  int8, 127 for 1: normals
``marks``    uint8, 1 where a pixel is marked

Any layer of :mod:`omniscv.modalities` has one of these forms by its type and interpolation.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.compose.pictures import uint8_colors
from omniscv.dataset import Frame
from omniscv.errors import ArgumentError
from omniscv.parallel import side_by_side
from omniscv.viewing.look.arrays import pack, rounded, text

_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
_ERROR_BITS = 10


def names(frame: Frame) -> list[str]:
    """Return the layers that a frame has, in the order of the table."""
    return [row.name for row in modalities.layers() if row.name in frame.files]


def packed(frame: Frame) -> dict[str, dict[str, Any]]:
    """Return the layers of a frame by name, as plain JSON values with ``form``.

    Raises:
        ArgumentError: a file cannot be read.
    """
    found = names(frame)
    return dict(zip(found, side_by_side(lambda name: _packed(frame, name), found), strict=True))


def form(name: str) -> str:
    """Return the form of a layer."""
    row = modalities.get(name)
    if row.dtypes == ("bool",):
        return "marks"
    if row.dtypes == ("uint16",):
        return "ids"
    if row.channels == 3:
        return "vectors" if row.interpolation in ("direction", "plane") else "picture"
    return "scalar"


def _packed(frame: Frame, name: str) -> dict[str, Any]:
    kind, path = form(name), frame.files[name]
    if kind == "picture":
        if path.suffix.lower() in _TYPES:
            return {"form": kind, "type": _TYPES[path.suffix.lower()], "data": text(path.read_bytes())}
        return {"form": kind, "type": "image/png", "data": text(_png(frame.layer(name)))}
    values = frame.layer(name)
    size = frame.camera.height, frame.camera.width
    if values.shape[:2] != size:
        wanted = f"expected {size[1]}x{size[0]} px, as its camera has"
        raise ArgumentError(f"{path}: {wanted}, got {values.shape[1]}x{values.shape[0]}")
    if kind == "vectors":
        return {"form": kind, **pack(np.rint(127 * np.nan_to_num(values)).astype(np.int8))}
    if kind == "scalar":
        exact = values.astype(np.float32)
        known = exact[np.isfinite(exact) & (exact > 0)]
        ends = [float(each) for each in np.quantile(known, (0.005, 0.995))] if known.size else None
        kept = rounded(exact, _ERROR_BITS) if name == "depth_error" else exact
        return {"form": kind, "range": ends, **pack(kept)}
    return {"form": kind, **pack(values)}


def _png(values: NDArray[Any]) -> bytes:
    return cv2.imencode(".png", np.ascontiguousarray(uint8_colors(values)[..., ::-1]))[1].tobytes()
