"""SLURM: what is submitted, checked by shellcheck, and run by an ``sbatch`` that runs it here."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.datasets import job_file, tree
from support.fake_slurm import install

from omniscv import cli
from omniscv.cluster.workers import Address, settings, workers_of
from omniscv.errors import ArgumentError, ClusterError

EXAMPLE = Path(__file__).parents[2] / "examples" / "slurm-array.sh"
SLURM = """
workers: 2
walltime: "01:00:00"
cores: 4
memory: 8 GB
queue: gpu
directives: ["--gres=gpu:1"]
prologue: ["module load unreal"]
"""


@pytest.fixture
def slurm(tmp_path, monkeypatch):
    """A folder in front of PATH with SLURM's commands."""
    install(tmp_path)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    return tmp_path


def shellcheck(path):
    program = Path(sys.executable).with_name("shellcheck")
    return subprocess.run([program, path], capture_output=True, text=True, timeout=60, check=False)


def test_the_array_s_script_makes_the_dataset_again_where_a_part_was_lost(slurm, tmp_path, monkeypatch):
    """Its command is noted, and run here: starting Python for each part takes long."""
    assert shellcheck(EXAMPLE).returncode == 0, shellcheck(EXAMPLE).stdout
    noted = tmp_path / "noted"
    command = tmp_path / "omniscv"
    command.write_text(f'#!/bin/sh\necho "$@" >> "{noted}"\n')
    command.chmod(0o755)
    job, few = job_file(tmp_path), tmp_path / "array.sh"
    few.write_text(EXAMPLE.read_text().replace("--array=0-63", "--array=0-3"))
    done = subprocess.run(["sbatch", few, job], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.startswith("Submitted batch job ")
    commands = [line.split() for line in noted.read_text().splitlines()]
    assert commands == [["dataset", "make", str(job), "--shard", f"{i}/4"] for i in range(4)]
    assert cli.run(["dataset", "make", str(job_file(tmp_path, out="single"))]) == 0
    for lost in (3, None):
        for i, each in enumerate(commands):
            if lost is not None or i == 3:
                assert i == lost or cli.run(each) == 0
        assert (tmp_path / "dataset" / "frames.jsonl").exists() == (lost is None)
    assert tree(tmp_path / "dataset") == tree(tmp_path / "single")


@pytest.mark.parametrize("given", [None, "True"])
def test_workers_start_without_dasks_profiler_unless_the_user_says_so(given, tmp_path, monkeypatch):
    name = "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED"
    monkeypatch.delenv(name, raising=False)
    if given:
        monkeypatch.setenv(name, given)
    path = tmp_path / "slurm.yaml"
    path.write_text(SLURM)
    with workers_of(f"slurm:{path}").cluster() as cluster:
        script = cluster.job_script()
    before, _, _ = script.partition("\nmodule load unreal\n")
    assert (f"\nexport {name}=False" in before) == (given is None)
    assert ("distributed.worker.profile.enabled" in settings()) == (given is None)


def test_the_job_of_a_worker_ends_before_its_time(tmp_path):
    path = tmp_path / "slurm.yaml"
    path.write_text(SLURM)
    found = workers_of(f"slurm:{path}")
    assert found.workers == 2
    with found.cluster() as cluster:
        script = cluster.job_script()
    (tmp_path / "job.sh").write_text(script)
    assert shellcheck(tmp_path / "job.sh").returncode == 0, script
    for line in ("-p gpu", "-t 01:00:00", "--cpus-per-task=4", "--mem=8G", "--gres=gpu:1"):
        assert f"#SBATCH {line}\n" in script
    assert "\nmodule load unreal\n" in script
    assert "--resources server=1" in script.replace("'", "").replace('"', "")
    words = script.split()
    life, stagger = (int(words[words.index(f"--lifetime{end}") + 1].rstrip("s")) for end in ("", "-stagger"))
    assert 0 < stagger < 3600 - life - stagger


@pytest.mark.soak
def test_a_dataset_by_jobs_of_slurm(slurm, tmp_path, capsys):
    path = tmp_path / "slurm.yaml"
    path.write_text(SLURM.replace("module load unreal", "export OMNISCV_CACHE=cache"))
    assert cli.run(["dataset", "make", str(job_file(tmp_path)), "--cluster", f"slurm:{path}"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith("6 frames made, 0 kept; complete")
    assert cli.run(["dataset", "make", str(job_file(tmp_path, out="single"))]) == 0
    assert tree(tmp_path / "dataset") == tree(tmp_path / "single")


def test_a_job_that_slurm_refuses_is_one_line(tmp_path, monkeypatch):
    path = tmp_path / "slurm.yaml"
    path.write_text(SLURM)
    refusing = tmp_path / "sbatch"
    refusing.write_text("#!/bin/sh\necho 'sbatch: error: invalid partition specified: gpu' >&2\nexit 1\n")
    refusing.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    with pytest.raises(ClusterError, match=r"expected SLURM to take a job, got: .*invalid partition"):
        workers_of(f"slurm:{path}").client(["mock://four-wall"]).__enter__()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("workers: 2", "missing key 'walltime'"),
        (SLURM + "gpus: 2", "unknown key 'gpus'; known keys: workers, walltime"),
        (SLURM.replace('"01:00:00"', "60"), "walltime: expected a text"),
        (SLURM.replace("01:00:00", "1h"), "walltime: expected hours:minutes:seconds, at least 10 minutes"),
        (SLURM.replace("01:00:00", "00:05:00"), "walltime: expected hours:minutes:seconds"),
        (SLURM.replace("8 GB", "lots"), "memory: expected an amount such as 16 GB, got 'lots'"),
        (SLURM.replace("workers: 2", "workers: 0"), "workers: expected a whole number >= 1"),
    ],
)
def test_a_wrong_file_is_one_line(text, says, tmp_path):
    path = tmp_path / "slurm.yaml"
    path.write_text(text)
    with pytest.raises(ArgumentError) as failed:
        workers_of(f"slurm:{path}")
    assert says in str(failed.value)
    assert str(path)[:20] in str(failed.value)


@pytest.mark.parametrize("text", ["local:0", "local:x", "slurm:", "somewhere", "http://node:8786", ""])
def test_a_place_that_is_none_is_refused(text):
    with pytest.raises(ArgumentError, match=r"--cluster: expected local, local:N, slurm:FILE\.yaml or"):
        workers_of(text)


def test_no_scheduler_is_one_line():
    with pytest.raises(ClusterError, match="expected a scheduler of Dask at tcp"):
        Address("tcp://127.0.0.1:1", timeout_s=0.1).client(["mock://four-wall"]).__enter__()
