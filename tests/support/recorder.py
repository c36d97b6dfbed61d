"""Starts processes that write files, and may be killed: one is forked for each line of standard input.

A line is a JSON list: an action of ``ACTIONS``, after how many seconds to kill the process, or null, and the
action's arguments. Prints the process's status and how long it took. All that the actions need is imported
before, so that they are quick; ``warm`` renders in this process, so that its kernels are loaded too.
"""

import json
import os
import signal
import sys
import time
import traceback
from contextlib import closing, nullcontext
from pathlib import Path

import omniscv
import omniscv.dataset.formats.webdataset  # what exporting imports  # noqa: F401
import omniscv.sources.unreal.source  # what opening a source imports  # noqa: F401
from omniscv import dataset
from omniscv.geometry import R_LEVEL, Pose, cube_rotations
from omniscv.geometry.instant import Instant
from omniscv.importing import folders
from omniscv.job import load
from omniscv.make import make, run
from omniscv.sources import Request, View
from omniscv.sources.recording.files import publish, target_of, written_for
from omniscv.sources.recording.store import Store

CENTERS = ((0.0, 0.0, 1.5), (0.5, 0.0, 1.5))
MODES = ("lit", "object_mask", "depth", "normals")
SIZE = 48
SMALL = 8


STATES = (Instant(), Instant(time=0.7), Instant(time=0.7, hidden=frozenset({"Crate"})))


def requests(size=SIZE, state=""):
    """All faces at some centres, in all modes."""
    return [
        Request(View(Pose(center, R_w_c), 90.0, size, size), mode, state)
        for center in CENTERS
        for mode in MODES
        for _, R_w_c in cube_rotations()
    ]


def record(source, path):
    """Record them all; close the source."""
    with omniscv.record(source, path) as recording:
        recording.objects()
        for _ in recording.capture(requests()):
            pass


def replace(other, path):
    """Put another recording in the place of one, as the pytest plugin does."""
    target = target_of(path)
    with written_for(target) as file:
        record(omniscv.open_source(other), file)
        publish(file, target)


def change(path, other):
    """Write a file's captures again and again, in the place of the same."""
    with closing(Store(path, write=True)) as store, omniscv.open_source(other) as replay:
        for capture in replay.capture(requests()):
            store.add(capture)


def record_states(path, plan):
    """Record some requests at instants of a scene, then be killed.

    ``plan`` is a JSON list of: which of ``STATES``, the first request, the last, and how: ``each`` by
    itself, the ``whole`` as one set, or ``killed`` before the set has ended.
    """
    with omniscv.record(omniscv.open_source("scene://workshop"), path) as recording:
        for which, first, last, how in json.loads(plan):
            source = recording.at(STATES[which])
            with source, nullcontext() if how == "each" else source.one_instant():
                list(source.capture(requests(SMALL, source.state)[first:last]))
                if how == "killed":
                    os.kill(os.getpid(), signal.SIGKILL)
        os.kill(os.getpid(), signal.SIGKILL)


def warm():
    """Render in this process; no file is written, because OpenImageIO's threads do not survive a fork."""
    camera = omniscv.cameras.create("equirectangular", width=48, height=24)
    with omniscv.open_source("scene://four-wall") as source:
        omniscv.render(camera, Pose((0, 0, 1.5), R_LEVEL), source, MODES, face_size=32)


def write(out):
    """Add frames to a dataset by a writer."""
    camera = omniscv.cameras.create("equirectangular", width=48, height=24)
    with omniscv.open_source("scene://four-wall") as source, dataset.Writer(out, resume=True) as writer:
        for i, center in enumerate(CENTERS):
            image = omniscv.render(camera, Pose(center, R_LEVEL), source, MODES, face_size=32)
            writer.add(f"frame-{i}", image)


ACTIONS = {
    "record": lambda address, path: record(omniscv.open_source(address), path),
    "import": folders.import_folder,
    "replace": replace,
    "change": change,
    "states": record_states,
    "make": lambda job: make(load(Path(job)), existing="resume"),
    "overwrite": lambda job: make(load(Path(job)), existing="replace"),
    "render": lambda job: run(load(Path(job))),
    "write": write,
    "export": lambda folder, out: dataset.export(folder, "webdataset", out, max_count=1),
}


def main():
    for line in sys.stdin:
        action, kill_after_s, *arguments = json.loads(line)
        started = time.perf_counter()
        if action == "warm":
            warm()
            print(0, time.perf_counter() - started, flush=True)
            continue
        child = os.fork()  # noqa: TID251
        if child == 0:
            code = 1
            try:
                ACTIONS[action](*arguments)
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)
        if kill_after_s is not None:
            time.sleep(kill_after_s)
            os.kill(child, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        print(status, time.perf_counter() - started, flush=True)


if __name__ == "__main__":
    main()
