"""The official client, as omniscv imports it."""

import subprocess
import sys

IMPORTED = """
import sys
import omniscv.sources.unreal.client
import unrealcv
print("docker" in sys.modules, unrealcv.Client.__module__)
print(unrealcv.RunDocker.__module__, "docker" in sys.modules)
"""


def test_its_launcher_is_imported_when_it_is_asked_for():
    done = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["False unrealcv", "unrealcv.launcher True"]
