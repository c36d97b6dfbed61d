"""Which plugin a server runs, and which commands it has.

Versions do not identify a dialect (protocol reference, section 0), so the server is asked for its commands.
Plugin 1.1.0 and the closed Dev build list them; older ones print them in their help.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from omniscv.arguments import shown
from omniscv.errors import BadReplyError
from omniscv.sources.unreal.commands import BOUNDS, EXPOSURE_METHOD, IS_PAUSED, LEVEL, VERTICES

if TYPE_CHECKING:
    from omniscv.sources.unreal.client import Connection
    from omniscv.sources.unreal.replies import Reply

_LIST, _HELP = "vget /unrealcv/commands", "vget /unrealcv/help"
_MOST_TEXT = 1 << 20  # characters of a list, or help, that are read

# The starts of replies to commands that a dialect does not know.
_UNKNOWN = re.escape("error Can not find a handler for URI '")
_UNKNOWN_N2 = re.escape("error No handler found for URI '")


@dataclass(frozen=True)
class Dialect:
    """What a release of the plugin answers.

    Attributes:
        plugin: the releases that speak it.
        engine: the versions of Unreal that these were built for.
        batches: whether ``vbatch`` has the next requests answered in one tick; no list of commands says so.
        commands: of the templates that not every dialect has, those that it has; for servers without help.
    """

    plugin: str
    engine: str
    batches: bool = False
    commands: frozenset[str] = frozenset()


_M = frozenset({BOUNDS, VERTICES, IS_PAUSED})
_N1 = _M | {LEVEL}
_N2 = _N1 | {EXPOSURE_METHOD}
DIALECTS = {
    "0.3.10": Dialect("plugin 0.3.10 (L)", "Unreal 4.12 to 4.16"),
    "M": Dialect("branches 4.22 to 4.27, which report 0.3.10", "Unreal 4.22 to 4.27", False, _M),
    "N1": Dialect("plugin 1.0.1, before 2026-03", "Unreal 4.27 and 5", False, _N1),
    "N2": Dialect("plugin 1.0.1, branch 5.2 from 2026-03", "Unreal 5.2 and later", True, _N2),
    "N3": Dialect("plugin 1.1.0 and later", "Unreal 5.2 and later", True, _N2),
    "Dev": Dialect("UnrealCV Dev for UnrealZoo, 2.0.0 and later", "seen with Unreal 5.7", True, _N2),
}


@dataclass(frozen=True)
class Plugin:
    """The plugin of one server: its dialect, a key of ``DIALECTS``, and the templates of its commands."""

    dialect: str
    templates: frozenset[str]

    def supports(self, template: str) -> bool:
        """Return whether it has a command, by its template with ``[uint]`` for a camera's number."""
        return template in self.templates

    @property
    def batches(self) -> bool:
        """Whether requests that ``vbatch`` announces are answered in one tick."""
        return DIALECTS[self.dialect].batches


def identify(connection: Connection) -> Plugin:
    """Return a server's plugin; BadReplyError for one of no known kind.

    Its list of commands is trusted if it holds itself, its help likewise; else the dialect is found by how
    the server answers, and the commands are those of ``DIALECTS``.
    """
    listed = _templates(connection, _LIST)
    if _LIST in listed:
        is_dev = any("/[camera_id]/" in template for template in listed)
        templates = frozenset(template.replace("[camera_id]", "[uint]") for template in listed)
        return Plugin("Dev" if is_dev else "N3", templates)
    dialect = _probed(connection)
    helped = _templates(connection, _HELP)[::2]  # descriptions are the other lines
    return Plugin(dialect, frozenset(helped) if _HELP in helped else DIALECTS[dialect].commands)


def _templates(connection: Connection, command: str) -> list[str]:
    """Return the lines of a reply; none of one that is no text."""
    (reply,) = connection.read([command], lambda _, reply: reply)
    return reply[:_MOST_TEXT].split("\n") if isinstance(reply, str) else []


def _probed(connection: Connection) -> str:
    """Return the dialect of a server without a list.

    N2 has error texts of its own for unknown commands; only 0.3.10 knows the field of view by this name; M
    does not know the level's name.
    """
    number = r"\d+\.\d+$"
    if _first_match(connection, "vget /omniscv", _UNKNOWN, _UNKNOWN_N2) == _UNKNOWN_N2:
        return "N2"
    if _first_match(connection, "vget /camera/0/horizontal_fieldofview", _UNKNOWN, number) == number:
        return "0.3.10"
    return "M" if _first_match(connection, LEVEL, _UNKNOWN, "") == _UNKNOWN else "N1"


def _first_match(connection: Connection, command: str, *patterns: str) -> str:
    """Return the first of some patterns that the reply to a command begins with."""

    def match(command: str, reply: Reply) -> str:
        for pattern in patterns:
            if isinstance(reply, str) and re.match(pattern, reply, re.ASCII):
                return pattern
        expected = f"expected plugin 0.3.10 or 1.x to answer {command!r}"
        raise BadReplyError(f"{connection.address}: {expected}, got {shown(reply[:100])}")

    return connection.read([command], match)[0]
