"""The list of commands, and that nothing is loaded that is not needed."""

import re
import subprocess
import sys

import pytest

import omniscv
from omniscv.cli import COMMANDS, run


def test_help_lists_every_command_with_its_summary(capsys):
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    for name in COMMANDS:
        assert re.search(rf"│ {name} +[A-Z]\w+", text), name


def loaded_by(*arguments):
    """The modules that a command line loads, in a process of its own."""
    program = f"import sys; from omniscv.cli import run; code = run({list(arguments)!r})"
    report = "; print(*sys.modules, file=sys.stderr); sys.exit(code)"
    done = subprocess.run(
        [sys.executable, "-c", program + report], capture_output=True, text=True, check=True
    )
    return done.stdout, set(done.stderr.split())


HEAVY = {"numpy", "numba", "cv2", "scipy", "matplotlib", "OpenImageIO", "mock_server", "omniscv.make"}


def test_version_loads_no_command():
    printed, modules = loaded_by("--version")
    assert printed == f"omniscv {omniscv.__version__}\n"
    assert modules.isdisjoint(HEAVY | {"rich"})
    assert modules.isdisjoint(f"omniscv.cli.{name}" for name in COMMANDS.values())


@pytest.mark.parametrize("command", ["render", "serve"])
def test_help_of_a_command_loads_the_module_of_that_command_alone(command):
    _, modules = loaded_by(command, "--help")
    assert modules.isdisjoint(HEAVY - {"mock_server"} if command == "serve" else HEAVY)
    assert modules & {f"omniscv.cli.{name}" for name in COMMANDS.values()} == {
        f"omniscv.cli.{COMMANDS[command]}"
    }
