"""Opens a live source that speaks the server's dialect."""

from __future__ import annotations

from dataclasses import replace

from omniscv.captures.unreal.link import Link
from omniscv.captures.unreal.live import UnrealSource
from omniscv.captures.unreal.player import PlayerSource
from omniscv.captures.unreal.probe import CLASSIC, MODERN, L, dialect_of


def open_live(
    endpoint: tuple[str, int] | str,
    *,
    timeout_s: float = 30.0,
    retries: int = 5,
    fix_exposure: bool = False,
) -> UnrealSource:
    """A server as a source, whatever it speaks.

    The connection that finds out is the one that is used: some servers serve only one (protocol reference,
    section 1.2).

    Args:
        endpoint: (host, port), or the path of a Unix socket.
        timeout_s: how long connecting, and each reply, may take.
        retries: how often to try again while nothing comes at all, with pauses that grow from 0.1 s to 2 s.
        fix_exposure: switches vignette and auto exposure off in the running game.

    Raises:
        ConnectionFailed: nobody answers, or not as an UnrealCV server does.
        SourceError: too many faults in a row, or a server that refuses what is needed.
    """
    link = Link(endpoint, timeout_s, retries)
    try:
        dialect = dialect_of(link)
        if dialect == L:
            return PlayerSource(link, CLASSIC, fix_exposure)
        return UnrealSource(link, replace(MODERN, dialect=dialect), fix_exposure)
    except BaseException:
        link.close()
        raise
