"""What a server speaks, by what it answers: versions do not tell (protocol reference, section 0)."""

from __future__ import annotations

import re

from omniscv.captures.source import Capabilities
from omniscv.captures.unreal.link import Link

L = "0.3.10"
"""The dialect of plugin 0.3.10; M, N1 and N2 share the commands of plugin 1.x."""

_NO_COMMAND = "vget /omniscv"
_FIELD_OF_VIEW = "vget /camera/0/horizontal_fieldofview"
_LEVEL = "vget /level/name"
_HELP = "vget /unrealcv/help"

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


def dialect_of(link: Link) -> str:
    """The dialect of a server: 0.3.10, M, N1 or N2.

    Only 0.3.10 answers its field of view; the refactored N2 has ``vcmd`` and words of its own for commands
    it does not know; M does not know the level's name. All of these are answered in order in all dialects,
    so they may be asked together.

    Raises:
        SourceError: too many faults in a row.
    """
    unknown, fov, level, known = link.texts([_NO_COMMAND, _FIELD_OF_VIEW, _LEVEL, _HELP])
    if re.fullmatch(r"\d+\.\d+", fov, re.ASCII):
        return L
    if "vcmd [str]" in known.splitlines() or unknown.startswith("error No handler found"):
        return "N2"
    return "M" if level == unknown.replace(_NO_COMMAND, _LEVEL) else "N1"
