"""How long the package takes to import, and the shortest command, all in the page cache.

The goals are 0.1 s for ``import omniscv`` and 0.25 s for ``omniscv --version``, the whole process. numpy's
import, in a process of its own like the others, is the peer.
"""

import subprocess
import sys
import time
from collections.abc import Iterator

from benches import Figure, Reference

NUMPY, OMNISCV, VERSION = "import numpy", "import omniscv", "omniscv --version"


def measure(quick: bool) -> Iterator[Figure]:
    measured = {NUMPY: lambda: importing("numpy"), OMNISCV: lambda: importing("omniscv"), VERSION: version}
    times: dict[str, list[float]] = {name: [] for name in measured}
    for _ in range(1 if quick else 8):
        for name, once in measured.items():
            times[name].append(1e3 * once())
    best = {name: min(each) for name, each in times.items()}
    yield Figure("start, warm", OMNISCV, "ms", best[OMNISCV], Reference(NUMPY, best[NUMPY]))
    yield Figure("start, warm", OMNISCV, "ms", best[OMNISCV], limit=Reference("goal", 100))
    yield Figure("start, warm", VERSION, "ms", best[VERSION], limit=Reference("goal", 250))


def importing(name: str) -> float:
    """Return the seconds that an import takes in a new process."""
    timed = f"import time; t = time.perf_counter(); import {name}; print(time.perf_counter() - t)"
    return float(subprocess.check_output([sys.executable, "-c", timed]))


def version() -> float:
    """Return the seconds from the command to its end."""
    started = time.perf_counter()
    shortest = "import sys; from omniscv.cli import main; sys.argv = ['omniscv', '--version']; main()"
    subprocess.check_output([sys.executable, "-c", shortest])
    return time.perf_counter() - started
