"""Kernels from the cache: what a process loads to run them."""

import os
import subprocess
import sys

KERNELS = """
import sys
import numpy as np
import mock_server.compiled
import omniscv.compiled

@omniscv.compiled.njit(cache=True, nogil=True)
def doubled(values):
    found = np.empty(len(values))
    for i in range(len(values)):
        found[i] = 2 * values[i]
    return found

@mock_server.compiled.njit(cache=True, nogil=True)
def halved(values):
    found = np.empty(len(values))
    for i in range(len(values)):
        found[i] = values[i] / 2
    return found

assert doubled(halved(np.arange(3.0))).tolist() == [0, 1, 2]
hits = [sum(each.stats.cache_hits.values()) for each in (doubled, halved)]
print(hits, "scipy.linalg" in sys.modules)
"""


def test_a_kernel_of_the_cache_runs_without_what_compiles(tmp_path):
    """That costs half a second, most of it SciPy's linear algebra. One kernel of each package."""
    path = tmp_path / "kernels.py"
    path.write_text(KERNELS)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    printed = [subprocess.check_output([sys.executable, path], env=environment, text=True) for _ in "12"]
    assert printed == ["[0, 0] True\n", "[1, 1] False\n"]
