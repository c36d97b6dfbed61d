"""What is imported, by name: nothing that a first image does not need."""

import subprocess
import sys

RENDER = """import sys
from omniscv.cli import run
assert run(["render", "--source", "{}://four-wall", "--size", "16x8", "--out", sys.argv[1]]) == 0"""
WITHOUT = {
    "import omniscv.cameras": {"scipy", "numba", "cv2", "matplotlib", "yaml"},
    "import omniscv.sources": {"numba"},
    RENDER.format("scene"): {"matplotlib", "unrealcv", "ssl", "scipy.sparse", "numba", "embreex", "trimesh"},
    RENDER.format("mock"): {
        "scipy.spatial",
        "scipy.ndimage",
        "scipy.linalg",
        "omniscv.calibration",
        "docker",
    },
}
"""What one process does, step by step, and what it has not imported then."""


def test_without_slow_libraries(tmp_path):
    script = "".join(f"{step}\nimport sys; print('modules', *sys.modules)\n" for step in WITHOUT)
    command = [sys.executable, "-c", script, tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    imported = [line.split() for line in done.stdout.splitlines() if line.startswith("modules")]
    for (step, without), modules in zip(WITHOUT.items(), imported, strict=True):
        assert not without & set(modules), step
