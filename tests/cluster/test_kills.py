"""Ctrl-C, and kill -9 of workers, servers and games: what is left goes on to the same bytes."""

import os
import re
import signal
import sys
import time
from contextlib import ExitStack, suppress

import psutil
import pytest
from support.datasets import tree
from support.games import STAND_IN, waited_for
from support.processes import OMNISCV, started
from support.stores import names_at

import mock_server
from omniscv import dataset
from omniscv.job import load
from omniscv.make import make

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


def wait_for_frames(process, out, count):
    while frames_in(out) < count:  # else the suite's time limit is over
        assert process.poll() is None
        time.sleep(0.02)


def workers_of(process):
    return [each for each, line in below(process).items() if "--multiprocessing-fork" in line]


@pytest.mark.soak
def test_killed_workers_and_servers_stop_nothing_and_ctrl_c_leaves_a_dataset_that_goes_on(tmp_path):
    with mock_server.serve("four-wall", latency_ms=10) as first, ExitStack() as games:
        make(load(job_of(tmp_path, "single", first.uri, rate=12)))
        second = games.enter_context(mock_server.serve("four-wall", latency_ms=10))
        job = job_of(tmp_path, "stopped", f"[{first.uri}, {second.uri}]", 12)
        out = tmp_path / "stopped"
        with started(*OMNISCV, "dataset", "make", job, "--cluster", "local:2") as process:
            wait_for_frames(process, out, 2)
            workers_of(process)[0].kill()
            wait_for_frames(process, out, 6)
            second.stop()
            games.enter_context(mock_server.serve("four-wall", port=second.port))
            wait_for_frames(process, out, 12)
            below_it = list(below(process))
            for each in (*below_it, process):
                os.kill(each.pid, signal.SIGINT)
            printed, errors = process.communicate(timeout=60)
        assert process.returncode == 130
        assert "stopped; what is complete is kept; this goes on: omniscv dataset make" in errors
        assert printed.startswith("dashboard: http://127.0.0.1:")
        assert psutil.wait_procs(below_it, timeout=30)[1] == []
        assert not (out / "frames.jsonl").exists()
        assert make(load(job), existing="resume").kept >= 12
    assert tree(out) == tree(tmp_path / "single")
    assert dataset.check(out, deep=True) == []


@pytest.mark.soak
def test_a_worker_killed_while_it_starts_is_one_clear_sentence(tmp_path):
    with started(*OMNISCV, "dataset", "make", job_of(tmp_path, "none"), "--cluster", "local:1") as process:
        waited_for(lambda: workers_of(process))[0].kill()
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "--cluster: expected 1 workers to start, but one ended" in errors
    assert "Traceback" not in errors


@pytest.mark.soak
def test_every_worker_launches_a_game_of_its_own_and_one_that_is_killed_again(tmp_path):
    game = tmp_path / "Game" / "Binaries" / "Linux" / "Game"
    game.parent.mkdir(parents=True)
    game.write_text(f"#!{sys.executable}\n{STAND_IN.read_text()}")
    game.chmod(0o755)
    make(load(job_of(tmp_path, "single", f"launch:{game}", 12)))
    job = job_of(tmp_path, "launched", f"launch:{game}", 12)
    out = tmp_path / "launched"
    with started(*OMNISCV, "dataset", "make", job, "--cluster", "local:2") as process:
        wait_for_frames(process, out, 2)
        # Not the process that watches a game.
        games = [each for each, line in below(process).items() if re.fullmatch(rf"\S+ {game}", line)]
        games[0].kill()
        _, errors = process.communicate(timeout=600)
    assert (len(games), process.returncode) == (2, 0), errors
    assert tree(out) == tree(tmp_path / "single")
