"""Readers of replies, which check the numbers and names that a server sends."""

import math
from contextlib import suppress

from omniscv.arguments import shown
from omniscv.errors import BadReplyError
from omniscv.sources.codecs import picture_size

Reply = str | bytes
"""Bytes where the reply is not UTF-8."""

MAX_NAMES = 65_535
"""Of objects, or cameras: labels are uint16, and 0 is the label of no object."""

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
            size = ", {} x {} px".format(*picture_size(reply))
    return f"{form}, {len(reply)} bytes{size}"
