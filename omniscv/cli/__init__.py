"""The command line: one module per command, imported when the command is used.

Exit codes: 0 done; 1 failed; 2 wrong usage; 128 + the number of the signal that stopped it, 130 by Ctrl-C.
"""

import os
import re
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any, cast

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

import omniscv
from omniscv.cli import console, signals
from omniscv.errors import ArgumentError, OmniscvError
from omniscv.memory import keep_freed_memory

COMMANDS = (
    "demo",
    "render",
    "record",
    "plan",
    "job",
    "look",
    "serve",
    "scenes",
    "cameras",
    "recording",
    "dataset",
    "chart",
    "evaluate",
    "doctor",
    "send",
)
"""Modules of this package, each with an ``app``."""

_OLD = {"captures": "recording", "ask": "send"}
"""Former names of commands, which work in this version and are not in the help."""


class _Modules(Mapping[str, Any]):
    """The commands by name, imported when looked up."""

    def __getitem__(self, name: str) -> Any:
        name = _OLD.get(name, name)
        if name not in COMMANDS:
            raise KeyError(name)
        return typer.main.get_command(import_module(f"omniscv.cli.{name}").app)

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


class _Commands(TyperGroup):
    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = cast(Any, _Modules())


def _version(is_given: bool) -> None:
    if is_given:
        console.line(f"omniscv {omniscv.__version__}")
        raise typer.Exit


_Version = typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")


def _root(version: Annotated[bool, _Version] = False) -> None:
    """Omnidirectional images with exact ground truth, from captures of virtual worlds."""


app = typer.Typer(
    cls=_Commands,
    callback=_root,
    epilog="Start with: omniscv demo out/",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _position_with_blanks(arguments: list[str]) -> str:
    """Return an error for ``--position 0 0 1.5``; empty if the position is written otherwise."""
    match = re.search(r"--position[\0=](\S+?)\0(-?[\d.]+)\0(-?[\d.]+)(?:\0|$)", "\0".join(arguments))
    if match is None:
        return ""
    return f"--position: expected numbers with commas: --position {','.join(match.groups())}"


def _usage_text(usage: TyperException, arguments: list[str]) -> str:
    """Return the message of wrong usage, with the value of the option that it names."""
    text = usage.format_message().replace("Value error, ", "")
    for name in getattr(getattr(usage, "param", None), "opts", ()):
        match = re.search(rf"(?:^|\0){name}[\0=]([^\0]*)", "\0".join(arguments))
        if match and text.startswith("Invalid value") and repr(match[1]) not in text:
            return f"{text}, got {match[1]!r}"
    return text


def main() -> None:
    """Run the process's command line, and exit with its code."""
    if isinstance(sys.stdout, TextIOWrapper):  # names may have characters that the encoding lacks
        sys.stdout.reconfigure(errors="backslashreplace")
    sys.exit(signals.unwound(_run_process))


def _run_process() -> int:
    _print_log()
    keep_freed_memory()
    return run(sys.argv[1:])


def _has_working_folder() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def _print_log() -> None:
    """Print the package's log on standard error, such as that kernels are compiled."""
    import logging

    class Lines(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            console.error(record.getMessage())

    logger = logging.getLogger("omniscv")
    logger.addHandler(Lines())
    logger.setLevel(logging.INFO)


def run(arguments: list[str]) -> int:
    """Run a command line, and return its exit code; every failure prints one line on standard error."""
    message = ""
    try:
        code = int(app(arguments, prog_name="omniscv", standalone_mode=False) or 0)
    except TyperException as usage:
        code, text = usage.exit_code, _usage_text(usage, arguments)
        command = getattr(getattr(usage, "ctx", None), "command_path", "omniscv")
        text = text and (_position_with_blanks(arguments) or text)
        message = text and f"{text} (see {command} --help)"  # no text: help was printed
    except OmniscvError as error:
        code, message = 2 if isinstance(error, ArgumentError) else 1, str(error) or type(error).__name__
    except OSError as error:
        from omniscv.storage.local import refusal

        code, message = 1, refusal(error)
    except ImportError as error:  # a missing package or system library
        code, message = 1, f"{error}; 'omniscv doctor --self' checks this installation"
    except MemoryError as error:
        code, message = 1, f"expected enough memory, got: {error or 'no more'}; choose a smaller size"
    if code == signals.STOPPED:
        message = "stopped; what is complete is kept, rerun to resume"
    elif message and not _has_working_folder():
        message = "expected a working folder, this one was deleted; change to another one"
    if message:
        console.error(message)
    return code
