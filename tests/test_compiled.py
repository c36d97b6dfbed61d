"""Kernels from the cache: what a process loads to run them."""

import os
import subprocess
import sys
from pathlib import Path

from support.full_disk import largest_file

import mock_server
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

@njit(cache=False)
def quadrupled(values):
    return doubled(doubled(values))

assert quadrupled(np.arange(3.0)).tolist() == [0, 4, 8]
"""


def run(tmp_path, source=KERNEL, **environment):
    """Run the kernel in a process of its own; return it."""
    path = tmp_path / "kernels.py"
    path.write_text(source)
    return subprocess.run(
        [sys.executable, path], env={**os.environ, **environment}, capture_output=True, text=True, check=True
    )


def test_a_kernel_of_the_cache_runs_without_what_compiles(tmp_path):
    """That costs half a second, most of it SciPy's linear algebra. What is compiled later works as well."""
    printed = [run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "cache")).stdout for _ in "12"]
    assert printed == ["0 True\n", "1 False\n"]


def test_a_kernel_that_the_disk_has_no_space_for_runs_and_is_compiled_again(tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    with largest_file(2000):  # enough for the index, not for the kernel
        assert run(tmp_path, **cache).stdout == "0 True\n"
    assert [run(tmp_path, **cache).stdout for _ in "12"] == ["0 True\n", "1 False\n"]


def test_a_kernel_that_could_not_be_kept_leaves_no_older_one(tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    triple = KERNEL.replace("2 *", "3 *").replace("2, 4", "3, 6").replace("4, 8", "9, 18")
    assert run(tmp_path, triple, **cache).stdout == "0 True\n"
    with largest_file(2000):
        assert run(tmp_path, **cache).stdout == "0 True\n"
    assert run(tmp_path, **cache).stdout == "0 True\n"


def test_without_a_folder_for_it_a_kernel_is_compiled_each_time(tmp_path):
    """As of a package that cannot be written to, for a user without a home."""
    nowhere = {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator", "NUMBA_CACHE_DIR": "/dev/null/x"}
    ran = run(tmp_path, **nowhere)
    assert ran.stdout == "0 True\n"
    assert ran.stderr.count("set NUMBA_CACHE_DIR to a folder that can be written to") == 1


def test_kernels_take_that_decorator():
    """numba's own would load slowly, and raise an error where there is no folder."""
    package = Path(omniscv.__file__).parent
    importing = [
        path
        for path in package.rglob("*.py")
        if "import numba" in (text := path.read_text()) or "from numba" in text
    ]
    assert {str(path.relative_to(package)) for path in importing} == {
        "compiled.py",
        "diagnostics/compiled.py",
    }


def test_the_mock_server_shares_no_code_and_so_has_a_copy():
    files = [Path(each.__file__).with_name("compiled.py") for each in (omniscv, mock_server)]
    assert files[0].read_bytes() == files[1].read_bytes()
