"""What a server speaks, by what it answers: versions do not tell (protocol reference, section 0)."""

from __future__ import annotations

import re

from omniscv.captures.source import Capabilities
from omniscv.captures.unreal.link import Link
from omniscv.captures.unreal.session import Reply
from omniscv.errors import BadReply

L = "0.3.10"
"""The dialect of plugin 0.3.10; M, N1 and N2 share the commands of plugin 1.x."""

MODERN = Capabilities(can_spawn=True, pipelines=True)
CLASSIC = Capabilities(
    can_set_size=False,
    can_look_vertical=False,
    mask_through_viewport=True,
    depth_kind="ray",
    depth_unit="m",
    dialect=L,
)
"""What all servers of the kind can do."""

_UNKNOWN = re.escape("error Can not find a handler for URI '")
_UNKNOWN_N2 = re.escape("error No handler found for URI '")


def dialect_of(link: Link) -> str:
    """The dialect of a server: 0.3.10, M, N1 or N2.

    N2 has words of its own for commands that it does not know; only 0.3.10 answers its field of view so; M
    does not know the level's name.

    Raises:
        ConnectionFailed, DeadlineExceeded, BadReply: too many faults in a row, or none of the dialects.
    """
    if _answer(link, "vget /omniscv", _UNKNOWN, _UNKNOWN_N2) == _UNKNOWN_N2:
        return "N2"
    number = r"\d+\.\d+$"
    if _answer(link, "vget /camera/0/horizontal_fieldofview", _UNKNOWN, number) == number:
        return L
    return "M" if _answer(link, "vget /level/name", _UNKNOWN, "") == _UNKNOWN else "N1"


def _answer(link: Link, command: str, *forms: str) -> str:
    """Which of some forms, the first that fits, the answer to a command begins with."""

    def read(reply: Reply) -> str:
        for form in forms:
            if isinstance(reply, str) and re.match(form, reply, re.ASCII):
                return form
        raise BadReply(
            f"{link.address}: expected plugin 0.3.10 or 1.x to answer {command!r}, got {reply[:200]!r}"
        )

    return link.ask(command, read)
