"""The layers of a frame in the forms that a page reads.

``picture``  the bytes of a PNG or JPEG file, or of a PNG that is made: RGB
``ids``      uint16: labels, classes
``scalar``   float32
``vectors``  int8, 127 for 1: normals
``marks``    uint8, 1 where a pixel is marked

Any layer of :mod:`omniscv.modalities` has one of these forms by its type and interpolation.

Arrays are packed: a mapping with ``type`` (``f4``, ``u4``, ``u2``, ``i2``, ``i1``, ``u1``), ``shape`` and
``data``: the base64 text of a zlib stream. Its bytes are those of the array with the channels first,
(C, H, W), each number read as an unsigned whole number less its left neighbour (modulo its range), split into
planes: the lowest byte of every number, then the next. Neighbours in images are alike, so planes are mostly
zeros. ``codec.js`` reads it.
"""

import base64
import zlib
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.compose.pictures import uint8_colors
from omniscv.dataset import Frame
from omniscv.parallel import side_by_side

_PICTURE_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
_ARRAY_TYPES = ("f4", "u4", "u2", "i2", "i1", "u1")
_LEVEL = 5


def names(frame: Frame) -> list[str]:
    """Return the layers that a frame has, in the order of the table."""
    return [row.name for row in modalities.layers() if row.name in frame.files]


def form(name: str) -> str:
    """Return the form of a layer."""
    row = modalities.get(name)
    if row.mark:
        return "marks"
    if row.dtypes == ("uint16",):
        return "ids"
    if row.channels == 3:
        return "vectors" if row.interpolation in ("direction", "plane") else "picture"
    return "scalar"


def packed_layers(frame: Frame) -> dict[str, dict[str, Any]]:
    """Return the layers of a frame by name, as plain JSON values with ``form``.

    Raises:
        ArgumentError: a file cannot be read.
    """
    layers = names(frame)
    return dict(zip(layers, side_by_side(lambda name: _packed_layer(frame, name), layers), strict=True))


def _packed_layer(frame: Frame, name: str) -> dict[str, Any]:
    kind, path = form(name), frame.files[name]
    if kind == "picture":
        if media_type := _PICTURE_TYPES.get(path.suffix.lower()):
            return {"form": kind, "type": media_type, "data": text(path.read_bytes())}
        bgr = np.ascontiguousarray(uint8_colors(frame.layer(name))[..., ::-1])
        return {"form": kind, "type": "image/png", "data": text(cv2.imencode(".png", bgr)[1].tobytes())}
    values = frame.layer(name)
    if kind == "vectors":
        return {"form": kind, **pack(np.rint(127 * np.nan_to_num(values).clip(-1, 1)).astype(np.int8))}
    if kind == "scalar":
        exact = values.astype(np.float32)
        known = exact[np.isfinite(exact) & (exact > 0)]
        ends = np.quantile(known, (0.005, 0.995)).tolist() if known.size else None
        return {"form": kind, "range": ends, **pack(exact)}
    return {"form": kind, **pack(values)}


def pack(values: NDArray[Any]) -> dict[str, Any]:
    """Return an array (H, W) or (H, W, C) of one of the types as plain JSON values; see the module.

    Booleans become ``u1``.
    """
    exact = values.astype(np.uint8) if values.dtype == np.bool_ else values
    size = exact.dtype.itemsize
    if (kind := f"{exact.dtype.kind}{size}") not in _ARRAY_TYPES:
        raise TypeError(f"values: expected one of the types {', '.join(_ARRAY_TYPES)}, got {kind}")
    planar = np.moveaxis(exact if exact.ndim == 3 else exact[..., None], -1, 0)
    whole = np.ascontiguousarray(planar).view(f"<u{size}")
    steps = whole.copy()
    steps[..., 1:] -= whole[..., :-1]
    planes = np.ascontiguousarray(steps.view(np.uint8).reshape(-1, size).T)
    return {"type": kind, "shape": list(planar.shape), "data": text(zlib.compress(planes.tobytes(), _LEVEL))}


def text(data: bytes) -> str:
    """Return bytes as base64."""
    return base64.b64encode(data).decode("ascii")
