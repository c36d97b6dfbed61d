"""Encodings of plugins on the wire, as decoders of :mod:`omniscv.sources.codecs`.

``png normal``      8-bit PNG of ``0.5 n + 0.5``, n in Unreal's world axes
``npy planar cm``   float depth along the optical axis, centimetres (plugin 1.x)
``npy ray m``       float distance to the optical centre, metres (plugin 0.3.10)
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry.surfaces import Precision
from omniscv.geometry.unreal_frame import direction_from_unreal
from omniscv.sources import codecs
from omniscv.sources.base import View

SKY = 65504.0  # the largest half float: what servers send for no surface, in their unit
_HALF_DIGITS = 11  # significant binary digits of the half floats through which the engine passes depth
_UNIT_TOLERANCE = 0.1  # how far the length of an 8-bit normal may be from 1; the sky's grey is near 0


def _normals(payload: bytes, mode: str, view: View) -> NDArray[np.float32]:
    """Return unit vectors (H, W, 3) in the world frame; 0 where the colour is no direction."""
    n = codecs.decode_png(payload, view).astype(np.float32)
    n *= np.float32(2 / 255)
    n -= 1
    direction_from_unreal(n)
    length = np.sqrt(np.einsum("...k,...k->...", n, n))
    known = np.abs(length - 1) < _UNIT_TOLERANCE
    n *= np.divide(1, length, out=np.zeros_like(length), where=known)[..., None]
    return np.asarray(n)


def _depth_by(divisor: Callable[[View], Any]) -> codecs.Decoder:
    """Return the decoder of depth that is divided to become planar metres."""

    def decode(payload: bytes, mode: str, view: View) -> NDArray[np.float32]:
        array = codecs.decode_npy(payload, view)
        codecs.check_depth(array)
        depth = np.asarray(array / divisor(view), dtype=np.float32)
        np.copyto(depth, np.inf, where=array >= SKY)
        return depth

    return decode


codecs.register("png normal", _normals, ("normals",))
_PLANAR_CM = Precision(0.01, _HALF_DIGITS, along_ray=False, largest_m=SKY / 100)
_RAY_M = Precision(1.0, _HALF_DIGITS, along_ray=True, largest_m=SKY)
codecs.register("npy planar cm", _depth_by(lambda view: 100), ("depth",), _PLANAR_CM)
codecs.register("npy ray m", _depth_by(View.ray_lengths), ("depth",), _RAY_M)
