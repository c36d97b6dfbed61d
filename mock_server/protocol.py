"""UnrealCV's frames, and how commands match templates.

A frame is magic and payload size, uint32 little endian, then the payload. A request is ``id:command``,
a reply ``id:body``.
"""

import re
import socket
import struct
from collections.abc import Callable
from typing import Any

MAGIC = 0x9E2B83C1
MAX_PAYLOAD = 1 << 24
"""Bytes of a request; dialect N2 of the plugin allows sixteen times as many, the others any number."""

_HEADER = struct.Struct("<II")
_BLOCK = 1 << 16
_INT32 = 1 << 31
_INT64_DIGITS = 18

_LIMIT = 1e9
"""cm, or degrees: larger numbers are clipped to it, so that no arithmetic overflows."""


class FrameError(Exception):
    """A header that no client would send: the connection is dropped."""


def frame(payload: bytes) -> bytes:
    """Return a payload with its header."""
    return _HEADER.pack(MAGIC, len(payload)) + payload


def read_frame(connection: socket.socket) -> bytes | None:
    """Return the next payload; None at the end of the stream.

    Raises:
        FrameError: wrong magic, no payload, or one larger than ``MAX_PAYLOAD``.
    """
    header = _read_exactly(connection, _HEADER.size)
    if header is None:
        return None
    magic, size = _HEADER.unpack(header)
    if magic != MAGIC or not 0 < size <= MAX_PAYLOAD:
        raise FrameError(f"header: expected {MAGIC:#x}, 1 to {MAX_PAYLOAD}; got {magic:#x}, {size}")
    return _read_exactly(connection, size)


def _read_exactly(connection: socket.socket, size: int) -> bytes | None:
    """Return so many bytes; memory grows with what is received, not with what the header claims."""
    data = bytearray()
    while len(data) < size:
        block = connection.recv(min(_BLOCK, size - len(data)))
        if not block:
            return None
        data += block
    return bytes(data)


def to_int32(digits: str) -> int:
    """Return a request's id as the plugin reads it: the last 32 bits of C's saturated long."""
    value = int(digits) if len(digits) <= _INT64_DIGITS else -1
    return (value + _INT32) % (2 * _INT32) - _INT32


def _uint(digits: str) -> int:
    """Return a count or index; 0 for no digits, and at most 2^31 - 1."""
    return int(digits or 0) if len(digits) < len(str(_INT32)) else _INT32 - 1


_PLACEHOLDERS: dict[str, tuple[str, Callable[[str], Any]]] = {
    "[str]": (r"(\S*)", str),
    "[uint]": (r"(\d*)", _uint),
    "[float]": (r"([-+]?(?:\d*\.)?\d+)", lambda text: min(max(float(text), -_LIMIT), _LIMIT)),
}


class Command:
    """A template such as ``vset /camera/[uint]/fov [float]`` and its handler.

    Matching is unanchored at the start, to the end but for spaces, and case-sensitive. It takes a time in
    proportion to the text's length: no two neighbours in a pattern accept the same characters.
    """

    def __init__(self, template: str, description: str, handler: Callable[..., Any]) -> None:
        self.template, self.description, self.handler = template, description, handler
        parts = re.split(r"(\[(?:str|uint|float)\])", template)
        self._converters = [_PLACEHOLDERS[part][1] for part in parts[1::2]]
        patterns = (_PLACEHOLDERS[part][0] if part in _PLACEHOLDERS else re.escape(part) for part in parts)
        self._pattern = re.compile("".join(patterns) + r" *\Z", re.ASCII)
        self._literals = [part for part in parts[::2] if part]

    def match(self, text: str) -> tuple[Any, ...] | None:
        """Return the arguments in ``text``; None if it does not match."""
        if not all(literal in text for literal in self._literals):  # much faster where the text is long
            return None
        found = self._pattern.search(text)
        if found is None:
            return None
        return tuple(convert(value) for convert, value in zip(self._converters, found.groups(), strict=True))
