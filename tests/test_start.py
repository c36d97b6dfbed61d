"""What is imported, by name: nothing that a first image does not need."""

import subprocess
import sys

import pytest

RENDER = """import sys
from omniscv.cli import run
assert run(["render", "--source", "{}://four-wall", "--size", "16x8", "--out", sys.argv[1]]) == 0"""


@pytest.mark.parametrize(
    ("code", "without"),
    [
        ("import omniscv.cameras", {"scipy", "numba", "cv2", "matplotlib", "yaml"}),
        ("import omniscv.sources", {"numba"}),
        (RENDER.format("scene"), {"matplotlib", "unrealcv", "ssl", "scipy.sparse"}),
        (RENDER.format("mock"), {"scipy.spatial", "scipy.ndimage", "scipy.linalg", "omniscv.calibration"}),
    ],
)
def test_without_slow_libraries(code, without, tmp_path):
    script = f"{code}\nimport sys; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script, tmp_path], capture_output=True, text=True, check=True
    )
    assert not without & set(done.stdout.splitlines()[-1].split())
