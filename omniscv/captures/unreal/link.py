"""A server, whatever becomes of the connection: made anew after every fault, with patience that ends."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from omniscv.captures.unreal.session import Reply, Session
from omniscv.errors import BadReply, ConnectionFailed, DeadlineExceeded, ServerRefused, SourceError

T = TypeVar("T")

FAULTS = (ConnectionFailed, DeadlineExceeded, BadReply)
"""What another connection may cure."""

_NOBODY = (ConnectionRefusedError, FileNotFoundError, socket.gaierror)
_THIS_MACHINE = ("localhost", "127.0.0.1", "::1")
_FIRST_BACKOFF_S, _LONGEST_BACKOFF_S = 0.1, 2.0


class Link:
    """A way to a server.

    Args:
        endpoint: (host, port), or the path of a Unix socket.
        timeout_s: how long connecting, and each reply, may take.
        retries: how often to try again while nothing comes at all, with pauses that grow.
    """

    def __init__(self, endpoint: tuple[str, int] | str, timeout_s: float, retries: int) -> None:
        self._endpoint, self._timeout_s, self._retries = endpoint, timeout_s, retries
        self.session: Session | None = None
        """The connection in use; it may have broken."""

    def connected(self) -> Session:
        """A connection that is not known to be broken.

        Raises:
            ConnectionFailed: nobody answers, or not as an UnrealCV server does.
        """
        if self.session is None or self.session.broken:
            self.session = self._over_unix() or Session(self._endpoint, self._timeout_s)
        return self.session

    def _over_unix(self) -> Session | None:
        """A connection to a game on this machine that has left TCP.

        Plugin 1.0 on Linux does so when its first client leaves; who connects by TCP then waits for ever
        (protocol reference, section 1.2).
        """
        if isinstance(self._endpoint, str) or self._endpoint[0] not in _THIS_MACHINE:
            return None
        # The plugin's own fixed place, not a temporary file of ours.
        path = Path(f"/tmp/unrealcv_{self._endpoint[1]}.socket")
        if path.is_socket():
            with contextlib.suppress(ConnectionFailed):  # a game that crashed leaves it behind
                return Session(str(path), self._timeout_s)
        return None

    def recover(self, fault: SourceError, failures: int) -> None:
        """Drops the connection and pauses, so that late replies die.

        Args:
            fault: what went wrong; one of ``FAULTS``.
            failures: how often in a row, this one included.

        Raises:
            SourceError: the fault, if it came too often, or if nobody was ever there.
        """
        if self.session is None and isinstance(fault.__cause__, _NOBODY):
            raise fault
        self.close()
        if failures > self._retries:
            raise type(fault)(f"{fault}; gave up after {failures} attempts") from fault
        time.sleep(min(_LONGEST_BACKOFF_S, _FIRST_BACKOFF_S * 2 ** (failures - 1)))

    def texts(self, commands: Sequence[str]) -> list[str]:
        """The texts that commands answer, in order. After a fault, those without an answer are sent again.

        Raises:
            ConnectionFailed, DeadlineExceeded, BadReply: too many faults in a row.
        """
        replies: list[str] = []
        failures = 0
        while len(replies) < len(commands):
            before = len(replies)
            try:
                for reply in self.connected().stream(commands[before:]):
                    if not isinstance(reply, str):
                        expected = f"{self.address}: expected text from {commands[len(replies)]!r}"
                        raise BadReply(f"{expected}, got {reply[:80]!r}")
                    replies.append(reply)
            except FAULTS as fault:
                failures = 1 if len(replies) > before else failures + 1
                self.recover(fault, failures)
        return replies

    def text(self, command: str) -> str:
        """The text that a command answers.

        Raises:
            ServerRefused: the server answered ``error ...``.
            ConnectionFailed, DeadlineExceeded, BadReply: too many faults in a row.
        """
        (reply,) = self.texts([command])
        if reply.startswith("error"):
            raise ServerRefused(f"{self.address}: {command!r} was refused: {reply}")
        return reply

    def ask(self, command: str, read: Callable[[Reply], T]) -> T:
        """What ``read`` makes of a command's reply; where it raises ``BadReply``, the command is sent again.

        Raises:
            ConnectionFailed, DeadlineExceeded, BadReply: too many faults in a row.
        """
        failures = 0
        while True:
            try:
                (reply,) = self.connected().stream([command])
                return read(reply)
            except FAULTS as fault:
                failures += 1
                self.recover(fault, failures)

    @property
    def address(self) -> str:
        """The endpoint as a person writes it."""
        return self._endpoint if isinstance(self._endpoint, str) else "{}:{}".format(*self._endpoint)

    def close(self) -> None:
        """Leaves the server; closing twice is fine."""
        if self.session is not None:
            self.session.close()
