"""SLURM's array, and the places of workers."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from omniscv.cluster import scheduler_at, workers_of
from omniscv.errors import ArgumentError, ClusterError

EXAMPLE = Path(__file__).parents[2] / "examples" / "slurm-array.sh"


def test_the_array_s_script_makes_a_part_in_each_task(tmp_path, monkeypatch):
    program = Path(sys.executable).with_name("shellcheck")
    checked = subprocess.run([program, EXAMPLE], capture_output=True, text=True, timeout=60, check=False)
    assert checked.returncode == 0, checked.stdout
    assert "\n#SBATCH --array=0-63\n" in EXAMPLE.read_text()
    command = tmp_path / "omniscv"
    command.write_text('#!/bin/sh\necho "$@"\n')
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "4")
    commands = []
    for i in range(4):
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", str(i))
        done = subprocess.run([EXAMPLE, "room.yaml"], capture_output=True, text=True, timeout=60, check=True)
        commands.append(done.stdout.split())
    assert commands == [["dataset", "make", "room.yaml", "--shard", f"{i}/4"] for i in range(4)]


@pytest.mark.parametrize("text", ["local:0", "local:x", "slurm:a.yaml", "somewhere", "http://node:8786", ""])
def test_a_place_that_is_none_is_refused(text):
    with pytest.raises(ArgumentError, match=r"--cluster: expected local, local:N or"):
        workers_of(text)


def test_no_scheduler_is_one_line():
    with pytest.raises(ClusterError, match="expected a scheduler of Dask at tcp"):
        scheduler_at("tcp://127.0.0.1:1", ["mock://four-wall"], timeout_s=0.1).__enter__()
