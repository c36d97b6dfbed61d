"""How long a process takes to import the package, to run the shortest command, and to its first image.

All is in the page cache, and numba's kernels are in its own. The goals are 0.1 s for ``import omniscv``,
0.25 s for ``omniscv --version`` and 0.7 s for an image, the whole process. numpy's import, in a process of
its own like the others, is the peer; a process that runs one small kernel of numba is that of the image.
"""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benches import Figure, Reference

NUMPY, OMNISCV, VERSION = "import numpy", "import omniscv", "omniscv --version"
KERNEL, IMAGE = "a kernel of numba", "first image, 256x128"

KERNEL_PROGRAM = """
import numba

@numba.njit(cache=True)
def doubled(value):
    return 2 * value

doubled(1.0)
"""
IMAGE_PROGRAM = """
import omniscv

camera = omniscv.cameras.create("equirectangular", width=256, height=128)
with omniscv.open_source("scene://four-wall?traces=0") as source:
    omniscv.render(camera, omniscv.Pose.from_angles((0, 0, 1.5)), source)
"""


def measure(quick: bool) -> Iterator[Figure]:
    times: dict[str, list[float]] = {name: [] for name in (NUMPY, OMNISCV, VERSION, KERNEL, IMAGE)}
    with TemporaryDirectory() as folder:
        kernel = Path(folder) / "kernel.py"  # a file: what is in none is not cached
        kernel.write_text(KERNEL_PROGRAM)
        measured = {
            NUMPY: lambda: importing("numpy"),
            OMNISCV: lambda: importing("omniscv"),
            VERSION: version,
            KERNEL: lambda: running(str(kernel)),
            IMAGE: lambda: running("-c", IMAGE_PROGRAM),
        }
        for _ in range(1 if quick else 8):
            for name, once in measured.items():
                times[name].append(1e3 * once())
    best = {name: min(each) for name, each in times.items()}
    yield Figure("start, warm", OMNISCV, "ms", best[OMNISCV], Reference(NUMPY, best[NUMPY]))
    yield Figure("start, warm", OMNISCV, "ms", best[OMNISCV], limit=Reference("goal", 100))
    yield Figure("start, warm", VERSION, "ms", best[VERSION], limit=Reference("goal", 250))
    yield Figure("start, warm", IMAGE, "ms", best[IMAGE], Reference(KERNEL, best[KERNEL]))
    yield Figure("start, warm", IMAGE, "ms", best[IMAGE], limit=Reference("goal", 700))


def importing(name: str) -> float:
    """Return the seconds that an import takes in a new process."""
    timed = f"import time; t = time.perf_counter(); import {name}; print(time.perf_counter() - t)"
    return float(subprocess.check_output([sys.executable, "-c", timed]))


def version() -> float:
    """Return the seconds from the command to its end."""
    shortest = "import sys; from omniscv.cli import main; sys.argv = ['omniscv', '--version']; main()"
    return running("-c", shortest)


def running(*arguments: str) -> float:
    """Return the seconds that a process of Python takes."""
    started = time.perf_counter()
    subprocess.check_output([sys.executable, *arguments])
    return time.perf_counter() - started
