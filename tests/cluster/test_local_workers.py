"""``--cluster local:N``: the bytes of one process; Ctrl-C and kills leave a dataset that goes on."""

import os
import random
import shutil
import signal
import sys
import time

import psutil
import pytest
from support.datasets import tree
from support.games import STAND_IN
from support.processes import OMNISCV, started

from omniscv import dataset, jobs

JOB = """
source: {source}
source_options: {{patience_s: 5}}
cameras: {{pano: {{model: equirectangular, width: 32, height: 16}}}}
poses:
  path: {{waypoints: [[-1.2, 0, 1.5], [1.2, 0.3, 1.5]], speed: 1, rate: {rate}, look: ahead}}
modes: [lit, object_mask, depth]
face_size: 16
out: {out}
"""


def job_of(folder, out, source="mock://four-wall", rate=14):
    path = folder / f"{out}.yaml"
    path.write_text(JOB.format(source=source, out=out, rate=rate), encoding="utf-8")
    return path


def frames_in(out):
    return len(list(out.glob("pano-*[0-9].json")))


def below(process):
    """All processes that a command has started, and they."""
    return [each for each in psutil.Process(process.pid).children(recursive=True) if each.is_running()]


def test_ctrl_c_leaves_a_dataset_that_goes_on(tmp_path):
    """A terminal sends it to the workers too."""
    job, out = job_of(tmp_path, "stopped"), tmp_path / "stopped"
    jobs.make(jobs.load(job_of(tmp_path, "single")))
    with started(*OMNISCV, "dataset", "make", job, "--cluster", "local:1") as process:
        while frames_in(out) < 2:
            assert process.poll() is None
            time.sleep(0.02)
        workers = below(process)
        for each in (*workers, process):
            os.kill(each.pid, signal.SIGINT)
        printed, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.splitlines() == ["omniscv: stopped; what is complete is kept, rerun to resume"]
    assert printed.startswith("dashboard: http://127.0.0.1:")
    psutil.wait_procs(workers, timeout=30)
    assert not any(each.is_running() for each in workers)
    assert not (out / "frames.jsonl").exists()
    made = jobs.make(jobs.load(job), resume=True)
    assert made.kept >= 2
    assert tree(out) == tree(tmp_path / "single")


def kill(process, what, draw):
    """Kill -9 one process of some kind, or none where there is none at the moment."""
    names = {"worker": "--multiprocessing-fork", "game": "Binaries/Linux/Game"}
    found = [each for each in below(process) if what in names and names[what] in " ".join(each.cmdline())]
    if what == "scheduler":
        process.kill()
    elif found:
        draw.choice(found).kill()


@pytest.mark.soak
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("workers", [2, 4])
@pytest.mark.parametrize("what", ["worker", "game", "scheduler"])
def test_kills_at_ten_moments(what, workers, tmp_path):
    """The scheduler lives in the command. Each worker launches a game of its own."""
    kills, images = (int(each) for each in os.environ.get("OMNISCV_KILLS", "10,200").split(","))
    game = tmp_path / "Game" / "Binaries" / "Linux" / "Game"
    game.parent.mkdir(parents=True)
    shutil.copy(STAND_IN, game)
    game.write_text(f"#!{sys.executable}\n{game.read_text()}")
    game.chmod(0o755)
    rate, source = images / 2.419, f"launch:{game}"
    jobs.make(jobs.load(job_of(tmp_path, "single", rate=rate)))
    wanted, draw = tree(tmp_path / "single"), random.Random(what)
    for number in range(kills):
        job, out = job_of(tmp_path, f"killed-{number}", source, rate), tmp_path / f"killed-{number}"
        command = (*OMNISCV, "dataset", "make", job, "--cluster", f"local:{workers}")
        kill_at = images * (number + draw.random()) / kills
        with started(*command) as process:
            while process.poll() is None and frames_in(out) < kill_at:
                time.sleep(0.01)
            kill(process, what, draw)
            process.communicate(timeout=600)
        before = frames_in(out)
        with started(*command) as process:
            printed, said = process.communicate(timeout=600)
        assert process.returncode == 0, said
        assert tree(out) == wanted
        print(f"{what} killed at {kill_at:.0f} frames: {before} were there; {printed.splitlines()[-1]}")
        again = jobs.make(jobs.load(job_of(tmp_path, f"killed-{number}", rate=rate)), resume=True)
        assert (again.written, again.kept) == (0, len(wanted) // 8)
    assert dataset.check(out, deep=True) == []
