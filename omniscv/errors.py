"""The family of errors, and texts of others made safe to print: printable, one line, bounded."""

import re
from collections.abc import Sequence
from typing import Self

LONGEST_LINE = 1000
"""The most characters of an error."""


def printable(text: object) -> str:
    """Return a text with Python's escapes in place of characters that are not printable.

    These are control characters, terminal sequences, line ends, bidirectional and zero-width marks, and
    surrogates (bytes that are not UTF-8).
    """
    shown = str(text)
    if shown.isprintable():
        return shown
    escaped = ""
    for character in shown:
        escaped += character if character.isprintable() else character.encode("unicode_escape").decode()
    return escaped


_FOLDERS = re.compile(r"(?<![\w.:/])/(?:[^/\s:]+/){2,}")


def one_line(text: object, longest: int = LONGEST_LINE) -> str:
    """Return a text in one printable line.

    Args:
        text: of any kind.
        longest: characters that the line may have: it omits folders of paths, then its middle.
    """
    line = printable(" ".join(str(text).split()))
    if len(line) > longest:
        line = _FOLDERS.sub(".../", line)
    if len(line) <= longest:
        return line
    head = 2 * longest // 3
    return f"{line[:head]} ... {line[head + 5 - longest :]}"


class OmniscvError(Exception):
    """Any error that omniscv raises on purpose.

    ``str(error)``, for printing, is one line of at most ``LONGEST_LINE`` printable characters; ``message`` is
    the whole text, for code that adds to it.
    """

    @property
    def message(self) -> str:
        """The whole message."""
        return super().__str__()

    def __str__(self) -> str:
        return one_line(self.message)


class ArgumentError(OmniscvError, ValueError):
    """A wrong argument: the message says what was expected and what came."""


class SourceError(OmniscvError):
    """A source cannot deliver captures."""


class ServerConnectionError(SourceError):
    """No UnrealCV server is reachable at the address, or the connection broke."""


class DeadlineError(SourceError):
    """An operation took longer than its deadline."""


class ServerRefusedError(SourceError):
    """The server answered a command with ``error ...``."""


class MisplacedCameraError(ServerRefusedError):
    """A server's camera is not where it was set, or its pictures do not change when it is moved."""


class SceneChangedError(SourceError):
    """The server shows another scene than when the source was opened."""


class BadReplyError(SourceError):
    """A reply has the wrong signature, length or shape."""


class TornSetError(SourceError):
    """The world moved during a set of captures, so that they do not show one instant."""


class OtherMomentError(TornSetError):
    """A recording holds captures of the same state that show another world than new ones: trying again does
    not help."""


class RecordingError(OmniscvError):
    """A recording cannot be used.

    Attributes:
        reason: what was expected and what came.
        path: path or URL of the recording; None where it is not known.
        advice: what to do.
    """

    def __init__(self, reason: str, path: object = None, advice: str = "") -> None:
        text = reason if path is None else f"{path}: {reason}"
        super().__init__(f"{text}; {advice}" if advice else text)
        self.reason = reason
        self.path = path
        self.advice = advice

    def at(self, path: object, advice: str = "") -> Self:
        """Return the same error of a recording at ``path``, with ``advice`` on what to do."""
        return type(self)(self.reason, path, advice)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.reason, self.path, self.advice)


class NotARecordingError(RecordingError):
    """The file is not a recording, or cannot be read."""


class DamagedRecordingError(RecordingError):
    """A stored capture does not match its checksum."""


class NewerRecordingError(RecordingError):
    """The recording was written by a later version of omniscv."""


class RecordingNotWritableError(RecordingError):
    """The recording cannot be written: disk full, read-only, or locked."""


class OtherSceneError(RecordingNotWritableError):
    """Captures of another scene, or with other mask colours, are not added to a recording."""


class MissingCaptureError(RecordingError):
    """The recording does not hold the capture; the message describes it and the nearest one."""


class StorageError(OmniscvError):
    """A file of a folder or an object store cannot be read or written."""


class MissingFileError(StorageError):
    """A file does not exist."""


class StoreRefusedError(StorageError):
    """An object store refuses a request, or has no such bucket: no other attempt helps."""


class ClusterError(OmniscvError):
    """A cluster cannot be reached, has lost its scheduler, or failed at a shard."""


class DatasetError(OmniscvError):
    """A dataset cannot be used: its files are missing, damaged, or differ from its manifest."""


class DamagedFileError(StorageError, DatasetError):
    """A file has other bytes than its size and checksum say."""


class AdvisedError(OmniscvError):
    """An error whose remedy depends on the front door: a command words it otherwise than a call of Python.

    Attributes:
        reason: what was expected and what came.
        advice: what to do; empty where nobody has said it.
    """

    def __init__(self, reason: str, advice: str = "") -> None:
        super().__init__(f"{reason}; {advice}" if advice else reason)
        self.reason = reason
        self.advice = advice

    def advised(self, advice: str) -> Self:
        """Return the same error with other ``advice``."""
        return type(self)(self.reason, advice)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.reason, self.advice)


class ExistingDatasetError(AdvisedError, ArgumentError):
    """A folder has a dataset where a new one was expected."""


class OtherDatasetError(AdvisedError, ArgumentError):
    """A folder has a dataset of another job than the one that is made."""


class FailedFramesError(AdvisedError, DatasetError):
    """More frames failed than the job allows."""


class UnmatchedNamesError(DatasetError):
    """Objects whose names no rule of ``classes.yaml`` matches.

    Attributes:
        names: of all these objects; the message lists as many as fit.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        wanted = f"classes: expected a rule for every object, got {len(self.names)} without one"
        listed = ", ".join(self.names)
        advice = "; add rules, or unmatched: other or ignore"
        super().__init__(
            f"{wanted}: {one_line(listed, LONGEST_LINE - len(wanted) - len(advice) - 2)}{advice}"
        )

    def __reduce__(self) -> tuple[object, ...]:
        return UnmatchedNamesError, (self.names,)
