"""The family of errors.

::

    OmniscvError
    ├── ArgumentError (also a ValueError)   a wrong argument: what was expected, what came
    ├── SourceError                         captures could not be had
    │   ├── ConnectionFailed                nobody answers, or not as UnrealCV does
    │   ├── DeadlineExceeded                an operation ran past its deadline
    │   ├── ServerRefused                   the server answered ``error ...``
    │   └── BadReply                        the reply is not what the request asks for
    └── RecordError                         a recorded file
        ├── NotARecord                      the file is something else, or damaged beyond reading
        ├── DamagedRecord                   a capture does not match its checksum
        ├── NewerRecord                     written by a later omniscv
        ├── RecordNotWritable               disk full, read-only, locked
        └── MissingCapture                  the record does not hold what was asked
"""

from __future__ import annotations


class OmniscvError(Exception):
    """Anything that omniscv reports on purpose. ``str(error)`` is one clear line."""


class ArgumentError(OmniscvError, ValueError):
    """A wrong argument: the message says what was expected and what came."""


class SourceError(OmniscvError):
    """Captures could not be had from their source."""


class ConnectionFailed(SourceError):
    """Nobody answers at the address, or not as an UnrealCV server does."""


class DeadlineExceeded(SourceError):
    """An operation took longer than its deadline."""


class ServerRefused(SourceError):
    """The server answered a command with ``error ...``."""


class BadReply(SourceError):
    """A reply has the wrong signature, length or shape."""


class RecordError(OmniscvError):
    """A recorded file cannot be used as asked."""


class NotARecord(RecordError):
    """The file is no recording, or is damaged beyond reading."""


class DamagedRecord(RecordError):
    """A stored capture does not match its checksum."""


class NewerRecord(RecordError):
    """The recording was written by a later version of omniscv."""


class RecordNotWritable(RecordError):
    """The recording cannot be written: disk full, read-only, or locked."""


class MissingCapture(RecordError):
    """The recording does not hold a capture that was asked for."""
