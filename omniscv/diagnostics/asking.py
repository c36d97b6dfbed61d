"""Sends commands to a server, beside no captures."""

from collections.abc import Iterable, Iterator
from typing import Unpack

from omniscv.sources.registry import Deadlines
from omniscv.sources.unreal.commands import checked
from omniscv.sources.unreal.opening import open_connection
from omniscv.sources.unreal.replies import described


def replies_to(address: str, commands: Iterable[str], **deadlines: Unpack[Deadlines]) -> Iterator[str]:
    """Yield the replies to commands, of binary ones the size and kind, each before the next is sent.

    Nothing else is done to the game: no camera is spawned, and no mask colour is set.

    Args:
        address: ``unreal://host:port``, ``unreal+unix:///path`` or ``mock://scene``.
        commands: of UnrealCV, such as ``vget /unrealcv/status``.
        deadlines: ``timeout_s`` and ``patience_s``, as for :func:`omniscv.open_source`.

    Raises:
        ArgumentError: an address of another form, or a command that is no single line.
        SourceError: no UnrealCV server reachable there, or one that refuses a command.
    """
    lines = [checked(command) for command in commands]
    with open_connection(address, **deadlines) as connection:
        for line in lines:
            yield described(connection.reply(line))
