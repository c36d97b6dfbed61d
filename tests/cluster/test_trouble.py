"""What goes wrong on many machines is said soon, by name, and ends: real workers, each a process."""

import json
import logging
import re
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
from distributed import LocalCluster
from support.datasets import tree
from support.processes import OMNISCV, started
from support.trouble import environment

JOB = """
source: {source}
cameras: {{pano: {{model: equirectangular, width: 32, height: 16}}}}
poses:
  path: {{waypoints: [[-1.0, 0.2, 1.5], [1.0, 0.2, 1.5]], speed: 1, rate: {rate}, look: ahead}}
modes: [lit, depth]
face_size: 16
failures: {{skip: {skip}}}
out: {out}
"""


def job_of(folder, out, source="scene://four-wall", skip=0, rate=23.75):
    path = folder / f"{out}.yaml"
    path.write_text(JOB.format(source=source, out=out, skip=skip, rate=rate), encoding="utf-8")
    return path


def made(job, *options, env=None, timeout=240):
    """The exit code, output and lines of errors of a command that makes a dataset."""
    done = subprocess.run(
        [sys.executable, *OMNISCV, "dataset", "make", str(job), *map(str, options)],
        env=env, capture_output=True, text=True, timeout=timeout, check=False,
    )  # fmt: skip
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout, done.stderr.splitlines()


@contextmanager
def scheduler(tmp_path, *workers, env=None):
    """The address of a scheduler and, by name, of workers: processes; ``env`` by name is that of some."""
    file = tmp_path / "scheduler.json"
    command = ("-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
    with started(*command, "--scheduler-file", file, cwd=tmp_path) as serving:
        while not file.exists() or not file.read_text():
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        if not workers:
            yield serving, address
            return
        name = workers[0]
        options = (
            "--name",
            name,
            "--nthreads",
            "1",
            "--resources",
            "server=1",
            "--no-dashboard",
            "--no-nanny",
        )
        where = ("-m", "distributed.cli.dask_worker", address, "--host", "127.0.0.1", *options)
        with started(*where, cwd=tmp_path, env=env), _others(tmp_path, address, workers[1:], env):
            yield serving, address


@contextmanager
def _others(tmp_path, address, names, env):
    if not names:
        yield
        return
    options = (
        "--name",
        names[0],
        "--nthreads",
        "1",
        "--resources",
        "server=1",
        "--no-dashboard",
        "--no-nanny",
    )
    where = ("-m", "distributed.cli.dask_worker", address, "--host", "127.0.0.1", *options)
    with started(*where, cwd=tmp_path, env=env), _others(tmp_path, address, names[1:], env):
        yield


@pytest.mark.soak
def test_a_frame_that_ends_two_workers_is_named(tmp_path):
    env = environment(tmp_path)
    job = job_of(tmp_path, "dying", "trouble://dies@0.95")
    code, _, lines = made(job, "--cluster", "local:2", env=env)
    assert code == 1
    assert re.search(r"pano-4[67]: expected a frame, but 2 workers ended while they made it", lines[-1])
    assert "failures: {skip: 0.01}' leaves such frames out" in lines[-1]
    assert any(re.search(r"worker \d: ended while it made pano-4\d", line) for line in lines)


@pytest.mark.soak
def test_frames_that_end_workers_are_left_out_as_failures_are(tmp_path):
    env = environment(tmp_path)
    job = job_of(tmp_path, "skipped", "trouble://dies@0.95", skip=0.1)
    code, output, lines = made(job, "--cluster", "local:2", env=env)
    assert code == 0, lines
    failed = [json.loads(line) for line in (tmp_path / "skipped" / "failed.jsonl").read_text().splitlines()]
    count = len(failed)
    assert 1 <= count <= 4
    assert all("2 workers ended while they made it" in line["error"] for line in failed)
    assert f"{48 - count} frames made, 0 kept, {count} failed; " in output


@pytest.mark.soak
def test_frames_that_fail_are_counted_and_named_as_by_one_machine(tmp_path):
    env = environment(tmp_path)
    results = []
    for how in ((), ("--cluster", "local:2")):
        job = job_of(tmp_path, f"failing-{len(how)}", "trouble://fails@0.95", skip=0.1)
        code, output, lines = made(job, *how, env=env)
        left_out = sorted(line for line in lines if "left out" in line)
        results.append((code, output.splitlines()[-1].partition(": ")[2], left_out))
    assert results[0] == results[1]
    assert "failed: try them again" in results[0][1]
    assert tree(tmp_path / "failing-0") == tree(tmp_path / "failing-2")


@pytest.mark.soak
def test_keep_going_leaves_out_frames_that_fail_on_workers_too(tmp_path):
    """Both ways report the same frames, one line each, and exit with 1; without it the first one ends all."""
    env = environment(tmp_path)
    results = []
    for how in ((), ("--cluster", "local:2")):
        job = job_of(tmp_path, f"going-{len(how)}", "trouble://fails@0.95")
        code, output, lines = made(job, *how, "--keep-going", env=env)
        left_out = sorted(line for line in lines if "left out" in line)
        results.append((code, output.splitlines()[-1].partition(": ")[2], left_out))
    assert results[0] == results[1]
    code, state, left_out = results[0]
    assert code == 1
    assert 1 <= len(left_out) <= 4
    assert f"{48 - len(left_out)} frames made, 0 kept, {len(left_out)} failed" in state
    assert tree(tmp_path / "going-0") == tree(tmp_path / "going-2")
    code, _, lines = made(job_of(tmp_path, "ending", "trouble://fails@0.95"), "--cluster", "local:2", env=env)
    assert code == 1
    assert "nothing at 0.9" in lines[-1]


@pytest.mark.soak
def test_a_worker_whose_packages_are_of_other_versions_is_named(tmp_path):
    """The package is of one version everywhere, NumPy is not: one worker finds what the other wrote."""
    env = environment(tmp_path)
    odd = tmp_path / "odd"
    odd.mkdir()
    other = environment(odd)
    (odd / "numpy-0.7.dist-info").mkdir()
    (odd / "numpy-0.7.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: numpy\nVersion: 0.7\n")
    with scheduler(tmp_path, "even", env=env) as (_, address), _others(tmp_path, address, ["odd"], other):
        code, _, lines = made(job_of(tmp_path, "mixed", rate=59.75), "--cluster", address)
    assert code == 2
    assert re.search(
        r"omniscv: worker (odd|even): .*parts are made with numpy [\d.]+, this one with", lines[-1]
    )
    assert "use one version" in lines[-1]


@pytest.mark.soak
def test_a_worker_that_fails_is_set_aside_and_the_others_make_all(tmp_path):
    env = environment(tmp_path)
    job = job_of(tmp_path, "full", "trouble://full@1", rate=59.75)
    code, output, lines = made(job, "--cluster", "local:2", env=env)
    assert code == 0, lines
    assert "120 frames made, 0 kept; complete" in output
    assert "omniscv: worker 1: set aside, because it failed 3 parts in a row; the others go on" in lines
    assert any("worker 1: OSError: [Errno 28] No space left on device" in line for line in lines)


@pytest.mark.soak
def test_a_scheduler_without_workers_is_said_and_given_up(tmp_path):
    with scheduler(tmp_path) as (_, address):
        code, _, lines = made(job_of(tmp_path, "empty"), "--cluster", address, "--patience", 15)
    assert code == 1
    assert any(re.search(r"0 workers, waiting since 1\d s; --patience is 15 s", line) for line in lines)
    assert "expected workers that make frames, got 0 workers, and nothing for 15 s" in lines[-1]


@pytest.mark.soak
def test_a_worker_that_freezes_is_said_and_given_up(tmp_path):
    env = environment(tmp_path)
    job = job_of(tmp_path, "frozen", "trouble://freezes@0")
    with scheduler(tmp_path, "0", env=env) as (_, address):
        code, _, lines = made(job, "--cluster", address, "--patience", 70, env=env)
    assert code == 1
    assert any(re.search(r"nothing for 6\d s, waiting for workers 0 at pano-00; ", line) for line in lines)
    assert "got 1 workers, and nothing for 70 s" in lines[-1]


@pytest.mark.soak
def test_workers_of_another_version_are_refused_by_name(tmp_path):
    env = environment(tmp_path, "9.9")
    with scheduler(tmp_path, "node7", env=env) as (_, address):
        code, _, lines = made(job_of(tmp_path, "mixed"), "--cluster", address)
    assert code == 1
    wanted = "expected workers with omniscv 0.2.0, as here, got 9.9 at worker node7, tcp://127.0.0.1:"
    assert wanted in lines[-1]
    assert "pip install 'omniscv[cluster]==0.2.0'" in lines[-1]
    assert not list((tmp_path / "mixed").glob("*"))


@pytest.mark.soak
def test_workers_without_the_package_are_refused_in_one_line(tmp_path):
    env = environment(tmp_path)
    (tmp_path / "sitecustomize.py").write_text(
        "import importlib.metadata, sys\n"
        "sys.meta_path.insert(0, type('Gone', (), {'find_spec': staticmethod(\n"
        "    lambda name, *_: (_ for _ in ()).throw(ImportError(name)) if name == 'omniscv' else None)}))\n"
        "version = importlib.metadata.version\n"
        "def asked(name):\n"
        "    if name == 'omniscv':\n"
        "        raise importlib.metadata.PackageNotFoundError(name)\n"
        "    return version(name)\n"
        "importlib.metadata.version = asked\n"
    )
    with scheduler(tmp_path, "bare", env=env) as (_, address):
        code, _, lines = made(job_of(tmp_path, "lacking"), "--cluster", address)
    assert code == 1
    (line,) = lines
    assert re.search(r"got none at worker bare, \S+; install it there: pip install", line)


@pytest.mark.soak
def test_a_scheduler_that_is_killed_is_one_line(tmp_path):
    env = environment(tmp_path)
    job = job_of(tmp_path, "killed", rate=200)
    with (
        scheduler(tmp_path, "0", "1", env=env) as (serving, address),
        started(*OMNISCV, "dataset", "make", job, "--cluster", address) as process,
    ):
        while not list((tmp_path / "killed").glob("pano-*.json")):
            assert process.poll() is None
            time.sleep(0.05)
        serving.kill()
        _, errors = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "Traceback" not in errors, errors
    assert "expected the scheduler to stay, its connection is lost" in errors.splitlines()[-1]
    assert len(errors.splitlines()) == 1, errors


@pytest.mark.soak
def test_two_runs_at_one_scheduler_are_apart(tmp_path):
    env = environment(tmp_path)
    with scheduler(tmp_path, "0", env=env) as (_, address):
        first = job_of(tmp_path, "first", rate=399.75)
        with started(*OMNISCV, "dataset", "make", first, "--cluster", address) as process:
            while not list((tmp_path / "first").glob("pano-*.json")):
                assert process.poll() is None
                time.sleep(0.05)
            code, output, lines = made(job_of(tmp_path, "second"), "--cluster", address)
            if code:
                assert "expected a scheduler for this job alone" in lines[-1]
            assert (
                process.communicate(timeout=240)[0]
                .splitlines()[-1]
                .endswith("800 frames made, 0 kept; complete")
            )
        code, output, _ = made(job_of(tmp_path, "second"), "--cluster", address)
        assert code == 0
        assert "complete" in output
    assert (tmp_path / "first" / "frames.jsonl").exists()


@pytest.mark.soak
def test_a_cluster_that_adapts_starts_with_no_workers(tmp_path):
    quiet = {"silence_logs": logging.CRITICAL, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(
        n_workers=0, threads_per_worker=1, host="127.0.0.1", resources={"server": 1}, **quiet
    ) as adapting:
        adapting.adapt(minimum=0, maximum=2)
        job = job_of(tmp_path, "adapted", rate=39.75)
        code, output, _ = made(job, "--cluster", adapting.scheduler_address, "--patience", 120)
    assert code == 0
    assert "80 frames made, 0 kept; complete" in output
