"""Frames as they come in, checked before a byte of their payload is kept.

A frame is magic and payload size, uint32 little endian, then the payload (protocol reference, section 1.1).
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from omniscv.errors import BadReply

MAGIC = 0x9E2B83C1
MAX_PAYLOAD = 1 << 30
"""Bytes. More than four times the depth of an 8192 x 8192 picture: no reply is larger."""

_HEADER = struct.Struct("<II")
_BLOCK = 1 << 20


def read_frame(receive: Callable[[int], bytes]) -> bytes:
    """The next frame's payload.

    Args:
        receive: as ``socket.recv``: at most so many bytes, none at the end of the stream.

    Raises:
        BadReply: wrong magic, an empty payload, or one larger than ``MAX_PAYLOAD``.
        ConnectionError: the stream ends before the frame does.
    """
    magic, size = _HEADER.unpack(_read_exactly(receive, _HEADER.size))
    if magic != MAGIC:
        raise BadReply(f"expected a frame with magic {MAGIC:#x}, got {magic:#x}: the stream is out of step")
    if not 0 < size <= MAX_PAYLOAD:
        raise BadReply(f"expected a frame of 1 to {MAX_PAYLOAD} bytes, got one that claims {size}")
    return _read_exactly(receive, size)


def _read_exactly(receive: Callable[[int], bytes], size: int) -> bytes:
    """Memory grows with what comes, not with what the header claims."""
    blocks = []
    missing = size
    while missing:
        block = receive(min(_BLOCK, missing))
        if not block:
            raise ConnectionError(f"the stream ended {missing} bytes before its frame did")
        blocks.append(block)
        missing -= len(block)
    return b"".join(blocks)
