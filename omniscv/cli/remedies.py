"""What to type next: remedies of errors, and how to go on, in the words that were typed."""

import shlex
from collections.abc import Sequence

from omniscv.errors import (
    LONGEST_LINE,
    AdvisedError,
    ExistingDatasetError,
    FailedFramesError,
    OmniscvError,
    OtherDatasetError,
)

_GOES_ON = (("dataset", "make"), ("record",))
"""The commands that go on where they were stopped if they are typed again."""
_ONCE = ("--overwrite", "--resume")
"""Flags of the first try: the next one goes on with what is there, which needs no flag."""

_LONGEST = LONGEST_LINE // 2
"""Characters of a command line that is printed; a longer one would be cut in an error's line."""


def command_line(arguments: Sequence[str], *, more: Sequence[str] = (), without: Sequence[str] = ()) -> str:
    """Return the command line that was typed, for a shell.

    Args:
        arguments: of the command, without its name.
        more: arguments that are added.
        without: arguments that are left out, with their values if they stand before ``=`` or a blank.
    """
    from omniscv.storage import without_secrets

    words = ["omniscv"]
    is_value = False
    for argument in arguments:
        name, equals, _ = argument.partition("=")
        if name in without:
            is_value = not equals and name not in _ONCE
        elif is_value:
            is_value = False
        else:
            words.append(without_secrets(argument))
    return shlex.join([*words, *more])


def go_on(arguments: Sequence[str], *, without: Sequence[str] = ()) -> str:
    """Return the command line that goes on with what a ``dataset make`` or ``record`` has begun.

    Args:
        arguments: of the command that was typed, without its name.
        without: arguments that are left out besides ``--overwrite``, which would begin anew.
    """
    line = command_line(arguments, without=(*_ONCE, *without))
    if len(line) <= _LONGEST:
        return line
    return f"the same command, without {' and '.join((*_ONCE, *without))} if it has them"


def stopped(arguments: Sequence[str]) -> str:
    """Return the line of a command that a signal has stopped."""
    for words in _GOES_ON:
        if tuple(arguments[: len(words)]) == words:
            return f"stopped; what is complete is kept; this goes on: {go_on(arguments)}"
    return "stopped; files that are complete are kept"


def advised(error: OmniscvError, arguments: Sequence[str]) -> OmniscvError:
    """Return an error of a command with the remedy that this command has.

    Args:
        error: that was raised.
        arguments: of the command, without its name.
    """
    if not isinstance(error, AdvisedError) or tuple(arguments[:2]) != ("dataset", "make"):
        return error
    if isinstance(error, ExistingDatasetError):
        return error.advised(f"this completes it: {go_on(arguments)}")
    if isinstance(error, FailedFramesError):
        return error.advised(f"this tries them again: {go_on(arguments)}")
    if isinstance(error, OtherDatasetError) and not {"--shard", "--cluster"}.intersection(_names(arguments)):
        replacing = command_line(arguments, more=("--overwrite",), without=_ONCE)
        return error.advised(f"write elsewhere, or this replaces the dataset: {replacing}")
    return error.advised("write elsewhere")


def _names(arguments: Sequence[str]) -> set[str]:
    """Return the names of arguments, without values behind ``=``."""
    return {argument.partition("=")[0] for argument in arguments}
