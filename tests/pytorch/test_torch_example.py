"""The example feeds batches, and prints a rate for every epoch."""

import os
import subprocess
import sys

from support.command_line import ROOT


def test_batches_are_fed(recording):
    script = ROOT / "examples" / "training" / "torch_batches.py"
    command = [sys.executable, str(script), str(recording), "--workers", "1", "--batch", "2", "--count", "2"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)])}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [line.partition(",")[0] for line in lines] == [f"epoch {i}: 4 images of 512 x 256" for i in (0, 1)]
