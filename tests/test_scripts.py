"""``scripts/* --help`` prints what a script is for, and does nothing; unknown options are refused."""

import os
import runpy
import subprocess
import sys

import pytest
from support.command_line import ROOT

SCRIPTS = {
    each.name: each.read_text()
    for each in (ROOT / "scripts").iterdir()
    if os.access(each, os.X_OK) and each.is_file()
}
PYTHON = sorted(name for name, text in SCRIPTS.items() if "python" in text.partition("\n")[0])
SHELL = sorted(SCRIPTS.keys() - set(PYTHON))
PURPOSE = {name: text.split("\n")[1].strip('"# .') for name, text in SCRIPTS.items()}


def test_scripts_are_found():
    assert {"bench", "draw-truths", "record-room"} <= set(PYTHON)
    assert {"test", "demo", "lock"} <= set(SHELL)
    assert all(len(text) > 20 for text in PURPOSE.values())


def run_here(name, option, monkeypatch):
    """Run a script of Python in this process, which has loaded what it needs; return its exit code."""
    monkeypatch.setattr(sys, "argv", [name, option])
    monkeypatch.setattr(sys, "path", [str(ROOT / "scripts"), *sys.path])
    monkeypatch.setitem(os.environ, "attack.environment", "1")  # in which it would start itself again
    monkeypatch.setenv("PYTHONPATH", os.environ.get("PYTHONPATH", ""))  # is as it was when the test ends
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(ROOT / "scripts" / name), run_name="__main__")
    return ended.value.code


@pytest.mark.parametrize("name", PYTHON)
def test_help_of_a_script(name, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert run_here(name, "--help", monkeypatch) == 0
    assert " ".join(PURPOSE[name].split()) in " ".join(capsys.readouterr().out.split())
    assert run_here(name, "--colour", monkeypatch) == 2
    assert capsys.readouterr().err.startswith(f"usage: {name} ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", SHELL)
def test_help_of_a_shell_script(name, tmp_path):
    done = subprocess.run(
        [ROOT / "scripts" / name, "--help"],
        cwd=tmp_path,
        env={"PATH": os.defpath},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert PURPOSE[name] in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_an_option_that_the_lock_does_not_know_is_refused(tmp_path):
    command = [ROOT / "scripts" / "lock", "--hash"]
    done = subprocess.run(command, cwd=tmp_path, env={"PATH": os.defpath}, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "scripts/lock: expected --hashes or nothing, got --hash\n"
