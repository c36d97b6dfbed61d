"""Runs command lines in this process, and holds what they print to the rules."""

import contextlib
import io
import os
import tempfile
import time
import warnings
from typing import NamedTuple

from omniscv.cli import run
from omniscv.errors import LONGEST_LINE

SECONDS = 1.0
"""Of the processor, for a refusal."""


class FaultError(AssertionError):
    """What an attack found."""


class Outcome(NamedTuple):
    code: int
    out: str
    err: str
    cpu_s: float


def ran(arguments):
    """Run a command line; warnings are errors, and what the process printed may not control a terminal."""
    out = io.StringIO()
    err = io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(),
        no_library_prints(),
    ):
        warnings.simplefilter("error")
        started = time.process_time()
        code = run(list(arguments))
        spent = time.process_time() - started
    outcome = Outcome(code, out.getvalue(), err.getvalue(), spent)
    for text in (outcome.out, outcome.err):
        wild = {each for each in text if not each.isprintable() and each != "\n"}
        require(not wild, f"control characters reach the terminal: {wild!r}")
    require(code in (0, 1, 2), f"exit code {code}")
    if code:
        refused_in_one_line(outcome)
    return outcome


@contextlib.contextmanager
def no_library_prints():
    """Raise where something is written past Python's own streams, as libraries in C do."""
    saved = {number: os.dup(number) for number in (1, 2)}
    with tempfile.TemporaryFile() as file:
        try:
            for number in saved:
                os.dup2(file.fileno(), number)
            yield
        finally:
            for number, previous in saved.items():
                os.dup2(previous, number)
                os.close(previous)
        file.seek(0)
        printed = file.read(1000)
    require(not printed, f"a library prints: {printed!r}")


def refused_in_one_line(outcome):
    """One line of bounded length; none where the command printed a report, as ``verify`` does.

    Lines about options that override a job's keys, boxes that no server told, and exposure that a server
    refuses may come before.
    """
    before = (" overrides ", "no boxes of objects are recorded: ", "colours keep the game's own exposure: ")
    lines = [line for line in outcome.err.splitlines() if not any(each in line for each in before)]
    if (outcome.out and outcome.code == 1) or (not lines and outcome.out.lstrip().startswith("Usage:")):
        return
    require(len(lines) == 1, f"expected one line, got {outcome.err[:500]!r}")
    require(lines[0].startswith("omniscv: "), f"expected 'omniscv: ...', got {lines[0]!r}")
    require(len(lines[0]) <= LONGEST_LINE, f"{len(lines[0])} characters: {lines[0][:400]!r}")


def refused(arguments):
    """Run a command line that must be refused as wrong usage, within a second."""
    outcome = ran(arguments)
    require(outcome.code == 2, f"expected exit code 2, got {outcome.code}: {outcome.err[:300]!r}")
    require(outcome.cpu_s < SECONDS, f"{outcome.cpu_s:.2f} s to refuse it")
    return outcome.err


def clear(error, where=""):
    """Hold a refusal from Python to the same rules."""
    text = str(error)
    require("\n" not in text and len(text) <= LONGEST_LINE, f"{where}: {len(text)} characters: {text[:99]!r}")
    helps = "expected" in text or "known keys" in text or "missing key" in text
    require(helps, f"{where}: expected what was expected, got {text!r}")
    wild = {each for each in text if not each.isprintable()}
    require(not wild, f"{where}: control characters in the message: {wild!r}")


def require(condition, message):
    if not condition:
        raise FaultError(message)


@contextlib.contextmanager
def nothing_left(folder, may_leave=False):
    """A folder to work in; temporary files are made beside it, and none may be left, unless they may."""
    work = folder / "work"
    temporary = folder / "tmp"
    work.mkdir(), temporary.mkdir()
    before = tempfile.tempdir
    previous = os.getcwd()
    tempfile.tempdir = str(temporary)
    os.chdir(work)
    try:
        yield work
        left = [each.name for each in temporary.iterdir()]
        require(may_leave or not left, f"temporary files are left: {left}")
    finally:
        tempfile.tempdir = before
        os.chdir(previous)
