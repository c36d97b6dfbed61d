"""Runs cases in a process of their own, which is killed where one hangs, and counts what they find."""

import contextlib
import importlib
import multiprocessing
import random
import resource  # noqa: TID251
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

import psutil

HANG_S = 90
START_S = 300
"""For one case, which has far shorter deadlines of its own; for the first, where much is compiled."""

MEMORY = 8 << 30
"""Bytes that the process may have: an attack that takes more is a fault."""

ROUND = {
    **{"texts": 100, "recordings": 60, "servers": 10, "folders": 3, "signals": 2},
    **{"datasets": 5, "records": 5, "names": 5, "shards": 20, "stores": 5},
}
"""By family: cases in a round. A hundred rounds are what a long run should reach."""


class Tally:
    """Cases by family, and what they found, with the seeds of each kind."""

    def __init__(self):
        self.cases = Counter()
        self.seconds = Counter()
        self.faults = {}

    def add(self, family, seed, seconds, fault):
        self.cases[family] += 1
        self.seconds[family] += seconds
        if fault is not None:
            kind, text = fault
            seeds, _ = self.faults.setdefault((family, kind), ([], text))
            seeds.append(seed)

    def lines(self):
        for family, count in self.cases.items():
            found = sum(len(seeds) for (name, _), (seeds, _) in self.faults.items() if name == family)
            yield f"{family}: {count} cases in {self.seconds[family]:.0f} s, {found} failures"
        for (family, kind), (seeds, text) in self.faults.items():
            shown = ", ".join(map(str, seeds[:8])) + (", ..." if len(seeds) > 8 else "")
            yield f"  {family}, {len(seeds)} times, {kind}\n    seeds {shown}\n    {text}"


class Worker:
    """A process that runs cases; a context manager."""

    def __enter__(self):
        self._process = None
        return self

    def __exit__(self, *error):
        self._stop()

    def run(self, family, seed):
        """Run a case; return None, or the kind of a fault and its text."""
        if self._process is None:
            self._start()
        try:
            self._pipe.send((family, seed))
            if self._pipe.poll(HANG_S):
                return self._pipe.recv()
            kind = f"hangs for {HANG_S} s"
        except (EOFError, OSError):
            self._process.join(10)
            kind = f"the process ended with {self._process.exitcode}"
        self._stop()
        return kind, ""

    def _start(self):
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,), daemon=False)
        self._process.start()
        theirs.close()
        if not self._pipe.poll(START_S) or self._pipe.recv() != "ready":
            raise RuntimeError(f"expected the worker to start within {START_S} s")

    def _stop(self):
        if self._process is None:
            return
        self._pipe.close()
        self._process.join(1)
        if self._process.is_alive():
            for child in psutil.Process(self._process.pid).children(recursive=True):
                child.kill()
            self._process.kill()
            self._process.join()
        self._process = None


def _work(pipe):
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    importlib.import_module("attack.samples").sample()
    pipe.send("ready")
    with contextlib.suppress(EOFError, OSError):  # the end of the run, or of a case that hung
        while True:
            family, seed = pipe.recv()
            pipe.send(carried_out(family, seed))


def carried_out(family, seed):
    """Carry out a case in this process; return None, or the kind of a fault and its text."""
    before = psutil.Process().children(recursive=True)
    module = "datasets" if family in ("records", "names", "shards") else family
    case = getattr(importlib.import_module(f"attack.{module}"), "case" if family == module else family)
    try:
        with tempfile.TemporaryDirectory(prefix="attack-") as folder:
            case(random.Random(f"{family} {seed}"), Path(folder))
        left = {*psutil.Process().children(recursive=True)} - {*before}
        if left:
            return "processes are left", str(left)
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        where = next((each for each in reversed(frames) if "omniscv/" in each.filename), frames[-1])
        kind = f"{type(error).__name__} at {Path(where.filename).name}:{where.lineno}"
        return f"{kind}: {' '.join(str(error).split())[:60]}", " ".join(str(error).split())[:2000]
    return None


def run(families, first, count, tally, worker, until=float("inf")):
    """Run ``count`` cases of each family, from seed ``first``; stop at a time of ``time.monotonic``."""
    for family in families:
        for seed in range(first, first + count[family]):
            started = time.monotonic()
            if started > until:
                return
            fault = worker.run(family, seed)
            tally.add(family, seed, time.monotonic() - started, fault)
