"""One connection to a server, over the official client, with deadlines that hold.

The official client waits for ever in several places (protocol reference, sections 6.2 and 6.3), and after
any fault its replies may belong to other requests. So every call runs under a deadline, and after the
first fault the session is broken for good: its owner opens another.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from omniscv.errors import BadReply, ConnectionFailed, DeadlineExceeded, ServerRefused, SourceError

Reply = str | bytes
T = TypeVar("T")


class Session:
    """A connection. Replies come back as text, or as bytes where they are no text.

    Args:
        endpoint: (host, port), or the path of a Unix socket.
        timeout_s: how long connecting, and each request, may take.

    Raises:
        ConnectionFailed: nobody answers, or not as an UnrealCV server does.
    """

    def __init__(self, endpoint: tuple[str, int] | str, timeout_s: float = 30.0) -> None:
        self.endpoint, self.timeout_s = endpoint, timeout_s
        self.broken = False
        self._client = _quiet_client(endpoint)
        try:
            connected = self._guarded(self._client.connect, timeout_s, "a greeting")
        except DeadlineExceeded as late:
            raise ConnectionFailed(
                f"{self.address}: expected a greeting within {timeout_s:g} s, got silence; "
                "is another client connected?"
            ) from late
        if not connected:
            self.close()
            raise ConnectionFailed(
                f"{self.address}: expected an UnrealCV server, but none answers; is the game running?"
            )

    @property
    def address(self) -> str:
        """The endpoint as a person writes it."""
        return self.endpoint if isinstance(self.endpoint, str) else "{}:{}".format(*self.endpoint)

    def ask(self, command: str) -> Reply:
        """The reply to one command, whatever it says.

        Raises:
            DeadlineExceeded, BadReply, ConnectionFailed: the session is broken from now on.
        """
        return self.ask_all([command])[0]

    def ask_all(self, commands: Sequence[str]) -> list[Reply]:
        """The replies to commands that are sent together, in order.

        Raises:
            DeadlineExceeded, BadReply, ConnectionFailed: the session is broken from now on.
        """
        if self.broken:
            raise ConnectionFailed(
                f"{self.address}: expected a working connection, but an earlier request broke it"
            )
        limit = self.timeout_s * len(commands)
        what = f"an answer to {commands[0]!r}"
        try:
            replies = self._guarded(lambda: self._client.request(list(commands)), limit, what)
        except (ConnectionError, TimeoutError, OSError) as cause:
            self.close()
            raise ConnectionFailed(
                f"{self.address}: expected {what}, but the connection broke: {cause}"
            ) from cause
        except SourceError:
            self.close()
            raise
        for command, reply in zip(commands, replies, strict=True):
            if reply is None:
                self.close()
                raise BadReply(
                    f"{self.address}: expected an answer to {command!r}, got a message without an id"
                )
        return list(replies)

    def text(self, command: str) -> str:
        """The text that a command answers.

        Raises:
            ServerRefused: the server answered ``error ...``.
            BadReply: it answered bytes.
        """
        reply = self.ask(command)
        if not isinstance(reply, str):
            raise BadReply(f"{self.address}: expected text from {command!r}, got {len(reply)} bytes")
        if reply.startswith("error"):
            raise ServerRefused(f"{self.address}: {command!r} was refused: {reply}")
        return reply

    def close(self) -> None:
        """Leaves the server; closing twice is fine."""
        self.broken = True
        connection = self._client.sock
        if connection is not None:
            with contextlib.suppress(OSError):  # the server may have left first
                connection.shutdown(socket.SHUT_RDWR)  # wakes the client's receive thread
        self._client.disconnect()

    def _guarded(self, call: Callable[[], T], limit_s: float, what: str) -> T:
        """Runs a call of the client in a thread of its own, so that a deadline can end the wait for it."""
        results: list[T] = []
        errors: list[Exception] = []

        def run() -> None:
            try:
                results.append(call())
            except (AssertionError, ConnectionError, TimeoutError, OSError) as error:
                errors.append(error)

        thread = threading.Thread(target=run, name="unrealcv-call", daemon=True)
        thread.start()
        thread.join(limit_s)
        if thread.is_alive():
            self.close()
            self._client.recv_data_q.put(ConnectionError("given up"))  # wakes a call that waits for replies
            raise DeadlineExceeded(f"{self.address}: expected {what} within {limit_s:g} s, got none")
        if errors:
            raise errors[0]
        return results[0]


def _quiet_client(endpoint: tuple[str, int] | str) -> Any:
    """The official client, without what it prints and logs: its faults come back as our errors."""
    import unrealcv

    logging.getLogger("unrealcv").setLevel(logging.CRITICAL)
    unrealcv.print = lambda *_: None  # the module's own name, not the builtin
    client = unrealcv.Client(endpoint, "unix" if isinstance(endpoint, str) else "inet")
    client._capability_warning_emitted = True  # every public server is "too old" for its warning
    return client
