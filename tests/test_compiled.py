"""Kernels from the cache: what a process loads to run them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.full_disk import largest_file

import omniscv

KERNEL = """
import sys
import numpy as np
from omniscv.compiled import njit

@njit(cache=True, nogil=True)
def doubled(values):
    found = np.empty(len(values))
    for i in range(len(values)):
        found[i] = 2 * values[i]
    return found

assert doubled(np.arange(3.0)).tolist() == [0, 2, 4]
print(sum(doubled.stats.cache_hits.values()), "scipy.linalg" in sys.modules)
"""

OF_THE_PROCESS = """
@njit(cache=False)
def quadrupled(values):
    return doubled(doubled(values))

assert quadrupled(np.arange(3.0)).tolist() == [0, 4, 8]
"""


def run(tmp_path, source=KERNEL, **environment):
    path = tmp_path / "kernels.py"
    if not path.exists() or path.read_text() != source:  # older versions of numba compare the time of change
        path.write_text(source)
    return subprocess.run(
        [sys.executable, path], env={**os.environ, **environment}, capture_output=True, text=True, check=True
    )


COMMAND = """
import sys
import mock_server.compiled
from omniscv import cli
mock_server.compiled.SILENT_S = 0
from omniscv.cli import servers
servers._list_scenes = lambda as_json: __import__("kernel")
sys.argv[1:] = ["scenes"]
cli.main()
"""


def test_a_kernel_of_the_cache_runs_without_what_compiles(tmp_path):
    """That costs half a second, most of it SciPy's linear algebra. A full disk keeps neither a kernel, nor an
    older one of its name; the next process compiles again. A command says that it compiles, once."""
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    module = tmp_path / "kernel.py"
    module.write_text(KERNEL.replace("2 *", "3 *").replace("2, 4", "3, 6"))
    assert run(tmp_path, COMMAND, **cache).stdout == "0 True\n"
    module.write_text(KERNEL)
    with largest_file(2000):  # enough for the index, not for the kernel
        assert run(tmp_path, COMMAND, **cache).stdout == "0 True\n"
    module.write_text(f"{KERNEL}{SMALL_KERNEL}tripled(2)\n")
    first, second = (run(tmp_path, COMMAND, **cache) for _ in "12")
    assert (first.stdout, first.stderr) == ("0 True\n", SAID)
    assert (second.stdout, second.stderr) == ("1 False\n", "")


SAID = "omniscv: compiling kernels (once, about 15 s for a first image)\n"


SMALL_KERNEL = """
from omniscv.compiled import njit

@njit(cache=True)
def tripled(value):
    return 3 * value
"""
TWO_SIGNATURES = f"""{SMALL_KERNEL}
assert tripled(2.0) == tripled(2) == 6
print(sum(tripled.stats.cache_hits.values()))
"""


@pytest.mark.soak
def test_a_kernel_of_another_signature_is_not_taken(tmp_path):
    """Processes that compile at the same time may write two kernels under one name: numba numbers files."""
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert run(tmp_path, TWO_SIGNATURES, **cache).stdout == "0\n"
    first, second = sorted((tmp_path / "cache").rglob("*.nbc"))
    second.write_bytes(first.read_bytes())
    assert [run(tmp_path, TWO_SIGNATURES, **cache).stdout for _ in "12"] == ["1\n", "2\n"]


def test_kernels_are_compiled_where_compiling_is_switched_off_and_no_folder_keeps_them(tmp_path):
    """As of a package that cannot be written to, for a user without a home."""
    nowhere = {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator", "NUMBA_CACHE_DIR": "/dev/null/x"}
    done = run(tmp_path, KERNEL + OF_THE_PROCESS, **nowhere, NUMBA_DISABLE_JIT="1")
    assert done.stdout == "0 True\n"
    assert done.stderr.count("set NUMBA_CACHE_DIR to a folder that can be written to") == 1
    assert "NUMBA_DISABLE_JIT is ignored: kernels of omniscv have to be compiled" in done.stderr


def test_kernels_take_that_decorator():
    """numba's own would load slowly, and raise an error where there is no folder."""
    root = Path(omniscv.__file__).parents[1]
    files = [*(root / "omniscv").rglob("*.py"), *(root / "mock_server").rglob("*.py")]
    importing = {
        str(path.relative_to(root))
        for path in files
        if re.search(r"^(import|from) numba\b", path.read_text(), re.MULTILINE)
    }
    assert importing == {"mock_server/compiled.py"}


WITHOUT_PRIVATE_PARTS = """
import importlib
from numba.core import caching, runtime
import mock_server.compiled

assert mock_server.compiled.FAST
for owner, name in [
    (caching, "NullCache"),
    (caching.Cache, "_load_overload"),
    (runtime._nrt_python, "c_helpers"),
]:
    part = getattr(owner, name)
    delattr(owner, name)
    importlib.reload(mock_server.compiled)
    setattr(owner, name, part)
    assert not mock_server.compiled.FAST
"""


@pytest.mark.soak
def test_where_a_private_part_of_numba_is_missing_kernels_use_its_own_cache(tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    printed = [run(tmp_path, WITHOUT_PRIVATE_PARTS + KERNEL, **cache).stdout for _ in "12"]
    assert printed == ["0 True\n", "1 True\n"]
