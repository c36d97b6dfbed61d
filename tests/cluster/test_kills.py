"""Ctrl-C, and kill -9 of workers, servers, games and schedulers: what is left goes on to the same bytes."""

import os
import random
import re
import shutil
import signal
import sys
import time
from contextlib import nullcontext, suppress
from functools import partial

import psutil
import pytest
from support.clusters import PATIENCE_S, Cluster
from support.clusters import waited_for as content_of
from support.datasets import tree
from support.games import STAND_IN, waited_for
from support.processes import OMNISCV, started
from support.stores import BUCKET, names_at, s3_application, s3_server, tree_at, twelve_percent

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
            lambda: [p for p, line in below(process).items() if re.match(LINES["worker"], line)]
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


def kill(process, what, draw):
    """Kill -9 one process of some kind; return whether there was one."""
    if what == "scheduler":
        found = [process] if process.poll() is None else []
    else:
        found = [each for each, line in below(process).items() if re.fullmatch(LINES[what], line)]
    if found:
        draw.choice(found).kill()
    return bool(found)


def running(mark):
    """The processes of a run, wherever they are."""
    found = []
    for each in psutil.process_iter():
        with suppress(psutil.NoSuchProcess, psutil.AccessDenied):
            if each.environ().get("OMNISCV_RUN") == mark and each.status() != psutil.STATUS_ZOMBIE:
                found.append(each)
    return found


def launched(folder):
    """A game that each worker launches for itself."""
    game = folder / "Game" / "Binaries" / "Linux" / "Game"
    game.parent.mkdir(parents=True)
    shutil.copy(STAND_IN, game)
    game.write_text(f"#!{sys.executable}\n{game.read_text()}")
    game.chmod(0o755)
    return f"launch:{game}"


STORES = {
    "disk": nullcontext,
    "s3": s3_server,
    "failing s3": partial(s3_server, every=10),
    "unsteady s3": partial(s3_application, twelve_percent),
}


@pytest.mark.soak
@pytest.mark.timeout(10_000)
@pytest.mark.parametrize("store", STORES)
@pytest.mark.parametrize("workers", [2, 4])
@pytest.mark.parametrize("what", ["worker", "game", "scheduler", "worker game scheduler"])
def test_kills_at_ten_moments(what, workers, store, tmp_path, monkeypatch):
    """The scheduler lives in the command, its client, which is started again only where it was killed itself.

    ``OMNISCV_KILLS`` has the number of runs, of images, and a seed.
    """
    runs, images, seed = (int(each) for each in os.environ.get("OMNISCV_KILLS", "10,200,0").split(","))
    rate, source, killed = images / 2.419, launched(tmp_path), 0
    jobs.make(jobs.load(job_of(tmp_path, "single", rate=rate)))
    wanted, draw = tree_at(str(tmp_path / "single")), random.Random(f"{what} {seed}")
    for number in range(runs):
        victims = draw.sample(what.split(), len(what.split()))
        first = (number + draw.random()) / runs
        moments = sorted((first + i / len(victims)) % 1 for i in range(len(victims)))
        left, events, began = list(zip(moments, victims, strict=True)), [], time.perf_counter()
        with STORES[store]():
            out = f"{tmp_path if store == 'disk' else f's3://{BUCKET}'}/killed-{number}"
            monkeypatch.setenv("OMNISCV_RUN", mark := f"{tmp_path}-{number}")
            command = (*OMNISCV, "dataset", "make", job_of(tmp_path, out, source, rate), "--cluster")
            returned = -signal.SIGKILL
            while returned == -signal.SIGKILL:
                with started(*command, f"local:{workers}") as process:
                    while left and process.poll() is None:
                        before = time.perf_counter()
                        if (there := frames_in(out)) < images * left[0][0]:
                            # Looking is not to take all the time.
                            time.sleep(0.02 + time.perf_counter() - before)
                        elif kill(process, victim := left.pop(0)[1], draw):
                            events.append(f"{victim} at {there}")
                            if victim == "scheduler":
                                break
                    _, errors = process.communicate(timeout=600)
                returned = process.returncode
            assert returned == 0, errors
            seconds, killed = time.perf_counter() - began, killed + len(events)
            assert tree_at(out) == wanted
            job = jobs.load(job_of(tmp_path, out, rate=rate))
            again = jobs.make(job, resume=True)
            assert (again.written, again.kept) == (0, len(job))
            assert dataset.check(out, deep=number == 0) == []
            print(f"{seconds:.0f} s, killed of {again.kept}: {', '.join(events)}; {errors!r}", flush=True)
            assert waited_for(lambda mark=mark: not running(mark)), running(mark)
    assert killed >= runs * len(what.split()) / 2  # late ones may find that all is done
