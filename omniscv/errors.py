"""The family of errors: arguments, sources, recordings, storage, clusters, datasets."""

import re
from collections.abc import Sequence
from typing import ClassVar

LONGEST_LINE = 300
"""Characters of an error, at most."""


def printable(text: object) -> str:
    """Return text with every character that is not printable as its escape.

    Control characters, terminal sequences, line ends, marks that reverse or hide text (bidirectional,
    zero-width), and bytes that are no UTF-8 (surrogates) become what Python writes for them.
    """
    shown = str(text)
    if shown.isprintable():
        return shown
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in shown)


_FOLDERS = re.compile(r"(?<![\w.:/])/(?:[^/\s:]+/){2,}")


def one_line(text: object, longest: int = LONGEST_LINE) -> str:
    """Return text in one printable line; of a longer one, folders of paths are left out, then its middle."""
    line = printable(" ".join(str(text).split()))
    if len(line) > longest:
        line = _FOLDERS.sub(".../", line)
    if len(line) <= longest:
        return line
    head = 2 * longest // 3
    return f"{line[:head]} ... {line[head + 5 - longest :]}"


class OmniscvError(Exception):
    """Any error that omniscv raises on purpose.

    ``str(error)`` is one clear line of at most ``longest`` printable characters, whatever is quoted in it.
    """

    longest: ClassVar[int] = LONGEST_LINE

    def __str__(self) -> str:
        return one_line(super().__str__(), self.longest)


class ArgumentError(OmniscvError, ValueError):
    """A wrong argument: the message says what was expected and what came."""


class SourceError(OmniscvError):
    """A source cannot deliver captures."""


class ServerConnectionError(SourceError):
    """No UnrealCV server reachable at the address, or the connection broke."""


class DeadlineError(SourceError):
    """An operation took longer than its deadline."""


class ServerRefusedError(SourceError):
    """The server answered a command with ``error ...``."""


class BadReplyError(SourceError):
    """A reply has the wrong signature, length or shape."""


class TornSetError(SourceError):
    """The world moved while captures were made that belong together: they do not show one instant."""


class RecordingError(OmniscvError):
    """A recording cannot be used."""


class NotARecordingError(RecordingError):
    """The file is no recording, or is damaged beyond reading."""


class DamagedRecordingError(RecordingError):
    """A stored capture does not match its checksum."""


class NewerRecordingError(RecordingError):
    """The recording was written by a later version of omniscv."""


class RecordingNotWritableError(RecordingError):
    """The recording cannot be written: disk full, read-only, or locked."""


class MissingCaptureError(RecordingError):
    """The recording does not hold the capture; the message describes it and the nearest one."""

    longest = 2 * LONGEST_LINE


class StorageError(OmniscvError):
    """A file of a folder or an object store cannot be read or written."""


class MissingFileError(StorageError):
    """There is no file of that name."""


class ClusterError(OmniscvError):
    """A cluster cannot be reached, has lost its scheduler, or cannot do a part of the work."""


class DatasetError(OmniscvError):
    """A dataset cannot be used: files of it are missing, damaged, or not what its manifest lists."""


class UnmatchedNamesError(DatasetError):
    """Objects whose names no rule of ``classes.yaml`` matches.

    Attributes:
        names: of the objects, all of them; the message lists as many as fit.
    """

    longest = 2 * LONGEST_LINE

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        wanted = f"classes: expected a rule for every object, got {len(self.names)} without one"
        listed = ", ".join(self.names)
        advice = "; add rules, or unmatched: other or ignore"
        super().__init__(
            f"{wanted}: {one_line(listed, self.longest - len(wanted) - len(advice) - 2)}{advice}"
        )

    def __reduce__(self) -> tuple[object, ...]:
        return UnmatchedNamesError, (self.names,)
