"""Kernels from numba's cache, and where there is none."""

import os
import re
import subprocess
import sys
from pathlib import Path

import omniscv

KERNEL = """
import numpy as np
from omniscv.compiled import njit

@njit(cache=True, nogil=True)
def doubled(values):
    found = np.empty(len(values))
    for i in range(len(values)):
        found[i] = 2 * values[i]
    return found

@njit(cache=False)
def quadrupled(values):
    return doubled(doubled(values))

for kind in (np.float64, np.float32):
    assert doubled(np.arange(3, dtype=kind)).tolist() == [0, 2, 4]
print(sum(doubled.stats.cache_hits.values()))
"""
COMMAND = """
import sys
from omniscv import cli
from omniscv.cli import scenes
scenes._list = lambda as_json: __import__("kernels")
sys.argv[1:] = ["scenes"]
cli.main()
"""
SAID = "omniscv: compiling kernels (once, about 15 s for a first image)\n"


def run(tmp_path, source, **environment):
    """Run Python in a process of its own, where ``kernels`` can be imported."""
    path = tmp_path / "kernels.py"
    if not path.exists():  # numba compares the time of change
        path.write_text(KERNEL)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), **environment}
    paths = tmp_path, Path(__file__).parent, environment.get("PYTHONPATH", "")
    environment["PYTHONPATH"] = os.pathsep.join(map(str, paths))
    return subprocess.run(
        [sys.executable, "-c", source], env=environment, capture_output=True, text=True, check=True
    )


def test_kernels_are_compiled_once_which_a_command_says(tmp_path):
    first, second = (run(tmp_path, COMMAND) for _ in "12")
    assert (first.stdout, first.stderr) == ("0\n", SAID)
    assert (second.stdout, second.stderr) == ("2\n", "")


def test_code_of_another_type_under_a_kernels_name_is_compiled_anew(tmp_path):
    """Two processes that compile at the same time may write it."""
    run(tmp_path, "import kernels")
    first, second = sorted((tmp_path / "cache").rglob("*.nbc"))
    second.write_bytes(first.read_bytes())
    assert [run(tmp_path, "import kernels").stdout for _ in "123"] == ["1\n", "1\n", "2\n"]


def test_a_full_disk_keeps_no_code_and_no_older_code_runs_in_its_place(tmp_path):
    """numba's index, written first, would name a file of the older source."""
    run(tmp_path, "import kernels")
    module = tmp_path / "kernels.py"
    module.write_text(KERNEL.replace("2 *", "3 *").replace("2, 4", "3, 6"))
    full = "from support.full_disk import largest_file\nwith largest_file(2000): import kernels"
    for source, hits in ((full, "0\n"), ("import kernels", "0\n"), ("import kernels", "2\n")):
        assert run(tmp_path, source).stdout == hits


def test_kernels_are_compiled_where_compiling_is_switched_off_and_no_folder_keeps_them(tmp_path):
    """As of a package that cannot be written to, for a user without a home."""
    nowhere = {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator", "NUMBA_CACHE_DIR": "/dev/null/x"}
    source = "from kernels import *; assert quadrupled(np.arange(3.0)).tolist() == [0, 4, 8]"
    done = run(tmp_path, source, **nowhere, NUMBA_DISABLE_JIT="1")
    assert done.stdout == "0\n"
    assert done.stderr.count("set NUMBA_CACHE_DIR to a folder that can be written to") == 1
    assert "NUMBA_DISABLE_JIT is ignored: kernels of omniscv have to be compiled" in done.stderr


def test_kernels_take_that_decorator():
    """numba's own would raise an error where no folder can be written to."""
    root = Path(omniscv.__file__).parents[1]
    files = [*(root / "omniscv").rglob("*.py"), *(root / "mock_server").rglob("*.py")]
    importing = {
        str(path.relative_to(root))
        for path in files
        if re.search(r"^(import|from) numba\b", path.read_text(), re.MULTILINE)
    }
    assert importing == {"mock_server/compiled.py"}


def test_sources_are_imported_without_numba():
    """A client that only speaks to a server, or reads a recording, does not wait for a compiler."""
    script = "import sys, omniscv.sources; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
