"""UnrealCV's frames on a connection, and the faults of the transport.

A frame is magic and payload size, uint32 little endian, then the payload. A request is ``id:command``,
a reply ``id:body``.
"""

import socket
import struct
from collections.abc import Callable

from mock_server.faults import Fault, Faults

MAGIC = 0x9E2B83C1
MAX_PAYLOAD = 1 << 24
"""The most bytes of a request; dialect N2 allows sixteen times as many, the others any number."""

_HEADER = struct.Struct("<II")
_BLOCK = 1 << 16
_PIECES = 50
_INT32 = 1 << 31
_INT64_DIGITS = 18


class FrameError(Exception):
    """A wrong header: the connection is dropped."""


def frame(payload: bytes) -> bytes:
    """Return a payload with its header."""
    return _HEADER.pack(MAGIC, len(payload)) + payload


Wait = Callable[[bool], None]
"""Returns when bytes can be read; it is told whether a frame has begun, and may raise FrameError."""


def read_frame(connection: socket.socket, wait: Wait = lambda begun: None) -> bytes | None:
    """Return the next payload; None at the end of the stream.

    Args:
        connection: from a client.
        wait: called before each read.

    Raises:
        FrameError: wrong magic, no payload, or one larger than ``MAX_PAYLOAD``; or of ``wait``.
    """
    header = _read_exactly(connection, _HEADER.size, wait, False)
    if header is None:
        return None
    magic, size = _HEADER.unpack(header)
    if magic != MAGIC or not 0 < size <= MAX_PAYLOAD:
        raise FrameError(f"header: expected {MAGIC:#x}, 1 to {MAX_PAYLOAD}; got {magic:#x}, {size}")
    return _read_exactly(connection, size, wait, True)


def _read_exactly(connection: socket.socket, size: int, wait: Wait, begun: bool) -> bytes | None:
    """Return so many bytes; memory grows with the bytes received, not with the header's size."""
    data = bytearray()
    while len(data) < size:
        wait(begun or bool(data))
        block = connection.recv(min(_BLOCK, size - len(data)))
        if not block:
            return None
        data += block
    return bytes(data)


def to_int32(digits: str) -> int:
    """Return a request's id as the plugin reads it: the last 32 bits of C's saturated long."""
    value = int(digits) if len(digits) <= _INT64_DIGITS else -1
    return (value + _INT32) % (2 * _INT32) - _INT32


class Transport:
    """Sends frames with faults. ``wait(seconds)`` returns True if the server is stopping."""

    def __init__(self, connection: socket.socket, faults: Faults, wait: Callable[[float], bool]) -> None:
        self._connection = connection
        self._faults = faults
        self._wait = wait

    def greet(self, text: str) -> None:
        """Send the greeting, a frame without an id."""
        if busy := self._faults.strike("second-client"):
            self._pause(busy.amount())
        if self._faults.strike("no-greeting") is None:
            self._connection.sendall(frame(text.encode()))

    def send(self, payload: bytes) -> None:
        """Send a reply, ``id:body``.

        Raises:
            OSError: the client has left, or a fault closes the connection.
        """
        if delay := self._faults.strike("delay"):
            self._pause(delay.amount())
        if (click := self._faults.strike("clicked")) and not click.amount():
            self._connection.sendall(frame(b"clicked"))
        if self._faults.strike("reset"):
            self._connection.sendall(frame(payload)[: (8 + len(payload)) // 2])
            # The connection ends by RST instead of FIN.
            self._connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            raise ConnectionAbortedError("reset")
        data = self._corrupted(payload)
        drip = self._faults.strike("drip")
        size = max(1, len(data) // _PIECES) if drip else len(data) or 1
        pieces = [data[start : start + size] for start in range(0, len(data), size)]
        for piece in pieces:
            if drip:
                self._pause(drip.amount() / len(pieces))
            self._connection.sendall(piece)

    def _corrupted(self, payload: bytes) -> bytes:
        """Return the frame's bytes with at most one fault, the first that is drawn."""
        whole = frame(payload)
        identity, _, body = payload.partition(b":")  # "error:" if the request had no id either
        corrupted: dict[str, Callable[[Fault], bytes]] = {
            "missing": lambda _: b"",
            "zero-size": lambda _: frame(b""),
            "huge": lambda _: struct.pack("<II", MAGIC, 0xFFFF_FFFF) + payload,
            "bad-magic": lambda _: struct.pack("<I", MAGIC ^ 1) + whole[4:],
            "cut": lambda fault: whole[: 8 + int(len(payload) * fault.amount())],
            "wrong-id": lambda _: (
                frame(b"%d:%b" % (int(identity) + 1, body)) if identity.isdigit() else whole
            ),
            "no-id": lambda _: frame(body),
        }
        drawn = [self._faults.strike(name) for name in corrupted]  # all: each draws from its own generator
        for fault in drawn:
            if fault is not None:
                return corrupted[fault.name](fault)
        return whole

    def _pause(self, seconds: float) -> None:
        if self._wait(seconds):
            raise ConnectionAbortedError("the server stops")
