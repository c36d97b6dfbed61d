"""The official client, made fit for servers that fail.

Its own ``connect`` and ``request`` wait for ever in several places, and read frames of any size (protocol
reference, sections 6.2 and 6.3). Here it connects, sends and receives under deadlines, checks frames, and
hands every fault of its receiving thread to the caller. Framing, ids and text stay its own.
"""

from __future__ import annotations

import logging
import secrets
import socket
import threading
import time
from collections.abc import Iterator, Sequence

import unrealcv

from omniscv.captures.unreal.frames import read_frame
from omniscv.errors import BadReply

logging.getLogger("unrealcv").setLevel(logging.CRITICAL)  # its faults come back as our errors
unrealcv.print = lambda *_: None  # the module's own name, not the builtin

_FIRST_IDS = 90_000_000
"""Ids have up to 8 digits; a session has room for ten million requests."""
_CLICK = b"clicked"
"""What plugin 0.3.10 sends at a mouse click in the game's window: no reply to anything."""


class Client(unrealcv.Client):  # type: ignore[misc]
    """A client of one connection.

    Ids start at random, so that no reply to an earlier client, which servers send to the next, fits.

    Args:
        endpoint: (host, port), or the path of a Unix socket.
        timeout_s: how long connecting with the greeting, sending a request, and each reply may take.
    """

    def __init__(self, endpoint: tuple[str, int] | str, timeout_s: float) -> None:
        super().__init__(endpoint, "unix" if isinstance(endpoint, str) else "inet")
        self._timeout_s = timeout_s
        self.send_message_id = self.recv_message_id = secrets.randbelow(_FIRST_IDS)

    def open(self) -> bytes:
        """Connects, and returns the greeting.

        Raises:
            OSError: nobody listens, or the connection broke; TimeoutError: no greeting in time.
            BadReply: the first frame is none.
        """
        deadline = time.monotonic() + self._timeout_s
        if isinstance(self.endpoint, str):
            self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            self.sock.settimeout(self._timeout_s)
            self.sock.connect(self.endpoint)
        else:
            self.sock = socket.create_connection(self.endpoint, timeout=self._timeout_s)
            self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        greeting = self._frame(deadline)
        self.t = threading.Thread(target=self._receive_until_broken, name="unrealcv", daemon=True)
        self.t.start()
        return greeting

    def stream(self, commands: Sequence[str]) -> Iterator[str | bytes | None]:
        """Sends commands together, and yields their replies as they come; None: it had no id.

        Raises:
            OSError, BadReply, AssertionError, ValueError: what broke the connection.
        """
        for command in commands:
            if not self.send(b"%d:%b" % (self.send_message_id, command.encode())):
                raise ConnectionError("a request could not be sent")
            self.send_message_id += 1
        self.recv_num_q.put(-len(commands))
        for _ in commands:
            reply = self.recv_data_q.get()  # ends: every receive() has its deadline
            if isinstance(reply, Exception):
                raise reply
            yield reply

    def send(self, message: bytes) -> bool:
        """Sends a request; false if it could not be sent in time."""
        if self.sock is not None:
            self.sock.settimeout(self._timeout_s)
        return bool(super().send(message))

    def receive(self) -> bytes:
        """The next reply's frame, for the receiving thread."""
        deadline = time.monotonic() + self._timeout_s
        while (payload := self._frame(deadline)) == _CLICK:
            pass
        return payload

    def _receive_until_broken(self) -> None:
        try:
            self.receive_loop_queue()
        except (OSError, BadReply, AssertionError, ValueError) as fault:
            self.recv_data_q.put(fault)

    def _frame(self, deadline: float) -> bytes:
        connection = self.sock

        def receive(most: int) -> bytes:
            rest = deadline - time.monotonic()
            if rest <= 0:
                raise TimeoutError("timed out")
            connection.settimeout(rest)
            return bytes(connection.recv(most))

        if connection is None:
            raise ConnectionError("the connection is closed")
        return read_frame(receive)
