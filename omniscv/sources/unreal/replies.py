"""Readers of replies, which check the numbers and names that a server sends, and decoders of its pictures.

Encodings, decoded by :mod:`omniscv.sources.codecs`, for recordings too:

``png normal``      8-bit PNG of ``0.5 n + 0.5``, n in Unreal's world axes
``npy normal``      the same as NPY, of shared memory
``npy planar cm``   float depth along the optical axis, centimetres (plugin 1.x)
``npy ray m``       float distance to the optical centre, metres (plugin 0.3.10)
"""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.errors import BadReplyError
from omniscv.geometry.surfaces import Precision
from omniscv.geometry.unreal_frame import direction_from_unreal
from omniscv.sources import codecs
from omniscv.sources.base import View

Reply = str | bytes
"""Bytes where the reply is not UTF-8."""

MAX_NAMES = 65_535
"""Of objects, or cameras: labels are uint16, and 0 is the label of no object."""

SKY = 65504.0  # the largest half float: what servers send for no surface, in their unit
_HALF_DIGITS = 11  # significant binary digits of the half floats through which the engine passes depth
_UNIT_TOLERANCE = 0.1  # how far the length of an 8-bit normal may be from 1; the sky's grey is near 0
_MAX_NAME = 1024  # characters, as in the engine
_MAX_NUMBER = 1e9  # cm, or degrees
_MAX_NUMBERS = 1000  # characters of all


def numbers(reply: Reply, count: int) -> list[float]:
    """Return the numbers, separated by spaces, of a reply; BadReplyError if not ``count``, up to 1e9 each."""
    try:
        values = [float(word) for word in reply[:_MAX_NUMBERS].split()]
    except ValueError:
        values = []
    small = all(math.isfinite(value) and abs(value) <= _MAX_NUMBER for value in values)
    if len(reply) > _MAX_NUMBERS or len(values) != count or not small:
        raise BadReplyError(f"expected {count} numbers of at most {_MAX_NUMBER:g}, got {shown(reply[:100])}")
    return values


def fov(reply: Reply) -> float:
    """Return the field of view of a reply, degrees; BadReplyError unless it is between 0 and 180."""
    (value,) = numbers(reply, 1)
    if not 0 < value < 180:
        raise BadReplyError(f"expected a field of view between 0 and 180 degrees, got {shown(reply)}")
    return value


def name(reply: str) -> str:
    """Return a reply that is one line of printable characters; BadReplyError otherwise."""
    if not 0 < len(reply) <= _MAX_NAME or not reply.isprintable():
        raise BadReplyError(f"expected a name of at most {_MAX_NAME} characters, got {shown(reply)}")
    return reply


def names(reply: str) -> list[str]:
    """Return the names, separated by spaces, of a reply; BadReplyError for too many or invalid ones."""
    words = [] if reply == "ok" else reply.split(maxsplit=MAX_NAMES)  # servers send ok for an empty text
    if len(words) > MAX_NAMES:
        raise BadReplyError(f"expected at most {MAX_NAMES} names, got more: {shown(reply[:100])}")
    return [name(word) for word in words]


def described(reply: Reply) -> str:
    """Return a reply that is text; the size and format of a binary one."""
    if isinstance(reply, str):
        return reply
    formats = {b"\x89PNG": "PNG", b"\x93NUM": "NPY", b"BM": "BMP"}
    form = next((name for start, name in formats.items() if reply.startswith(start)), "binary")
    size = ""
    if form in ("PNG", "NPY"):
        with suppress(BadReplyError):
            size = ", {} x {} px".format(*codecs.picture_size(reply))
    return f"{form}, {len(reply)} bytes{size}"


def bmp_colors(reply: Reply, width: int, height: int) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of a BMP of 32 bits; BadReplyError for another size.

    Open plugins repeat the byte count behind a header of 54 bytes, Dev builds do not. The pixels come last.
    """
    count = 4 * width * height
    if not isinstance(reply, bytes) or not reply.startswith(b"BM") or len(reply) - count not in (54, 58):
        raise BadReplyError(f"expected a BMP of {width} x {height}, got {shown(reply[:100])}")
    return np.frombuffer(reply[-count:], np.uint8).reshape(height, width, 4)[..., 2::-1]


def _codes(payload: bytes, view: View) -> NDArray[np.uint8]:
    """Return the colours (H, W, 3) of a picture, PNG or NPY."""
    if payload.startswith(b"\x89PNG"):
        return codecs.decode_png(payload, view)
    codes = codecs.decode_npy(payload, view)
    if codes.dtype != np.uint8 or codes.shape[2:] != (3,):
        raise BadReplyError(f"expected NPY of 8-bit colours, got {codes.dtype} {codes.shape}")
    return codes


def shows_light(payload: bytes, view: View) -> bool:
    """Return whether a picture of normals is the lit image; see :func:`are_light`."""
    return are_light(_codes(payload, view))


def are_light(codes: NDArray[np.uint8]) -> bool:
    """Return whether colours (H, W, 3) of normals are the lit image's, as of branch 5.2 before 2026-03-11.

    Most of them are no directions, and not the grey of the sky either.
    """
    n = codes * (2 / 255) - 1
    length = np.sqrt(np.einsum("...k,...k->...", n, n))
    return bool(((np.abs(length - 1) >= _UNIT_TOLERANCE) & (length >= _UNIT_TOLERANCE)).mean() > 0.5)


def _normals(payload: bytes, mode: str, view: View) -> NDArray[np.float32]:
    """Return unit vectors (H, W, 3) in the world frame; 0 where the colour is no direction."""
    n = _codes(payload, view).astype(np.float32)
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
codecs.register("npy normal", _normals, ("normals",))
_PLANAR_CM = Precision(0.01, _HALF_DIGITS, along_ray=False, largest_m=SKY / 100)
_RAY_M = Precision(1.0, _HALF_DIGITS, along_ray=True, largest_m=SKY)
codecs.register("npy planar cm", _depth_by(lambda view: 100), ("depth",), _PLANAR_CM)
codecs.register("npy ray m", _depth_by(View.ray_lengths), ("depth",), _RAY_M)
