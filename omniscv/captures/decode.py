"""From bytes to pixels: the same for live, recorded and imported captures.

Encodings
    ``png``             lit, object_mask: 8-bit PNG, grey, RGB or RGBA; alpha is dropped
    ``png normal``      8-bit PNG of ``0.5 n + 0.5``, n in Unreal's world axes
    ``npy planar cm``   float depth along the optical axis, centimetres (plugin 1.x)
    ``npy ray m``       float distance to the optical centre, metres (plugin 0.3.10)
    ``npy``             pixels as they are: uint8 or float32 colours, planar metres, unit normals
"""

from __future__ import annotations

import math
import re
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
_NPY_HEADER = re.compile(
    rb"\{'descr': '([<>|=](?:f[248]|u[1248]))', 'fortran_order': False, "
    rb"'shape': \((\d{1,9}(?:, \d{1,9}){1,2}),?\),? *\}\s*"
)
"""As every writer writes it. NumPy's own reader takes any Python literal, and trips over some."""
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
    if not _chunks_fit(payload):
        raise BadReply(f"expected a PNG, got one whose chunks do not add up to its {len(payload)} bytes")
    image = cv2.imdecode(np.frombuffer(payload, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise BadReply(f"expected a PNG, got one that does not decode, {len(payload)} bytes")
    if image.ndim == 2:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB))
    code = cv2.COLOR_BGRA2RGB if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code))


def _chunks_fit(payload: bytes) -> bool:
    """Whether the chunks end where the bytes do. OpenCV makes room for what a chunk claims, up to 4 GB."""
    at, kind = len(_PNG), b""
    while kind != b"IEND" and at + 12 <= len(payload):
        length, kind = struct.unpack_from(">I4s", payload, at)
        at += 12 + length
    return at == len(payload)


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
        return array.copy()
    if array.ndim != 2 or array.dtype.kind != "f":
        raise BadReply(f"expected float depth of shape (H, W), got {array.dtype} of shape {array.shape}")
    if not array.min() >= 0:  # NaN is not >= 0
        wrong = np.count_nonzero(~(array >= 0))
        raise BadReply(f"expected depth of 0 or more, got {wrong} of {array.size} values negative or NaN")
    if encoding == "npy":
        return array.astype(np.float32)
    if encoding == "npy planar cm":
        depth: NDArray[Any] = np.divide(array, 100, dtype=np.float32)
    else:
        depth = (array / view.ray_lengths()).astype(np.float32)
    np.copyto(depth, np.inf, where=array >= SKY)
    return depth


def _read_npy(payload: bytes, view: View) -> NDArray[Any]:
    """The payload's bytes as an array of the view's size; all are there; never a pickle."""
    if not payload.startswith(_NPY):
        raise BadReply(f"expected NPY, got {_start(payload)}")
    header, start = _npy_header(payload)
    found = _NPY_HEADER.fullmatch(header)
    if found is None:
        raise BadReply(f"expected NPY of numbers in C order, got the header {header[:120]!r}")
    dtype, shape = np.dtype(found[1].decode()), tuple(map(int, found[2].split(b", ")))
    if shape[:2] != (view.height, view.width):
        raise BadReply(f"expected NPY of {view.height} rows, {view.width} columns, got {dtype} {shape}")
    size = math.prod(shape) * dtype.itemsize
    if len(payload) - start != size:
        raise BadReply(f"expected {size} bytes of pixels, got {len(payload) - start}")
    return np.frombuffer(payload, dtype=dtype, offset=start).reshape(shape)


def _npy_header(payload: bytes) -> tuple[bytes, int]:
    """The text of the header, and where the pixels start."""
    form = "<H" if payload[6:7] == b"\x01" else "<I"
    start = 8 + struct.calcsize(form)
    if len(payload) < start:
        raise BadReply(f"expected NPY, got {_start(payload)}")
    end = start + struct.unpack_from(form, payload, 8)[0]
    return payload[start:end], end


def _start(payload: bytes | str) -> str:
    if isinstance(payload, str):
        payload = payload.encode()
    return f"{len(payload)} bytes that start with {payload[:24]!r}"
