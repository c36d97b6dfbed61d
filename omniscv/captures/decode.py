"""From bytes to pixels: the same for live, recorded and imported captures.

Encodings
    ``png``             lit, object_mask: 8-bit PNG, grey, RGB or RGBA; alpha is dropped
    ``png normal``      8-bit PNG of ``0.5 n + 0.5``, n in Unreal's world axes
    ``npy planar cm``   float depth along the optical axis, centimetres (plugin 1.x)
    ``npy ray m``       float distance to the optical centre, metres (plugin 0.3.10)
    ``npy``             pixels as they are: uint8 or float32 colours, planar metres, unit normals
"""

from __future__ import annotations

import io
import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.captures.view import MODES, View
from omniscv.errors import BadReply

_MODES = {
    "png": ("lit", "object_mask"),
    "png normal": ("normal",),
    "npy planar cm": ("depth",),
    "npy ray m": ("depth",),
    "npy": MODES,
}
ENCODINGS = tuple(_MODES)

SKY = 65504.0
"""The largest half float: what servers send where no surface is, in their unit."""

_PNG = b"\x89PNG\r\n\x1a\n"
_NPY = b"\x93NUMPY"
_UNIT_TOLERANCE = 0.1
"""How far from length 1 an 8-bit normal can be and still be one; the sky's grey is near 0."""


def decode(payload: bytes, encoding: str, mode: str, view: View) -> NDArray[Any]:
    """The pixels of a capture.

    Args:
        payload: the bytes as they came.
        encoding: one of ``ENCODINGS``.
        mode: lit, object_mask, depth or normal.
        view: what was captured; the picture must have its size.

    Returns:
        Read-only pixels as :class:`omniscv.captures.view.Capture` describes them.

    Raises:
        BadReply: the bytes are not what the encoding and the view say.
    """
    if mode not in _MODES.get(encoding, ()):
        known = ", ".join(name for name, modes in _MODES.items() if mode in modes)
        raise BadReply(f"encoding of {mode}: expected one of {known}; got {encoding!r}")
    if encoding in ("png", "png normal"):
        pixels: NDArray[Any] = _png(payload, view)
        if encoding == "png normal":
            pixels = _normals(pixels)
    else:
        pixels = _npy(payload, encoding, mode, view)
    pixels.flags.writeable = False
    return pixels


def _png(payload: bytes, view: View) -> NDArray[np.uint8]:
    """RGB; the header is checked before a pixel is decoded, so that no picture is larger than asked."""
    if not payload.startswith(_PNG) or len(payload) < 33:
        raise BadReply(f"expected a PNG, got {_start(payload)}")
    width, height, bits = struct.unpack(">IIB", payload[16:25])
    if (width, height) != (view.width, view.height) or bits != 8:
        raise BadReply(
            f"expected an 8-bit PNG of {view.width} x {view.height}, got {bits}-bit {width} x {height}"
        )
    image = cv2.imdecode(np.frombuffer(payload, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise BadReply(f"expected a PNG, got one that does not decode, {len(payload)} bytes")
    if image.ndim == 2:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB))
    code = cv2.COLOR_BGRA2RGB if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code))


def _normals(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Unit vectors in the world frame; 0 where the colour is no direction."""
    n = rgb.astype(np.float32)
    n *= np.float32(2 / 255)
    n -= 1
    n[..., 1] *= -1  # Unreal's Y points right
    length = np.sqrt(np.einsum("...k,...k->...", n, n))
    known = np.abs(length - 1) < _UNIT_TOLERANCE
    n *= np.divide(1, length, out=np.zeros_like(length), where=known)[..., None]
    return np.asarray(n)


def _npy(payload: bytes, encoding: str, mode: str, view: View) -> NDArray[Any]:
    array = _read_npy(payload, view)
    if encoding == "npy" and mode != "depth":
        if array.shape[2:] != (3,):
            raise BadReply(f"expected three channels, got an array of shape {array.shape}")
        return array
    if array.ndim != 2 or array.dtype.kind != "f":
        raise BadReply(f"expected float depth of shape (H, W), got {array.dtype} of shape {array.shape}")
    if wrong := int(np.count_nonzero(~(array >= 0))):  # NaN is not >= 0
        raise BadReply(f"expected depth of 0 or more, got {wrong} of {array.size} values negative or NaN")
    if encoding == "npy":
        depth = array.astype(np.float32)
    else:
        sky = array >= SKY
        if encoding == "npy planar cm":
            depth = (array / 100).astype(np.float32)
        else:
            depth = (array / view.ray_lengths()).astype(np.float32)
        depth[sky] = np.inf
    return depth


def _read_npy(payload: bytes, view: View) -> NDArray[Any]:
    """An array whose header has the view's size and whose bytes are all there; never a pickle."""
    if not payload.startswith(_NPY):
        raise BadReply(f"expected NPY, got {_start(payload)}")
    stream = io.BytesIO(payload)
    try:
        version = np.lib.format.read_magic(stream)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, fortran, dtype = read(stream)
    except ValueError as cause:
        raise BadReply(f"expected NPY, got a header that does not parse: {cause}") from cause
    if shape[:2] != (view.height, view.width) or len(shape) > 3 or fortran or dtype.kind not in "fu":
        raise BadReply(f"expected NPY of {view.height} rows, {view.width} columns, got {dtype} {shape}")
    count = int(np.prod(shape))
    if len(payload) - stream.tell() != count * dtype.itemsize:
        raise BadReply(
            f"expected {count * dtype.itemsize} bytes of pixels, got {len(payload) - stream.tell()}"
        )
    return np.frombuffer(payload, dtype=dtype, offset=stream.tell()).reshape(shape).copy()


def _start(payload: bytes | str) -> str:
    if isinstance(payload, str):
        payload = payload.encode()
    return f"{len(payload)} bytes that start with {payload[:24]!r}"
