"""Names of recordings that are parts of one: each is recorded by a process of its own, at the same time."""

from pathlib import Path
from typing import TypeVar

from omniscv.arguments import whole_number

Where = TypeVar("Where", str, Path)


def part_file(where: Where, index: int, count: int) -> Where:
    """Return where part ``index`` of ``count``, from 0, is recorded: ``room.part-0-of-4.sqlite``.

    Args:
        where: path or URL of the whole recording.
        index: 0 to ``count`` - 1.
        count: of parts, 1 or more.

    Raises:
        ArgumentError: another index or count.
    """
    whole_number("part", count, least=1)
    whole_number("part", index, least=0, most=count - 1)
    folder, slash, name = str(where).rpartition("/")
    stem, dot, suffix = name.rpartition(".")
    stem, suffix = (stem, dot + suffix) if stem else (name, "")
    return type(where)(f"{folder}{slash}{stem}.part-{index}-of-{count}{suffix}")


def part_files(where: Where, count: int) -> list[Where]:
    """Return where all parts of a recording are, whether they are there or not."""
    return [part_file(where, index, count) for index in range(count)]
