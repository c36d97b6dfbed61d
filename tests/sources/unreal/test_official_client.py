"""The official client, as omniscv imports it."""

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
