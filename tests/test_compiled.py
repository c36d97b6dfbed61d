"""Kernels from the cache: what a process loads to run them."""

import inspect
import os
import subprocess
import sys

import pytest
from support.full_disk import largest_file

from mock_server import compiled as mock_compiled
from omniscv import compiled

KERNEL = """
import sys
import numpy as np
from {package}.compiled import njit

@njit(cache=True, nogil=True)
def doubled(values):
    found = np.empty(len(values))
    for i in range(len(values)):
        found[i] = 2 * values[i]
    return found

assert doubled(np.arange(3.0)).tolist() == [0, 2, 4]
print(sum(doubled.stats.cache_hits.values()), "scipy.linalg" in sys.modules)
"""


@pytest.mark.parametrize("package", ["omniscv", "mock_server"])
def test_a_kernel_of_the_cache_runs_without_what_compiles(package, tmp_path):
    """That costs half a second, most of it SciPy's linear algebra."""
    path = tmp_path / "kernels.py"
    path.write_text(KERNEL.format(package=package))
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    printed = [subprocess.check_output([sys.executable, path], env=environment, text=True) for _ in "12"]
    assert printed == ["0 True\n", "1 False\n"]


def test_the_mock_server_caches_as_omniscv_does():
    ours, its = (inspect.getsource(module).split('"""', 2)[2] for module in (compiled, mock_compiled))
    assert ours == its


def test_a_kernel_that_the_disk_has_no_space_for_runs_and_is_compiled_again(tmp_path):
    path = tmp_path / "kernels.py"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}

    def printed():
        return subprocess.check_output([sys.executable, path], env=environment, text=True)

    triple = KERNEL.replace("2 *", "3 *").replace("2, 4", "3, 6")
    path.write_text(triple.format(package="omniscv"))
    assert printed() == "0 True\n"
    path.write_text(KERNEL.format(package="omniscv"))  # the files of the kernel before are in the cache
    with largest_file(2000):  # enough for the index, not for the kernel
        assert printed() == "0 True\n"
    assert printed() == "0 True\n"
    assert printed() == "1 False\n"
