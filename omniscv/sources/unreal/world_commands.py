"""Which commands change or describe the world, by dialect, and which of them may be sent twice."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, ServerRefusedError

OBJECTS = "vget /objects"
IS_PAUSED = "vget /action/game/is_paused"
PAUSE, RESUME = "vset /action/game/pause", "vset /action/game/resume"
_MAX_COMMAND = 4000  # characters

_REPEATABLE = re.compile(
    r"vget |vset /(?:object/\S*/(?:location|rotation|scale|color|show|hide)|viewmode|action/game/resume"
    r"|camera/\d*/(?!moveto\b)\S+) ?"
)
_SHOWS_THE_SAME = re.compile(
    r"vget |vset /(?:camera/\d*/(?:location|rotation|pose|moveto|fov|horizontal_fieldofview|size) "
    r"|cameras/spawn|viewmode |action/(?:input|game/(?:pause|resume)))"
)


@dataclass(frozen=True)
class WorldTable:
    """What a dialect can do with its world, by a word for it: the form of the command.

    Attributes:
        plugin: the dialect, as users know it.
        forms: by what they do; ``{}`` stands for a name.
        words: the least and the most words of a console command, behind its verb.
        pause_toggles: whether the command that pauses a game resumes one that is paused.
    """

    plugin: str
    forms: Mapping[str, str]
    words: tuple[int, int]
    pause_toggles: bool = False

    def command(self, what: str, *arguments: object) -> str:
        """Return a command; ServerRefusedError where the dialect has none that does this."""
        if what not in self.forms:
            raise ServerRefusedError(f"expected a server that can {what}, got {self.plugin}, which cannot")
        return self.forms[what].format(*arguments)

    def console(self, text: str) -> str:
        """Return the command for a command of the engine's console; ServerRefusedError if it is too long."""
        least, most = self.words
        count = len(text.split())
        if count < least:
            return f"vcmd {text}"
        if count > most:
            wanted = f"expected a console command of at most {most} words for {self.plugin}"
            raise ServerRefusedError(f"{wanted}, got {count}: {shown(text)}")
        return f"vrun {text}"


_ANY = {
    "read a location": "vget /object/{}/location",
    "read a rotation": "vget /object/{}/rotation",
    "read a mobility": "vget /object/{}/mobility",
    "move objects": "vset /object/{}/location {}",
    "turn objects": "vset /object/{}/rotation {}",
    "show objects": "vset /object/{}/show",
    "hide objects": "vset /object/{}/hide",
}
_L = {**_ANY, "call blueprint functions": "vexec {} {}"}
_M = {
    **_ANY,
    "read the bounds of objects": "vget /object/{}/bounds",
    "spawn objects": "vset /objects/spawn {} {}",
    "destroy objects": "vset /object/{}/destroy",
    "call blueprint functions": "vbp {} {}",
    "set lights": "vbp {} set_light {}",
}
_EXPOSURE = {"set the exposure": "vset /camera/{}/exposure_{} {}"}
_N2 = {**_M, **_EXPOSURE, "answer a batch in one tick": "vbatch {}"}

TABLES: Mapping[str, WorldTable] = {
    "0.3.10": WorldTable("plugin 0.3.10", _L, (1, 3), pause_toggles=True),
    "M": WorldTable("plugin 1.x of the branches 4.22 to 4.27", _M, (1, 6)),
    "N1": WorldTable("plugin 1.0.1", {**_M, **_EXPOSURE}, (1, 6)),
    "N2": WorldTable("plugin 1.0.1 of 2026", _N2, (2, 6)),
}
"""By dialect (protocol reference, sections 2.1, 2.7 and 2.9)."""


def is_repeatable(command: str) -> bool:
    """Return whether it is harmless to send a command twice: it reads, or sets absolute values."""
    return _REPEATABLE.match(command) is not None


def changes_world(command: str) -> bool:
    """Return whether captures may show another world after a command; the camera itself is not part of it."""
    return _SHOWS_THE_SAME.match(f"{command} ") is None


def checked(text: str) -> str:
    """Return a command that can be sent alone; ArgumentError for one that would break the stream."""
    if not isinstance(text, str) or not text.strip() or not text.isprintable() or len(text) > _MAX_COMMAND:
        raise ArgumentError(f"command: expected one line such as 'vget /objects', got {shown(text)}")
    if text.split()[0] == "vbatch":
        raise ArgumentError("command: expected one that is answered alone, got vbatch; use freeze='batch'")
    return text.strip()
