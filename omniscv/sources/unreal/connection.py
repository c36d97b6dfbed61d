"""Reconnecting client with bounded retries and exponential backoff."""

import contextlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from socket import gaierror
from typing import TypeVar

from omniscv import errors
from omniscv.sources.unreal.client import Client, Endpoint, Reply, address_of

T = TypeVar("T")

RETRIED = (errors.ServerConnectionError, errors.DeadlineError, errors.BadReplyError)
"""Faults after which a request is sent again, over a new connection."""

_UNREACHABLE = (ConnectionRefusedError, FileNotFoundError, gaierror)


class Connection:
    """A connection to a server, made when it is first used, and made anew after every fault.

    After each of so many ``retries`` in a row it pauses, for 0.1 s to 2 s. ``client`` is the one in use,
    which may be broken; None before the first.
    """

    def __init__(self, endpoint: Endpoint, timeout_s: float = 30.0, retries: int = 5) -> None:
        self._endpoint, self._timeout_s, self._retries = endpoint, timeout_s, retries
        self.address = address_of(endpoint)
        self.client: Client | None = None

    def connected(self) -> Client:
        """Return a client that is not known to be broken; ServerConnectionError if no server is reachable."""
        if self.client is None or self.client.broken:
            self.client = self._unix_client() or Client(self._endpoint, self._timeout_s)
        return self.client

    def recover(self, fault: errors.SourceError, failures: int) -> None:
        """Disconnect and pause, so that late replies are dropped, after a fault of ``RETRIED``.

        The fault is raised if it is one too many in a row, or if no server has ever been reached.
        """
        if self.client is None and isinstance(fault.__cause__, _UNREACHABLE):
            raise fault
        self.close()
        if failures > self._retries:
            raise type(fault)(f"{fault}; gave up after {failures} attempts") from fault
        time.sleep(min(2.0, 0.1 * 2 ** (failures - 1)))

    def read(self, commands: Sequence[str], reader: Callable[[str, Reply], T]) -> list[T]:
        """Return what ``reader(command, reply)`` makes of the replies to commands that are sent together.

        After a fault, or where ``reader`` raises ``BadReplyError``, those without a result are sent again,
        until there are too many faults in a row.
        """
        results: list[T] = []
        failures = 0
        while len(results) < len(commands):
            before = len(results)
            try:
                for reply in self.connected().stream(commands[before:]):
                    results.append(reader(commands[len(results)], reply))
            except RETRIED as fault:
                failures = 1 if len(results) > before else failures + 1
                self.recover(fault, failures)
        return results

    def texts(self, commands: Sequence[str]) -> list[str]:
        """Return the replies to commands, which must be text; see :meth:`read`."""

        def text(command: str, reply: Reply) -> str:
            if isinstance(reply, str):
                return reply
            raise errors.BadReplyError(f"{self.address}: expected text from {command!r}, got {reply[:80]!r}")

        return self.read(commands, text)

    def text(self, command: str) -> str:
        """Return the reply to a command, which must be text; ServerRefusedError for ``error ...``."""
        (reply,) = self.texts([command])
        if reply.startswith("error"):
            raise errors.ServerRefusedError(f"{self.address}: {command!r} was refused: {reply}")
        return reply

    def close(self) -> None:
        if self.client is not None:
            self.client.close()

    def _unix_client(self) -> Client | None:
        # Plugin 1.0 on Linux leaves TCP for its Unix socket when its first client disconnects; a TCP
        # connection then gets no greeting (protocol reference, section 1.2).
        if isinstance(self._endpoint, str) or self._endpoint[0] not in ("localhost", "127.0.0.1", "::1"):
            return None
        # The plugin's own fixed path, not a temporary file of omniscv.
        path = Path(f"/tmp/unrealcv_{self._endpoint[1]}.socket")
        if path.is_socket():
            with contextlib.suppress(
                errors.ServerConnectionError
            ):  # a game that crashed leaves the file behind
                return Client(str(path), self._timeout_s)
        return None
