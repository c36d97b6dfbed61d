"""Reads what documents tell readers to run: fenced blocks, and command lines in them.

A fence names its language. ``python`` is Python. In ``sh``, ``bash`` and ``console``, lines that begin with
``omniscv`` or ``./scripts/`` (or these after ``$``) are commands; a backslash continues a line, and a comment
ends it. A block of another language whose first line is ``# NAME.EXT`` is a file of that name, for the blocks
after it. What cannot run is fenced as ``text``.
"""

import re
import shlex
from dataclasses import dataclass

_FENCE = re.compile(r"^( *)```(\w*)[^\n]*\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
_FILE_NAME = re.compile(r"\A(?:#|//) ([\w-]+\.\w+)\n")
_SIZES = re.compile(
    r"(\b(?:width|height|face_size|size)(?:=|: )|--(?:size|face-size|overscan)[ =\0])(\d+)(?:x(\d+))?"
)
_SHELLS = ("sh", "bash", "console")

LEAST_PX = 32
SHRINK = 8
"""Sizes in documents are divided by SHRINK, but not below LEAST_PX: what they show is that it runs."""


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text without indentation, and the line it begins at."""

    language: str
    text: str
    line: int

    def file_name(self):
        """The name of the file that the block is, or None."""
        found = _FILE_NAME.match(self.text)
        return found[1] if found and self.language not in (*_SHELLS, "python") else None

    def commands(self):
        if self.language not in _SHELLS:
            return []
        lines = re.sub(r"\\\n\s*", " ", self.text).split("\n")
        return [words for line in lines if (words := command(line))]


def blocks(document):
    found = []
    for match in _FENCE.finditer(document):
        indent = match[1]
        text = re.sub(f"^{indent}", "", match[3], flags=re.MULTILINE)
        found.append(Block(match[2], text, document.count("\n", 0, match.start()) + 2))
    return found


def command(line):
    """The words of a line that runs omniscv or a script; none for others."""
    words = shlex.split(line.strip().removeprefix("$ "), comments=True)
    return words if words and (words[0] == "omniscv" or words[0].startswith("./scripts/")) else []


def shrunk(text):
    """Python, a command line or a file with smaller images."""

    def smaller(found):
        sizes = [max(min(int(size), LEAST_PX), int(size) // SHRINK) for size in found.groups()[1:] if size]
        return found[1] + "x".join(map(str, sizes))

    return _SIZES.sub(smaller, text)


def at_ports(text, ports):
    """Python or a command line with the ports that documents name replaced by those of servers that run."""
    for documented, actual in ports.items():
        text = re.sub(rf"\b{documented}\b", str(actual), text)
    return text


def unfenced(document):
    """Command lines that no fence of a shell holds: they would not be run."""
    rest = _FENCE.sub(lambda found: "" if found[2] in (*_SHELLS, "text", "python") else found[0], document)
    return [line for line in rest.split("\n") if re.match(r"(?:    )?(?:\$ )?(omniscv |\./scripts/)", line)]


def examples(text):
    """The command lines after ``Example:`` in a help text."""
    found = re.findall(r"Example: ?(omniscv (?:[^\n]|\n(?!\n))*)", text or "")
    return [shlex.split(" ".join(line.split())) for line in found]
