"""One connection to a server, over the official client, with deadlines that hold.

After any fault the replies of a connection may belong to other requests. So after the first fault the
session is broken for good: its owner opens another.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator, Sequence

from omniscv.errors import BadReply, ConnectionFailed, DeadlineExceeded, SourceError

Reply = str | bytes


class Session:
    """A connection. Replies come back as text, or as bytes where they are no text.

    Args:
        endpoint: (host, port), or the path of a Unix socket.
        timeout_s: how long connecting, and each reply, may take.

    Raises:
        ConnectionFailed: nobody answers, or not as an UnrealCV server does. Its cause is a
            ``ConnectionRefusedError`` where nobody listens.
    """

    def __init__(self, endpoint: tuple[str, int] | str, timeout_s: float = 30.0) -> None:
        from omniscv.captures.unreal.client import Client  # its imports take half a second

        self.endpoint, self.timeout_s = endpoint, timeout_s
        self.broken = False
        self._client = Client(endpoint, timeout_s)
        try:
            greeting = self._client.open()
        except TimeoutError as late:
            self.close()
            raise ConnectionFailed(
                f"{self.address}: expected a greeting within {timeout_s:g} s, got silence; "
                "is another client connected?"
            ) from late
        except (OSError, BadReply) as cause:
            self.close()
            raise ConnectionFailed(
                f"{self.address}: expected an UnrealCV server, but none answers: {cause}; "
                "is the game running?"
            ) from cause
        if not greeting.startswith(b"connected"):
            self.close()
            raise ConnectionFailed(f"{self.address}: expected 'connected to ...', got {greeting[:80]!r}")

    @property
    def address(self) -> str:
        """The endpoint as a person writes it."""
        return self.endpoint if isinstance(self.endpoint, str) else "{}:{}".format(*self.endpoint)

    def stream(self, commands: Sequence[str]) -> Iterator[Reply]:
        """The replies to commands that are sent together, each as it comes.

        Replies that are not fetched would be taken for those of later requests: whoever stops early
        breaks the session.

        Raises:
            DeadlineExceeded, BadReply, ConnectionFailed: the session is broken from now on.
        """
        if self.broken:
            raise ConnectionFailed(
                f"{self.address}: expected a working connection, but an earlier fault broke it"
            )
        if not commands:
            return
        came = 0
        try:
            for reply in self._client.stream(commands):
                if reply is None:
                    raise BadReply("a message without an id")
                came += 1
                yield reply
        except (OSError, AssertionError, ValueError, SourceError) as cause:
            raise self._fault(commands[came], cause) from cause
        finally:
            if came < len(commands):
                self.close()

    def close(self) -> None:
        """Leaves the server; closing twice is fine."""
        self.broken = True
        connection = self._client.sock
        if connection is not None:
            with contextlib.suppress(OSError):  # the server may have left first
                connection.shutdown(socket.SHUT_RDWR)  # wakes the client's receive thread
        self._client.disconnect()

    def _fault(self, command: str, cause: Exception) -> SourceError:
        """What broke the connection, in our words."""
        expected = f"{self.address}: expected an answer to {command!r}"
        if isinstance(cause, TimeoutError):
            return DeadlineExceeded(f"{expected} within {self.timeout_s:g} s, got none, or not all of it")
        if isinstance(cause, OSError):
            return ConnectionFailed(f"{expected}, but the connection broke: {cause}")
        return BadReply(f"{expected}, got a reply that is none to it: {cause}")
