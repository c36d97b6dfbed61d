"""The command line: arguments in, one clear line out when something is wrong.

Exit codes: 0 done; 1 failed; 2 wrong usage; 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import sys

import typer
from typer.exceptions import TyperException

import omniscv
from omniscv.cli import chart, doctor, look, make
from omniscv.cli.progress import err, out
from omniscv.errors import ArgumentError, OmniscvError

_STOPPED = 130  # what shells report for Ctrl-C

app = typer.Typer(
    name="omniscv",
    help="Omnidirectional images with exact ground truth, from captures of virtual worlds.",
    epilog="Start with: omniscv demo out/",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
make.add_to(app)
look.add_to(app)
chart.add_to(app)
doctor.add_to(app)


def _version(wanted: bool) -> None:
    if wanted:
        out.print(f"omniscv {omniscv.__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="The version."),
) -> None:
    pass


def main(arguments: list[str] | None = None) -> None:
    """Runs a command line and ends the process with its exit code."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: list[str]) -> int:
    """Runs a command line.

    Returns:
        The exit code; every failure has printed one line on standard error.
    """
    try:
        code = app(arguments, prog_name="omniscv", standalone_mode=False)
    except typer.Exit as done:
        code = done.exit_code
    except TyperException as usage:
        return _say(f"{usage.format_message()} (omniscv --help tells more)", usage.exit_code)
    except ArgumentError as error:
        return _say(error, 2)
    except (OmniscvError, OSError) as error:
        return _say(error, 1)
    if code == _STOPPED:
        return _say("stopped; what was captured is in the record, run the command again to go on", _STOPPED)
    return code if isinstance(code, int) else 0


def _say(message: object, code: int) -> int:
    err.print(f"omniscv: {' '.join(str(message).split())}", markup=False)
    return code
