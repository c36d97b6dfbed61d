"""UnrealCV's frames, and how commands match templates.

A frame is magic and payload size, uint32 little endian, then the payload. A request is ``id:command``,
a reply ``id:body``.
"""

from __future__ import annotations

import re
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

MAGIC = 0x9E2B83C1
MAX_PAYLOAD = 268_435_456
"""Bytes. What one dialect of the server enforces; here for all, so that no frame can ask for more."""

_HEADER = struct.Struct("<II")
_BLOCK = 1 << 16


class BadFrame(Exception):
    """A header that no client would send: the connection is dropped."""


def frame(payload: bytes) -> bytes:
    """A payload with its header."""
    return _HEADER.pack(MAGIC, len(payload)) + payload


def read_frame(connection: socket.socket) -> bytes | None:
    """The next payload; None at the end of the stream.

    Raises:
        BadFrame: wrong magic, no payload, or one larger than ``MAX_PAYLOAD``.
    """
    header = _read_exactly(connection, _HEADER.size)
    if header is None:
        return None
    magic, size = _HEADER.unpack(header)
    if magic != MAGIC or not 0 < size <= MAX_PAYLOAD:
        raise BadFrame(f"magic {magic:#x}, size {size}")
    return _read_exactly(connection, size)


def _read_exactly(connection: socket.socket, size: int) -> bytes | None:
    """Memory grows with what comes, not with what the header claims."""
    data = bytearray()
    while len(data) < size:
        block = connection.recv(min(_BLOCK, size - len(data)))
        if not block:
            return None
        data += block
    return bytes(data)


_INT32 = 1 << 31
_INT64_DIGITS = 18


def to_int32(digits: str) -> int:
    """A request's id as the plugin reads it: the last 32 bits of C's saturated long."""
    value = int(digits) if len(digits) <= _INT64_DIGITS else -1
    return (value + _INT32) % (2 * _INT32) - _INT32


def _uint(digits: str) -> int:
    """A count or index; 0 for no digits, and never so large that it is costly."""
    return int(digits or 0) if len(digits) < len(str(_INT32)) else _INT32 - 1


_EDGE = 1e9
"""cm, or degrees. Beyond it is no world; nearer, no arithmetic overflows."""

_PLACEHOLDERS: dict[str, tuple[str, Callable[[str], Any]]] = {
    "[str]": (r"(\S*)", str),
    "[uint]": (r"(\d*)", _uint),
    "[float]": (r"([-+]?\d*\.?\d+)", lambda text: min(max(float(text), -_EDGE), _EDGE)),
}


@dataclass(frozen=True)
class Command:
    """A template with its pattern: unanchored at the start, to the end but for spaces, case-sensitive."""

    template: str
    description: str
    handler: Callable[..., Any]
    pattern: re.Pattern[str]
    converters: tuple[Callable[[str], Any], ...]

    def match(self, text: str) -> tuple[Any, ...] | None:
        """The arguments in ``text``, or None."""
        found = self.pattern.search(text)
        if found is None:
            return None
        return tuple(convert(value) for convert, value in zip(self.converters, found.groups(), strict=True))


def command(template: str, description: str, handler: Callable[..., Any]) -> Command:
    """Compiles a template such as ``vset /camera/[uint]/fov [float]``."""
    converters: list[Callable[[str], Any]] = []
    pattern = ""
    for part in re.split(r"(\[(?:str|uint|float)\])", template):
        if part in _PLACEHOLDERS:
            expression, convert = _PLACEHOLDERS[part]
            pattern += expression
            converters.append(convert)
        else:
            pattern += re.escape(part)
    return Command(template, description, handler, re.compile(pattern + r" *\Z", re.ASCII), tuple(converters))
