"""Sends the server's frames over a connection, and injects the faults of the transport."""

import socket
import struct
from collections.abc import Callable

from mock_server.faults import Fault, Faults
from mock_server.protocol import MAGIC, frame

_PIECES = 50


class Transport:
    """Sends frames with faults. ``wait`` waits for so many seconds; it is true if the server is stopping."""

    def __init__(self, connection: socket.socket, faults: Faults, wait: Callable[[float], bool]) -> None:
        self._connection, self._faults, self._wait = connection, faults, wait

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
        if not self._faults:
            self._connection.sendall(frame(payload))
            return
        if delay := self._faults.strike("delay"):
            self._pause(delay.amount())
        if self._faults.strike("clicked"):
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
        """Return the frame's bytes, with at most one fault: the first of those that strike."""
        whole = frame(payload)
        identity, _, body = payload.partition(b":")  # "error:", where the request had no id either
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
        struck = [fault for name in corrupted if (fault := self._faults.strike(name))]
        return corrupted[struck[0].name](struck[0]) if struck else whole

    def _pause(self, seconds: float) -> None:
        if self._wait(seconds):
            raise ConnectionAbortedError("the server stops")
