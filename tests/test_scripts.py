"""``scripts/* --help`` prints what a script is for, and does nothing; unknown options are refused."""

import os
import re
import runpy
import shutil
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


assert {"bench", "draw-truths", "record-room"} <= set(PYTHON)
assert {"test", "demo", "lock"} <= set(SHELL)


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
    assert len(PURPOSE[name]) > 20
    assert run_here(name, "--help", monkeypatch) == 0
    assert " ".join(PURPOSE[name].split()) in " ".join(capsys.readouterr().out.split())
    assert run_here(name, "--colour", monkeypatch) == 2
    assert capsys.readouterr().err.startswith(f"usage: {name} ")
    assert list(tmp_path.iterdir()) == []


def run_shell(name, option, folder):
    command = [ROOT / "scripts" / name, option]
    done = subprocess.run(command, cwd=folder, env={"PATH": os.defpath}, capture_output=True, text=True)
    assert list(folder.iterdir()) == []
    return done


@pytest.mark.parametrize("name", SHELL)
def test_help_of_a_shell_script(name, tmp_path):
    done = run_shell(name, "--help", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(PURPOSE[name]) > 20
    assert PURPOSE[name] in done.stdout
    if name == "lock":
        done = run_shell(name, "--hashes", tmp_path)
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr == "scripts/lock: expected --keep or nothing, got --hashes\n"


def pinned(lock):
    """Return the hashes of a lock by package and version."""
    text = (ROOT / lock).read_text()
    entries = re.findall(r"^([\w.-]+==.*?) \\\n((?:    --hash.*\n)+)", text, re.MULTILINE)
    return {name.partition(" ")[0]: re.findall(r"sha256:[0-9a-f]{64}", hashes) for name, hashes in entries}


def test_both_locks_have_the_same_versions_and_hashes():
    needed = pinned("requirements.lock")
    tested = pinned("requirements-test.lock")
    assert needed.items() <= tested.items()
    assert all(needed.values())
    names = {name.partition("==")[0] for name in needed}
    assert {"numba", "unrealcv", "uv", "hatchling"} <= names
    assert not {"moto", "pandas", "pyarrow", "playwright", "pycolmap", "pytest", "mypy"} & names
    locks = "requirements.lock", "requirements-test.lock"
    assert not any("://" in (ROOT / lock).read_text() for lock in locks)


@pytest.fixture
def checkout(tmp_path):
    """A folder with a space in its name, and what the demo reads before it has an environment."""
    made = tmp_path / "my checkout"
    (made / "scripts").mkdir(parents=True)
    for name in ("scripts/_environment.sh", "scripts/demo", "requirements.lock", "requirements-test.lock"):
        shutil.copy(ROOT / name, made / name)
    return made


def failed(checkout, **environment):
    """Run the demo, which must fail; return its one line on standard error."""
    done = subprocess.run(
        [checkout / "scripts" / "demo"], env={**os.environ, **environment}, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    return done.stderr


def test_a_python_that_is_missing_is_named_and_an_environment_of_the_user_is_left_alone(checkout):
    wanted = "demo: expected Python 3.11 or later, got 'nix': none; set PYTHON to one\n"
    assert failed(checkout, PYTHON="nix") == wanted
    (checkout / ".venv").mkdir()  # there was none
    assert "move yours away, or install there: pip install ." in failed(checkout)
    assert list((checkout / ".venv").iterdir()) == []


@pytest.mark.soak
def test_without_a_network(checkout):
    offline = {"PIP_NO_INDEX": "1", "PIP_CONFIG_FILE": os.devnull, "PIP_FIND_LINKS": "", "UV_OFFLINE": "1"}
    assert "is there a network?" in failed(checkout, PYTHON=sys.executable, **offline)
    assert (checkout / ".venv" / "omniscv-stamp").read_text() == "unfinished\n"  # made anew the next time


@pytest.mark.soak
@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_types_hold_on_other_systems(platform, tmp_path):
    command = [sys.executable, "-m", "mypy", "--platform", platform, "--cache-dir", tmp_path]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
