"""Reconnecting client with bounded retries and exponential backoff."""

import contextlib
import math
import os
import stat
import time
from collections.abc import Callable, Iterator, Sequence
from socket import gaierror
from typing import TypeVar

from omniscv import arguments, errors
from omniscv.arguments import shown
from omniscv.sources.unreal.client import Client, Endpoint, Reply, address_of

T = TypeVar("T")

TIMEOUT_S, PATIENCE_S, RETRIES = 15.0, 10.0, 5
"""A server that is silent from the first reply, or from any later one, is given up within their sum, 25 s."""

RETRIED = (errors.ServerConnectionError, errors.DeadlineError, errors.BadReplyError)
"""Faults after which a request is sent again, over a new connection."""

_UNREACHABLE = (ConnectionRefusedError, FileNotFoundError, gaierror)


class Connection:
    """A connection to a server, made when it is first used, and made anew after every fault.

    Args:
        endpoint: of the server.
        timeout_s: how long connecting, and each reply, may take.
        patience_s: for how long after a fault to connect and send again, until there is a reply.
        retries: how often; each after a pause of 0.1 s to 2 s.

    Attributes:
        client: the one in use, which may be broken; None before the first.

    Raises:
        ArgumentError: a time that is not above 0, or retries below 0.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        timeout_s: float = TIMEOUT_S,
        patience_s: float = PATIENCE_S,
        retries: int = RETRIES,
    ) -> None:
        self._endpoint, self.address = endpoint, address_of(endpoint)
        self._timeout_s = arguments.number("timeout_s", timeout_s, above=0)
        self._patience_s = arguments.number("patience_s", patience_s, above=0)
        self._retries = arguments.whole_number("retries", retries, least=0)
        self._until = math.inf  # when the patience ends, of the monotonic clock
        self.client: Client | None = None

    def connected(self) -> Client:
        """Return a client that is not known to be broken; ServerConnectionError if no server is reachable."""
        if self.client is None or self.client.broken:
            self.client = self._unix_client() or self._connect(self._endpoint)
        return self.client

    @contextlib.contextmanager
    def attempts(self) -> Iterator[Callable[[errors.SourceError | None], None]]:
        """Yield a function to call after each attempt of an operation, with its fault or None for progress.

        After a fault of ``RETRIED`` it disconnects and pauses, so that late replies are dropped. It raises
        the fault if it is one too many without progress, or if no server has ever been reached.
        """
        outer, failures = self._until, 0

        def attempted(fault: errors.SourceError | None) -> None:
            nonlocal failures
            if fault is None:
                self._until, failures = outer, 0
                return
            if self.client is None and isinstance(fault.__cause__, _UNREACHABLE):
                raise fault
            self.close()
            now, failures = time.monotonic(), failures + 1
            if failures == 1:
                self._until = min(outer, now + self._patience_s)
            pause = min(2.0, 0.1 * 2 ** (failures - 1))
            if failures > self._retries or now + pause >= self._until:
                raise type(fault)(f"{fault}; gave up after {failures} attempts") from fault
            time.sleep(pause)

        try:
            yield attempted
        finally:
            self._until = outer

    def read(self, commands: Sequence[str], reader: Callable[[str, Reply], T]) -> list[T]:
        """Return what ``reader(command, reply)`` makes of the replies to commands that are sent together.

        After a fault, or where ``reader`` raises ``BadReplyError``, those without a result are sent again,
        until there are too many faults in a row.
        """
        results: list[T] = []
        with self.attempts() as attempted:
            while len(results) < len(commands):
                before = len(results)
                try:
                    for reply in self.connected().stream(commands[before:]):
                        results.append(reader(commands[len(results)], reply))
                except RETRIED as fault:
                    if len(results) > before:
                        attempted(None)
                    attempted(fault)
        return results

    def texts(self, commands: Sequence[str]) -> list[str]:
        """Return the replies to commands, which must be text; see :meth:`read`."""

        def text(command: str, reply: Reply) -> str:
            if isinstance(reply, str):
                return reply
            raise errors.BadReplyError(
                f"{self.address}: expected text from {shown(command)}, got {shown(reply[:80])}"
            )

        return self.read(commands, text)

    def text(self, command: str) -> str:
        """Return the reply to a command, which must be text; ServerRefusedError for ``error ...``."""
        (reply,) = self.texts([command])
        if reply.startswith("error"):
            raise errors.ServerRefusedError(f"{self.address}: {shown(command)} was refused: {shown(reply)}")
        return reply

    def close(self) -> None:
        if self.client is not None:
            self.client.close()

    def _unix_client(self) -> Client | None:
        # Plugin 1.0 on Linux leaves TCP for its Unix socket when its first client disconnects; a TCP
        # connection then gets no greeting (protocol reference, section 1.2).
        if isinstance(self._endpoint, str) or self._endpoint[0] not in ("localhost", "127.0.0.1", "::1"):
            return None
        # The plugin's own fixed path, not a temporary file of omniscv; anybody may make a socket there.
        path = f"/tmp/unrealcv_{self._endpoint[1]}.socket"
        if _is_own_socket(path):
            with contextlib.suppress(errors.ServerConnectionError):  # a game that crashed leaves it behind
                return self._connect(path)
        return None

    def _connect(self, endpoint: Endpoint) -> Client:
        return Client(endpoint, self._timeout_s, lambda: self._until)


def _is_own_socket(path: str) -> bool:
    try:
        status = os.lstat(path)
    except OSError:
        return False
    return stat.S_ISSOCK(status.st_mode) and status.st_uid == os.geteuid()
