"""Commands beside captures: sent by the same connection, one turn at a time, and repeated where harmless."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from omniscv.arguments import shown
from omniscv.errors import ServerRefusedError
from omniscv.sources.base import closed_error
from omniscv.sources.unreal.client import Reply
from omniscv.sources.unreal.commands import VERSION
from omniscv.sources.unreal.connection import RETRIED, Connection
from omniscv.sources.unreal.driver import CameraDriver
from omniscv.sources.unreal.stale_frames import SETTLED, StaleFrames
from omniscv.sources.unreal.world_commands import is_repeatable


class Exchange:
    """A connection that captures and commands use in turns.

    Attributes:
        driver: the camera's; it is aimed anew after a change.
        lock: held for one turn: the captures of a viewpoint, or commands that belong together.
        closed: whether turns are over.
    """

    def __init__(self, connection: Connection, driver: CameraDriver, stale_frames: StaleFrames) -> None:
        self.connection, self.driver, self._stale_frames = connection, driver, stale_frames
        self.lock, self.closed = threading.RLock(), False

    @contextmanager
    def turn(self) -> Iterator[None]:
        """A context of commands that belong together; SourceError once it is closed."""
        with self.lock:
            if self.closed:
                raise closed_error(self.connection.address)
            yield

    def ask(self, commands: Sequence[str]) -> list[str]:
        """Return the replies to commands that may be repeated; ServerRefusedError if one is an error."""
        found = self.connection.texts(commands)
        for command, reply in zip(commands, found, strict=True):
            self._accepted(command, reply)
        return found

    def do(self, commands: Sequence[str]) -> None:
        """Set absolute values; ServerRefusedError for a reply other than ok."""
        for command, reply in zip(commands, self.connection.texts(commands), strict=True):
            if reply != "ok":
                expected = f"expected a server that answers {shown(command)} with ok"
                raise ServerRefusedError(f"{self.connection.address}: {expected}, got {shown(reply)}")

    def reply(self, command: str) -> Reply:
        """Return the reply to any command, text or bytes; ServerRefusedError if it is an error."""
        return self._accepted(command, exchanged(self.connection, command))

    def settle(self) -> None:
        """Wait until captures show what was changed: frames from before are stale."""
        self._stale_frames.reset()
        self.driver.forget()
        for _ in range(SETTLED):
            self.connection.text(VERSION)  # each reply is a frame later at least

    def _accepted(self, command: str, reply: Reply) -> Reply:
        if isinstance(reply, str) and reply.startswith("error"):
            raise ServerRefusedError(
                f"{self.connection.address}: {shown(command)} was refused: {shown(reply)}"
            )
        return reply


def exchanged(connection: Connection, command: str) -> Reply:
    """Return the reply to a command, which is sent again after a fault only where that is harmless.

    Raises:
        SourceError: no reply within the deadlines.
    """
    if is_repeatable(command):
        return connection.read([command], lambda _, reply: reply)[0]
    connection.text(VERSION)  # a connection that has broken meanwhile is made anew before, not after
    try:
        (reply,) = connection.connected().stream([command])
    except RETRIED as fault:
        raise type(fault)(f"{fault}; it may have been carried out, so it was not sent again") from fault
    return reply
