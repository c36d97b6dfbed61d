"""NPY of numbers. Nothing is unpickled, and NumPy's own reader, which evaluates literals, is not used."""

import io
import math
import re
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.errors import BadReplyError

SIGNATURE = b"\x93NUMPY"
HEADER_BYTES = 1 << 10
"""Of an NPY, which hold its shape; NumPy writes 128."""

_HEADER = re.compile(
    rb"\{'descr': '([<>|=](?:f[248]|[iu][1248]|b1))', 'fortran_order': (False|True), "
    rb"'shape': \((\d{1,9}(?:, \d{1,9}){1,2}),?\),? *\}\s*"
)


def layout(payload: bytes) -> tuple[tuple[int, ...], np.dtype[Any], int, Literal["C", "F"]]:
    """Return shape, dtype, the offset of the pixels, of which none need be there, and their order.

    Raises:
        BadReplyError: no NPY of numbers.
    """
    if not payload.startswith(SIGNATURE):
        beginning = f"{len(payload)} bytes that start with {bytes(payload[:24])!r}"
        raise BadReplyError(f"expected NPY, got {beginning}")
    start = 10 if payload[6:7] == b"\x01" else 12  # behind the length of the header
    end = start + int.from_bytes(payload[8:start], "little")
    header = payload[start : min(end, HEADER_BYTES + 1)]
    match = _HEADER.fullmatch(header) if end <= HEADER_BYTES else None
    if match is None:
        raise BadReplyError(f"expected NPY of numbers, got the header {shown(header[:120])}")
    order: Literal["C", "F"] = "F" if match[2] == b"True" else "C"
    return tuple(map(int, match[3].split(b", "))), np.dtype(match[1].decode()), end, order


def decode(payload: bytes) -> NDArray[Any]:
    """Return the payload as a read-only array."""
    shape, dtype, start, order = layout(payload)
    size = math.prod(shape) * dtype.itemsize
    if len(payload) - start != size:
        raise BadReplyError(f"expected {size} bytes of pixels, got {len(payload) - start}")
    return np.frombuffer(payload, dtype=dtype, offset=start).reshape(shape, order=order)


def encode(pixels: NDArray[Any]) -> bytes:
    """Return an array as the bytes of a file."""
    buffer = io.BytesIO()
    np.save(buffer, np.ascontiguousarray(pixels), allow_pickle=False)
    return buffer.getvalue()
