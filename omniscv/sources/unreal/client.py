"""One connection to a server: the official client, under deadlines.

Its own ``connect`` and ``request`` block without limit in several places, and read frames of any size
(protocol reference, sections 6.2 and 6.3). Here it connects, sends and receives under deadlines, checks
frames, and passes every fault of its receiving thread to the caller. Framing, ids and text stay its own.
"""

import contextlib
import logging
import math
import secrets
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import unrealcv

from omniscv.arguments import shown
from omniscv.errors import BadReplyError, DeadlineError, ServerConnectionError, SourceError

Endpoint = tuple[str, int] | str  # (host, port), or the path of a Unix socket
Reply = str | bytes  # text, or bytes where they are not UTF-8

MAGIC = 0x9E2B83C1
MAX_PAYLOAD = 1 << 30  # bytes, four times the depth of an 8192 x 8192 picture: no reply is larger
_HEADER = struct.Struct("<II")  # of a frame: magic and payload size, then comes the payload (section 1.1)
_FIRST_IDS = 90_000_000  # ids have up to 8 digits; a connection has room for ten million requests
_CLICK = b"clicked"  # what plugin 0.3.10 sends at a mouse click in the game's window: a reply to no request

logging.getLogger("unrealcv").setLevel(logging.CRITICAL)  # its faults are raised as errors of omniscv
unrealcv.print = lambda *_: None  # the module's own name, not the builtin


def address_of(endpoint: Endpoint) -> str:
    """Return an endpoint as users write it."""
    return endpoint if isinstance(endpoint, str) else "{}:{}".format(*endpoint)


class Client(unrealcv.Client):  # type: ignore[misc]
    """A client of one connection.

    After any fault the replies of a connection may belong to other requests, so the first fault breaks the
    client for good. Ids start at random: no reply to an earlier client, which servers send to the next, fits.
    The deadline is for connecting with the greeting, for sending a request, and for each reply; it is never
    later than ``until()``, of the monotonic clock. Raise ServerConnectionError if no UnrealCV server is
    reachable, from ConnectionRefusedError if none listens.
    """

    def __init__(
        self, endpoint: Endpoint, timeout_s: float, until: Callable[[], float] = lambda: math.inf
    ) -> None:
        super().__init__(endpoint, "unix" if isinstance(endpoint, str) else "inet")
        self._timeout_s, self._until, self.broken = timeout_s, until, False
        self._allowed_s = timeout_s
        self.send_message_id = self.recv_message_id = secrets.randbelow(_FIRST_IDS)
        try:
            self._greet()
        except (OSError, BadReplyError) as cause:
            self.close()
            why = f"{cause}; is the game running?"
            if isinstance(cause, TimeoutError):
                why = f"no greeting within {self._allowed_s:.3g} s; is another client connected?"
            where = address_of(endpoint)
            raise ServerConnectionError(f"No UnrealCV server reachable at {where}: {why}") from cause

    def stream(self, commands: Sequence[str]) -> Iterator[Reply]:
        """Send commands together, and yield their replies as they come.

        Replies that are not fetched would be taken for those of later requests: closing the iterator early
        breaks the client, and so does every error.
        """
        if self.broken:
            broken = "expected a working connection, but an earlier fault broke it"
            raise ServerConnectionError(f"{address_of(self.endpoint)}: {broken}")
        received = 0
        try:
            for command in commands:
                self.sock.settimeout(self._deadline() - time.monotonic())
                if not self.send(b"%d:%b" % (self.send_message_id, command.encode())):
                    raise ConnectionError("a request could not be sent")
                self.send_message_id += 1
            if commands:
                self.recv_num_q.put(-len(commands))
            for _ in commands:
                reply = self.recv_data_q.get()  # ends: every receive() has its deadline
                if isinstance(reply, Exception):
                    raise reply
                if reply is None:
                    raise BadReplyError("a message without an id")
                received += 1
                yield reply
        except (OSError, AssertionError, ValueError, SourceError) as cause:
            raise self._fault(commands[received], cause) from cause
        finally:
            if received < len(commands):
                self.close()

    def close(self) -> None:
        self.broken = True
        if self.sock is not None:
            with contextlib.suppress(OSError):  # the server may have disconnected first
                self.sock.shutdown(socket.SHUT_RDWR)  # wakes the receiving thread
        self.disconnect()

    def receive(self) -> bytes:
        """Return the next reply's frame; called by the receiving thread."""
        deadline = self._deadline()
        while (payload := self._frame(deadline)) == _CLICK:
            pass
        return payload

    def _greet(self) -> None:
        deadline = self._deadline()
        if isinstance(self.endpoint, str):
            self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            self.sock.settimeout(self._allowed_s)
            self.sock.connect(self.endpoint)
        else:
            host, port = self.endpoint
            self.sock = _connected(host, port, deadline)
            self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if not (greeting := self._frame(deadline)).startswith(b"connected"):
            raise BadReplyError(f"expected 'connected to ...', got {shown(greeting[:80])}")
        self.t = threading.Thread(target=self._receive_until_broken, name="unrealcv", daemon=True)
        self.t.start()

    def _receive_until_broken(self) -> None:
        try:
            self.receive_loop_queue()
        except (OSError, BadReplyError, AssertionError, ValueError) as fault:
            self.recv_data_q.put(fault)

    def _frame(self, deadline: float) -> bytes:
        connection = self.sock
        if connection is None:
            raise ConnectionError("the connection is closed")

        def receive(most: int) -> bytes:
            if (remaining := deadline - time.monotonic()) <= 0:
                raise TimeoutError("timed out")
            connection.settimeout(remaining)
            return bytes(connection.recv(most))

        return read_frame(receive)

    def _deadline(self) -> float:
        now = time.monotonic()
        self._allowed_s = max(1e-3, min(self._timeout_s, self._until() - now))
        return now + self._allowed_s

    def _fault(self, command: str, cause: Exception) -> SourceError:
        expected = f"{address_of(self.endpoint)}: expected an answer to {shown(command)}"
        if isinstance(cause, TimeoutError):
            return DeadlineError(f"{expected} within {self._allowed_s:.3g} s, got none, or not all of it")
        if isinstance(cause, OSError):
            return ServerConnectionError(f"{expected}, but the connection broke: {cause}")
        return BadReplyError(f"{expected}, got a reply that does not belong to it: {str(cause)[:100]}")


def _connected(host: str, port: int, deadline: float) -> socket.socket:
    """Return a connection to the first address of a host that accepts one; the deadline is for all."""
    fault: OSError = ConnectionRefusedError(f"no address of {host}")
    for *_, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        try:
            remaining = max(1e-3, deadline - time.monotonic())
            return socket.create_connection((str(address[0]), int(address[1])), timeout=remaining)
        except OSError as cause:
            fault = cause
    raise fault


def read_frame(receive: Callable[[int], bytes]) -> bytes:
    """Return the next frame's payload, by a function such as ``socket.recv``.

    Its header is checked before a byte of it is kept: BadReplyError for wrong magic, an empty payload, or one
    larger than ``MAX_PAYLOAD``; ConnectionError if the stream ends before the frame does.
    """
    magic, size = _HEADER.unpack(_read_exactly(receive, _HEADER.size))
    if magic != MAGIC:
        raise BadReplyError(f"expected a frame with magic {MAGIC:#x}, got {magic:#x}: out of step")
    if not 0 < size <= MAX_PAYLOAD:
        raise BadReplyError(f"expected a frame of 1 to {MAX_PAYLOAD} bytes, got one that claims {size}")
    return _read_exactly(receive, size)


def _read_exactly(receive: Callable[[int], bytes], size: int) -> bytes:
    """Read so many bytes; memory grows with what comes, not with what the header claims."""
    data = bytearray()
    while len(data) < size:
        block = receive(min(1 << 20, size - len(data)))
        if not block:
            raise ConnectionError(f"the stream ended {size - len(data)} bytes before its frame did")
        data += block
    return bytes(data)
