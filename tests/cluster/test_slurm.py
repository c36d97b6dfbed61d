"""SLURM's array, whose tasks run here; places of workers."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.datasets import job_file, tree

from omniscv import cli
from omniscv.cluster import scheduler_at, workers_of
from omniscv.errors import ArgumentError, ClusterError

EXAMPLE = Path(__file__).parents[2] / "examples" / "slurm-array.sh"


def test_the_array_s_script_makes_the_dataset_again_where_a_part_was_lost(tmp_path, monkeypatch):
    """The command of each task is noted, and run here: starting Python for each part takes long."""
    program = Path(sys.executable).with_name("shellcheck")
    checked = subprocess.run([program, EXAMPLE], capture_output=True, text=True, timeout=60, check=False)
    assert checked.returncode == 0, checked.stdout
    assert "\n#SBATCH --array=0-63\n" in EXAMPLE.read_text()
    command = tmp_path / "omniscv"
    command.write_text('#!/bin/sh\necho "$@"\n')
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "4")
    job, commands = job_file(tmp_path), []
    for i in range(4):
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", str(i))
        done = subprocess.run([EXAMPLE, job], capture_output=True, text=True, timeout=60, check=True)
        commands.append(done.stdout.split())
    assert commands == [["dataset", "make", str(job), "--shard", f"{i}/4"] for i in range(4)]
    assert cli.run(["dataset", "make", str(job_file(tmp_path, out="single"))]) == 0
    for lost in (3, None):
        for i, each in enumerate(commands):
            if lost is not None or i == 3:
                assert i == lost or cli.run(each) == 0
        assert (tmp_path / "dataset" / "frames.jsonl").exists() == (lost is None)
    assert tree(tmp_path / "dataset") == tree(tmp_path / "single")


@pytest.mark.parametrize("text", ["local:0", "local:x", "slurm:a.yaml", "somewhere", "http://node:8786", ""])
def test_a_place_that_is_none_is_refused(text):
    with pytest.raises(ArgumentError, match=r"--cluster: expected local, local:N or"):
        workers_of(text)


def test_no_scheduler_is_one_line():
    with pytest.raises(ClusterError, match="expected a scheduler of Dask at tcp"):
        scheduler_at("tcp://127.0.0.1:1", ["mock://four-wall"], timeout_s=0.1).__enter__()
