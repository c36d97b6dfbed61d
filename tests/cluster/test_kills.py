"""Ctrl-C, and kill -9 of workers, servers, games and schedulers: what is left goes on to the same bytes."""

import os
import re
import signal
import sys
import time
from contextlib import suppress

import psutil
import pytest
from support.clusters import PATIENCE_S, Cluster
from support.clusters import waited_for as content_of
from support.datasets import tree
from support.games import STAND_IN, waited_for
from support.processes import OMNISCV, started
from support.stores import names_at

from omniscv import dataset, jobs

JOB = """
source: {source}
source_options: {{patience_s: 120}}
cameras: {{pano: {{model: equirectangular, width: 32, height: 16}}}}
poses:
  path: {{waypoints: [[-1.2, 0, 1.5], [1.2, 0.3, 1.5]], speed: 1, rate: {rate}, look: ahead}}
modes: [lit, object_mask, depth]
face_size: 16
out: {out}
"""


def job_of(folder, out, source="mock://four-wall", rate=8):
    path = folder / f"{out.rpartition('/')[2]}.yaml"
    path.write_text(JOB.format(source=source, out=out, rate=rate), encoding="utf-8")
    return path


def frames_in(out):
    return sum(re.fullmatch(r"pano-[0-9]+\.json", name) is not None for name in names_at(str(out)))


def below(process):
    """All processes that a command has started, and they, with their command lines."""
    found = {}
    with suppress(psutil.NoSuchProcess):  # it has ended, or one below it: a zombie has no command line
        for each in psutil.Process(process.pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                found[each] = " ".join(each.cmdline())
    return found


def test_ctrl_c_leaves_a_dataset_that_goes_on(tmp_path):
    """A terminal sends it to the workers too."""
    job, out = job_of(tmp_path, "stopped"), tmp_path / "stopped"
    jobs.make(jobs.load(job_of(tmp_path, "single")))
    with started(*OMNISCV, "dataset", "make", job, "--cluster", "local:1") as process:
        while frames_in(out) < 2:
            assert process.poll() is None
            time.sleep(0.02)
        workers = list(below(process))
        for each in (*workers, process):
            os.kill(each.pid, signal.SIGINT)
        printed, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.splitlines() == ["omniscv: stopped; what is complete is kept, rerun to resume"]
    assert printed.startswith("dashboard: http://127.0.0.1:")
    psutil.wait_procs(workers, timeout=30)
    assert not any(each.is_running() for each in workers)
    assert not (out / "frames.jsonl").exists()
    made = jobs.make(jobs.load(job), resume=True)
    assert made.kept >= 2
    assert tree(out) == tree(tmp_path / "single")


def test_a_worker_killed_while_it_starts_is_one_clear_sentence(tmp_path):
    with started(*OMNISCV, "dataset", "make", job_of(tmp_path, "none"), "--cluster", "local:1") as process:
        starting = waited_for(
            lambda: [p for p, line in below(process).items() if "--multiprocessing-fork" in line]
        )
        starting[0].kill()
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert "--cluster: expected 1 workers to start, but one ended" in errors
    assert "Traceback" not in errors


def wait_for_frames(out, count):
    until = time.monotonic() + PATIENCE_S
    while frames_in(out) < count:
        assert time.monotonic() < until
        time.sleep(0.005)


def test_killed_workers_servers_and_schedulers(tmp_path):
    with Cluster(tmp_path) as cluster:
        games = [cluster.ready("server", 0) for _ in range(2)]
        addresses = [address for _, address in games]
        source = f"[{', '.join(addresses)}]"
        jobs.make(jobs.load(job_of(tmp_path, "single", addresses[0], 12)))
        wanted = tree(tmp_path / "single")
        job, out = job_of(tmp_path, "killed", source, 12), tmp_path / "killed"
        boss, address = cluster.ready("scheduler")
        workers = [cluster.ready("worker", address, number)[0] for number in range(2)]
        _, report = cluster.start("make", job, address)
        wait_for_frames(out, 2)
        cluster.kill(workers[0])
        cluster.ready("worker", address, 0)
        wait_for_frames(out, 8)
        cluster.kill(games[1][0])  # whose worker is busy, with its own part or with that of the dead one
        cluster.ready("server", addresses[1].rpartition(":")[2])
        wait_for_frames(out, 14)
        cluster.kill(boss)
        lost = content_of(report)
        assert "ClusterError: expected the scheduler to stay" in lost
        assert "run the same command again" in lost
        _, address = cluster.ready("scheduler")
        for number in range(2):
            cluster.ready("worker", address, number)
        written, kept = cluster.ready("make", job, address)[1]
        assert written + kept == len(jobs.load(job))
        assert kept >= 14
        assert tree(out) == wanted
        assert cluster.ready("make", job, address)[1] == [0, written + kept]
        assert tree(out) == wanted
    assert dataset.check(out, deep=True) == []


LINES = {"worker": r".* --multiprocessing-fork", "game": r"\S+ \S+/Binaries/Linux/Game"}  # not its watcher


@pytest.mark.soak
def test_every_worker_launches_a_game_of_its_own_and_one_that_is_killed_again(tmp_path):
    game = tmp_path / "Game" / "Binaries" / "Linux" / "Game"
    game.parent.mkdir(parents=True)
    game.write_text(f"#!{sys.executable}\n{STAND_IN.read_text()}")
    game.chmod(0o755)
    jobs.make(jobs.load(job_of(tmp_path, "single", rate=12)))
    job, out = job_of(tmp_path, "launched", f"launch:{game}", 12), tmp_path / "launched"
    with started(*OMNISCV, "dataset", "make", job, "--cluster", "local:2") as process:
        wait_for_frames(out, 2)
        # Not the process that watches a game.
        games = [each for each, line in below(process).items() if re.fullmatch(rf"\S+ {game}", line)]
        games[0].kill()
        _, errors = process.communicate(timeout=600)
    assert (len(games), process.returncode) == (2, 0), errors
    assert tree(out) == tree(tmp_path / "single")
