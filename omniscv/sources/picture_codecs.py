"""Depth and masks as other tools write them: recordings keep their bytes, and decode them when they replay.

=================== ==================================================================================
``png float32``     TartanAir: a little-endian float32 in the bytes B G R A of a pixel, planar metres;
                    10,000 m and more are no surface
``png carla``       CARLA: 24 bits of 1000 m, R lowest, planar
``png uint16 N``    planar metres times N, N as :data:`codecs.PICTURES` has; 0 is no surface
``pfm planar``      AirSim: float32 metres, the first row of the file at the top
``pfm ray``         the same, along the ray
``png ids``         masks: ids of objects or classes, grey, 8 or 16 bits
=================== ==================================================================================
"""

import re
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import BadReplyError
from omniscv.geometry.surfaces import Precision
from omniscv.sources import codecs
from omniscv.sources.base import View

_FAR_M = 10_000.0
_CARLA_M = 1000 / (2**24 - 1)
_PFM = re.compile(rb"Pf\s+(\d{1,5})\s+(\d{1,5})\s+(-?[0-9.eE+-]{1,20})\s")


def _png(payload: bytes, view: View, dtype: str, channels: tuple[int, ...]) -> NDArray[Any]:
    """(H, W) or (H, W, C) of a PNG of the view's size, as stored, blue first."""
    import cv2

    codecs.check_png(payload, view)
    pixels = cv2.imdecode(np.frombuffer(payload, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.dtype != dtype or (pixels.shape[2:] or (1,))[0] not in channels:
        got = "damage" if pixels is None else f"{pixels.dtype} of shape {pixels.shape}"
        raise BadReplyError(f"expected a PNG of {dtype} with {channels} channels, got {got}")
    return np.asarray(pixels)


def _float32(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    depth = _png(payload, view, "uint8", (4,)).copy().view("<f4")[..., 0]
    codecs.check_depth(depth)
    return np.where(depth >= _FAR_M, np.inf, depth).astype(np.float32)


def _carla(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    colors = _png(payload, view, "uint8", (3, 4))[..., 2::-1]
    return np.asarray(colors @ np.array([1.0, 256.0, 65536.0]) * _CARLA_M, np.float32)


def _uint16(scale: float, payload: bytes, mode: str, view: View) -> NDArray[Any]:
    stored = _png(payload, view, "uint16", (1,))
    return np.where(stored == 0, np.inf, stored / scale).astype(np.float32)


def _ids(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    pixels = _png(payload, view, "uint16" if payload[24:25] == b"\x10" else "uint8", (1, 3))
    if pixels.ndim == 3 and (pixels != pixels[..., :1]).any():
        raise BadReplyError("expected a grey PNG of ids, got colours")
    return np.asarray(pixels if pixels.ndim == 2 else pixels[..., 0], np.uint16)


def _pfm(ray: bool, payload: bytes, mode: str, view: View) -> NDArray[Any]:
    header = _PFM.match(payload)
    if header is None or (int(header[1]), int(header[2])) != (view.width, view.height):
        raise BadReplyError(f"expected a PFM of {view.width} x {view.height}, got {payload[:30]!r}")
    order = "<f4" if header[3].startswith(b"-") else ">f4"
    if len(payload) - header.end() != 4 * view.width * view.height:
        raise BadReplyError(f"expected {4 * view.width * view.height} bytes of pixels in a PFM")
    depth = np.frombuffer(payload, order, offset=header.end()).reshape(view.height, view.width)
    codecs.check_depth(depth)
    return np.asarray(depth / (view.ray_lengths() if ray else 1), np.float32)


codecs.register("png float32", _float32, ("depth",))
codecs.register("png carla", _carla, ("depth",))
codecs.register("png ids", _ids, ("object_mask",))
codecs.register("pfm planar", partial(_pfm, False), ("depth",))
codecs.register("pfm ray", partial(_pfm, True), ("depth",), Precision(along_ray=True))
for _encoding in codecs.PICTURES:
    if _encoding.startswith("png uint16 "):
        codecs.register(_encoding, partial(_uint16, float(_encoding.split()[-1])), ("depth",))
