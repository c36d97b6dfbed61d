"""The way from server to client, and what can go wrong on it."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable

from mock_server.faults import Faults
from mock_server.protocol import MAGIC, frame

_PIECES = 50
_HUGE = 0xFFFF_FFFF
_SPOILS_FRAME = ("missing", "zero-size", "huge", "bad-magic", "cut", "wrong-id", "no-id")


class Hangup(OSError):
    """The server ends the connection."""


class Line:
    """Sends frames over a connection, spoiled as told.

    Args:
        connection: a connected socket.
        faults: what goes wrong.
        wait: waits so many seconds; true if the server is to stop.
    """

    def __init__(self, connection: socket.socket, faults: Faults, wait: Callable[[float], bool]) -> None:
        self._connection, self._faults, self._wait = connection, faults, wait

    def greet(self, text: str) -> None:
        """The frame that tells a client that it is served."""
        busy = self._faults.strike("second-client")
        if busy is not None:
            self._pause(busy.amount())
        if self._faults.strike("no-greeting") is None:
            self._connection.sendall(frame(text.encode()))

    def send(self, payload: bytes) -> None:
        """A reply, ``id:body``.

        Raises:
            Hangup: the connection is to be closed now.
            OSError: the client has left.
        """
        if not self._faults:
            self._connection.sendall(frame(payload))
            return
        delay = self._faults.strike("delay")
        if delay is not None:
            self._pause(delay.amount())
        if self._faults.strike("clicked"):
            self._connection.sendall(frame(b"clicked"))
        if self._faults.strike("reset"):
            self._reset(payload)
        data = self._spoiled(payload)
        drip = self._faults.strike("drip")
        if drip is None:
            self._connection.sendall(data)
        else:
            self._drip(data, drip.amount())

    def _spoiled(self, payload: bytes) -> bytes:
        """The frame's bytes, with at most one thing wrong."""
        struck = [fault for name in _SPOILS_FRAME if (fault := self._faults.strike(name))]
        name = struck[0].name if struck else ""
        identity, _, body = payload.partition(b":")  # "error:", where the request had no id either
        if name == "missing":
            return b""
        if name == "zero-size":
            return frame(b"")
        if name == "huge":
            return struct.pack("<II", MAGIC, _HUGE) + payload
        if name == "bad-magic":
            return struct.pack("<I", MAGIC ^ 1) + frame(payload)[4:]
        if name == "wrong-id" and identity.isdigit():
            return frame(b"%d:%b" % (int(identity) + 1, body))
        if name == "no-id":
            return frame(body)
        if name == "cut":
            return frame(payload)[: 8 + int(len(payload) * struck[0].amount())]
        return frame(payload)

    def _drip(self, data: bytes, seconds: float) -> None:
        size = max(1, len(data) // _PIECES)
        pieces = [data[start : start + size] for start in range(0, len(data), size)]
        for piece in pieces:
            self._pause(seconds / len(pieces))
            self._connection.sendall(piece)

    def _reset(self, payload: bytes) -> None:
        """Half a frame, then RST instead of FIN."""
        data = frame(payload)
        self._connection.sendall(data[: len(data) // 2])
        self._connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        raise Hangup("reset")

    def _pause(self, seconds: float) -> None:
        if self._wait(seconds):
            raise Hangup("the server stops")
