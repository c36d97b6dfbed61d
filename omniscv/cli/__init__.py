"""The command line, whose modules are imported when one of their commands is used.

Exit codes: 0 done; 1 failed; 2 wrong usage; 128 + the number of the signal that stopped it, 130 by Ctrl-C.
"""

import gc
import os
import re
import sys
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

import omniscv
from omniscv.cli import console
from omniscv.cli.remedies import advised, stopped
from omniscv.errors import ArgumentError, OmniscvError
from omniscv.parallel import keep_freed_memory

COMMANDS = {
    "demo": "reports", "render": "images", "record": "images", "plan": "images", "job": "images",
    "look": "reports", "reproject": "reprojecting", "score": "scoring", "serve": "servers",
    "scenes": "servers", "cameras": "cameras",
    "recording": "recording", "dataset": "dataset", "chart": "reports", "evaluate": "reports",
    "doctor": "servers", "send": "servers",
}  # fmt: skip
"""The commands, and the modules of this package in whose ``app`` they are."""
_OBJECTS_PER_COLLECTION = 10_000
"""New objects after which Python looks for circles among them; by 700, its own figure, it does so hundreds of
times while modules are imported, which takes 4 % of the processor time of a first image."""


class _Commands(TyperGroup):
    """Imports the module of a command when the command is looked up."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        names: dict[str, Any] = dict.fromkeys(COMMANDS)
        self.commands = names  # for lists and suggestions

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command ``cmd_name``, None if there is no such; ``ctx`` is not used."""
        if cmd_name not in COMMANDS:
            return None
        group = typer.main.get_group(import_module(f"omniscv.cli.{COMMANDS[cmd_name]}").app)
        return group.commands.get(cmd_name, group)  # such as cameras, which is a group itself


def _version(is_given: bool) -> None:
    """Print the version and exit."""
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


def _usage_text(usage: TyperException, arguments: list[str]) -> str:
    """Return the message of wrong usage, with the value of the option that it names; empty if help was
    printed."""
    text = usage.format_message().replace("Value error, ", "")
    words = "\0".join(arguments)
    position = re.search(r"--position[\0=](\S+?)\0(-?[\d.]+)\0(-?[\d.]+)(?:\0|$)", words)
    if text and position:  # written with blanks
        return f"--position: expected numbers with commas: --position {','.join(position.groups())}"
    for name in getattr(getattr(usage, "param", None), "opts", ()):
        match = re.search(rf"(?:^|\0){name}[\0=]([^\0]*)", words)
        if match and text.startswith("Invalid value") and repr(match[1]) not in text:
            return f"{text}, got {match[1]!r}"
    return text


def main() -> None:
    """Run the process's command line, and exit with its code."""
    if isinstance(sys.stdout, TextIOWrapper):  # names may have characters that the encoding lacks
        sys.stdout.reconfigure(errors="backslashreplace")
    sys.exit(console.unwound(_run_process))


def _run_process() -> int:
    """Run the command line of the process, with its log on standard error."""
    _print_log()
    keep_freed_memory()
    gc.set_threshold(_OBJECTS_PER_COLLECTION, *gc.get_threshold()[1:])
    return run(sys.argv[1:])


def _has_working_folder() -> bool:
    """Return whether the working folder exists."""
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
        code = int(app(arguments, prog_name="omniscv", standalone_mode=False, obj=arguments) or 0)
    except TyperException as usage:
        code = usage.exit_code
        text = _usage_text(usage, arguments)
        command = getattr(getattr(usage, "ctx", None), "command_path", "omniscv")
        message = text and f"{text} (see {command} --help)"
    except OmniscvError as error:
        code = 2 if isinstance(error, ArgumentError) else 1
        message = str(advised(error, arguments)) or type(error).__name__
    except OSError as error:
        from omniscv.storage.local import refusal

        code = 1
        message = refusal(error)
    except ImportError as error:  # a missing package or system library
        code = 1
        message = f"{error}; 'omniscv doctor --self' checks this installation"
    except MemoryError as error:
        code = 1
        message = f"expected enough memory, got: {error or 'no more'}; choose a smaller size"
    if code == console.STOPPED:
        message = stopped(arguments)
    elif message and not _has_working_folder():
        message = "expected a working folder, this one was deleted; change to another one"
    if message:
        console.error(message)
    return code
