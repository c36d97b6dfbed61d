"""Kernels from the cache: what a process loads to run them."""

import os
import subprocess
import sys

import pytest

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
