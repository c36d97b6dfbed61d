"""What workers make, in threads of this process: sampled poses, servers that fail, jobs that are refused."""

import logging
import os
import subprocess
import sys
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import dask
import pytest
from support.datasets import job_file, tree

import omniscv
from omniscv import cluster
from omniscv.cluster import scheduler_at, workers, workers_of
from omniscv.cluster.workers import RESOURCE
from omniscv.errors import ArgumentError, ClusterError, ServerConnectionError
from omniscv.job import load
from omniscv.make import dataset as make_dataset
from omniscv.make import make, parts_of
from omniscv.sources.base import SourceWrapper
from omniscv.sources.registry import open_source

OPENED = Counter()
CLOSED = Counter()
FAULTS = Counter()


class Failing(SourceWrapper):
    """The room; an address that has faults left fails at its next captures."""

    def __init__(self, address):
        super().__init__(open_source("scene://four-wall"))
        self._address = address
        OPENED[address] += 1

    def capture(self, requests):
        if FAULTS[self._address] > 0:
            FAULTS[self._address] -= 1
            raise ServerConnectionError(f"{self._address}: the connection broke")
        return super().capture(requests)

    def close(self):
        CLOSED[self._address] += 1


@contextmanager
def threads(sources):
    """Two workers, named 0 and 1."""
    from distributed import Client, LocalCluster

    options = {"threads_per_worker": 1, "processes": False, "dashboard_address": "127.0.0.1:0"}
    quiet = {"silence_logs": logging.CRITICAL, "resources": RESOURCE}
    with (
        LocalCluster(n_workers=2, **options, **quiet) as started,
        Client(started, set_as_default=False) as client,
    ):
        yield client


@pytest.fixture
def job(tmp_path, monkeypatch):
    """Six parts of a pose each."""
    monkeypatch.setattr(make_dataset, "_FRAMES", 2)
    omniscv.sources.register("failing", Failing)
    for counter in (OPENED, CLOSED, FAULTS):
        counter.clear()
    loaded = load(job_file(tmp_path, source="failing:0"))
    return replace(loaded, modes=("lit", "object_mask"), poses=loaded.poses * 2, times_ns=None, places=None)


def test_servers_that_fail_are_opened_again(job, tmp_path):
    """Each worker has the address of its number."""
    make(replace(job, source="failing:0", out=tmp_path / "single"))
    for counter in (OPENED, CLOSED):
        counter.clear()
    FAULTS.update({"failing:0": 2, "failing:1": 1})
    warnings = []
    seen = []
    there = replace(job, source=("failing:0", "failing:1"))
    made = cluster.make(
        there, threads, warn=warnings.append, progress=lambda now: seen.append((now.frames, now.of_frames))
    )
    assert (made.written, made.missing) == (len(job), 0)
    assert seen[-1] == (len(job), len(job))
    assert {each for each in warnings if "connection broke" in each} == {
        f"worker {i}: failing:{i}: the connection broke" for i in range(2)
    }
    assert OPENED == {"failing:0": 3, "failing:1": 2}
    assert OPENED == CLOSED
    assert tree(job.out) == tree(tmp_path / "single")


def test_repeated_failures_end_the_run(job):
    FAULTS["failing:0"] = 10**6
    with pytest.raises(ClusterError) as failed:
        cluster.make(replace(job, poses=job.poses[:1]), threads)
    message = str(failed.value)
    assert "part 0 failed 6 times, the last time at worker " in message
    assert "failing:0: the connection broke" in message
    assert message.endswith("what is made is kept: making the dataset again goes on")
    assert OPENED["failing:0"] == CLOSED["failing:0"] == 6


def test_after_its_scheduler_has_ended_the_same_command_goes_on(job, tmp_path):
    job = replace(job, source="scene://four-wall", poses=job.poses * 2)
    started = []
    soon = {"distributed.comm.timeouts.connect": "0.1s"}  # workers look for the scheduler at their end

    @contextmanager
    def ending(sources):
        with dask.config.set(soon), threads(sources) as client:
            started.append(client.cluster)
            yield client

    def end(now):
        if now.frames:
            started[0].sync(started[0].scheduler.close)

    with pytest.raises(
        ClusterError, match=r"expected the scheduler to stay.*making the dataset again goes on"
    ):
        cluster.make(job, ending, progress=end)
    made = cluster.make(job, threads)
    assert made.written + made.kept == len(job)
    assert made.kept > 0
    make(replace(job, out=tmp_path / "single"))
    assert tree(job.out) == tree(tmp_path / "single")


def test_a_job_that_cannot_be_made_is_refused_at_once(job):
    (job.out).mkdir()
    (job.out / "objects.json").write_text("{}")
    with pytest.raises(ArgumentError, match="images of 'render'; write elsewhere"):
        cluster.make(job, threads)
    assert OPENED["failing:0"] <= len(parts_of(job))  # no attempt is repeated


def test_sampled_poses_are_found_once(job, tmp_path):
    path = tmp_path / "sampled.yaml"
    start, _, rest = (tmp_path / "dataset.yaml").read_text().partition("poses:\n")
    box = "low: [-1, -1, 1.2], high: [1, 1, 1.8], clearance: 0.3, start: [0, 0, 1.5]"
    path.write_text(f"{start}poses: {{random: {{count: 4, {box}}}}}\nmodes:{rest.partition('modes:')[2]}")
    camera = {"pano": job.cameras["pano"]}
    plain = replace(job.recipe, classes=None)
    sampled = replace(load(path), modes=("lit",), cameras=camera, recipe=plain)
    made = cluster.make(replace(sampled, out=tmp_path / "clustered"), threads)
    assert made.written == 4
    make(replace(sampled, out=tmp_path / "single"))
    assert tree(tmp_path / "clustered") == tree(tmp_path / "single")


def test_a_limit_and_many_worlds_are_the_bytes_of_one_machine(job, tmp_path):
    worlds = tmp_path / "worlds.yaml"
    one = "source: scene://four-wall, poses: [{position: [0, 0, 1.5]}, {position: [0.5, 0, 1.5]}]"
    box = "low: [-1, -1, 1.2], high: [1, 1, 1.8], clearance: 0.3, start: [0, 0, 1.5]"
    other = f"source: scene://six-wall, poses: {{random: {{count: 3, {box}}}}}"
    cameras = "cameras: {pano: {model: equirectangular, width: 32, height: 16}}"
    worlds.write_text(
        f"worlds: {{a: {{{one}}}, b: {{{other}}}}}\n{cameras}\nmodes: [lit]\nface_size: 16\nout: out\n"
    )
    for described, limit in ((load(worlds), None), (replace(job, source="scene://four-wall"), 5)):
        here = replace(described, out=tmp_path / f"single-{limit}")
        there = replace(described, out=tmp_path / f"clustered-{limit}")
        if described.worlds:
            here, there = (
                replace(each, worlds=tuple(replace(world, out=each.out) for world in each.worlds))
                for each in (here, there)
            )
        assert make(here, limit=limit).written == 5
        assert cluster.make(there, threads, limit=limit).written == 5
        assert tree(there.out) == tree(here.out)


def test_memory_of_one_process_is_refused(job):
    with pytest.raises(ArgumentError, match=r"a folder or store that all workers reach, got memory://rooms"):
        cluster.make(replace(job, out="memory://rooms"), threads)
    assert not OPENED


EXAMPLE = Path(__file__).parents[2] / "examples" / "cluster" / "slurm-array.sh"


def test_the_array_s_script_makes_a_part_in_each_task(tmp_path, monkeypatch):
    program = Path(sys.executable).with_name("shellcheck")
    checked = subprocess.run([program, EXAMPLE], capture_output=True, text=True, timeout=60, check=False)
    assert checked.returncode == 0, checked.stdout
    assert "\n#SBATCH --array=0-63\n" in EXAMPLE.read_text()
    command = tmp_path / "omniscv"
    command.write_text('#!/bin/sh\necho "$@"\n')
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "2")  # of --array=5,9
    commands = []
    for parts, index in (("", 5), ("", 9), ("128", 100)):
        monkeypatch.setenv("PARTS", parts)
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", str(index))
        done = subprocess.run([EXAMPLE, "room.yaml"], capture_output=True, text=True, timeout=60, check=True)
        commands.append(done.stdout.split()[-1])
    assert commands == ["5/64", "9/64", "100/128"]


def test_places_that_are_none_and_workers_that_do_not_start_are_one_line(monkeypatch):
    for text in ("local:0", "local:x", "slurm:a.yaml", "somewhere", "http://node:8786", ""):
        with pytest.raises(ArgumentError, match=r"--cluster: expected local, local:N or"):
            workers_of(text)

    def ends(**options):
        raise RuntimeError("a worker died.")

    monkeypatch.setattr(workers, "LocalCluster", ends)
    with pytest.raises(ClusterError, match=r"2 workers to start, but one ended, .*: a worker died; run a"):
        workers_of("local:2")(["mock://four-wall"]).__enter__()
    with pytest.raises(ClusterError, match="expected a scheduler of Dask at tcp"):
        scheduler_at("tcp://127.0.0.1:1", ["mock://four-wall"], timeout_s=0.1).__enter__()
