"""The official client, as omniscv imports it."""

import os
import subprocess
import sys

import pytest

IMPORTED = """
import sys
import omniscv.sources.unreal.client
import unrealcv
print({heavy!r} in sys.modules, unrealcv.Client.__module__)
print(unrealcv.{name}.__module__, {heavy!r} in sys.modules)
"""


def printed(program):
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    ("name", "module", "heavy"),
    [("RunDocker", "unrealcv.launcher", "docker"), ("UnrealCv_API", "unrealcv.api", "PIL")],
)
def test_what_is_not_used_of_it_is_imported_when_it_is_asked_for(name, module, heavy):
    assert printed(IMPORTED.format(name=name, heavy=heavy)) == ["False unrealcv", f"{module} True"]


def test_a_name_that_it_lacks_is_an_error_of_python():
    program = "import omniscv.sources.unreal.client, unrealcv; print(hasattr(unrealcv, 'NoSuchName'))"
    assert printed(program) == ["False"]


OLD = """
class BaseClient:
    def __init__(self, endpoint, raw_message_handler): ...
class Client(BaseClient):
    def __init__(self, endpoint, message_handler=None): ...
"""


def test_an_old_client_that_was_installed_over_it_is_one_line(tmp_path):
    """As 'pip install unrealcv==0.3.10' leaves it."""
    (tmp_path / "unrealcv").mkdir()
    (tmp_path / "unrealcv" / "__init__.py").write_text(OLD)
    program = "from omniscv.cli import run; print(run(['record', '--source', 'unreal://localhost:1']))"
    there = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=there)
    assert done.stdout == "1\n"
    assert done.stderr.startswith("omniscv: unrealcv: expected client 1.3.2 or later, got an older one in ")
    assert "an environment of their own, beside 'omniscv serve' in this one" in done.stderr
