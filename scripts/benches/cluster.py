"""What many workers make of their number: parts a second by 1 to 64 of them, and what Dask itself takes.

A waiting task stands for a part whose server answers once a tick, on a machine of its own: it takes a second
and no processor. All waiting workers, the scheduler and the client share one process, whose processor time is
all that scheduling takes. Local workers are processes with a mock server each: they share this machine's
cores with it, so that their number pays only as far as there are cores; the peer is one process without Dask.
"""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import dask
from distributed import Client, LocalCluster, as_completed

import omniscv
from benches import Figure, Reference
from omniscv import cluster
from omniscv.cluster.places import RESOURCE, SETTINGS
from omniscv.cluster.tasks import HOW
from omniscv.geometry import Pose
from omniscv.jobs import Job, make

EACH = 8  # parts of a worker


def measure(quick: bool) -> Iterator[Figure]:
    part_s, most = (0.01, 1) if quick else (1.0, 64)
    count = 1
    while count <= most:
        with waiting(count) as client:
            run(client, count, part_s)  # what is done once
            seconds, processor = run(client, EACH * count, part_s)
        ideal = Reference("workers alone", count / part_s)
        yield Figure("waiting parts", f"{count} workers", "parts/s", EACH * count / seconds, limit=ideal)
        yield Figure("waiting parts", f"{count} workers: Dask", "ms of the processor a part", 1e3 * processor)
        count *= 2
    if not quick:
        yield from local()


@contextmanager
def waiting(count: int) -> Iterator[Client]:
    """Give a client of workers that are threads of this process."""
    with (
        dask.config.set(SETTINGS),
        LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=False,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            resources=RESOURCE,
        ) as started,
        Client(started, set_as_default=False) as client,
    ):
        yield client


def run(client: Client, parts: int, part_s: float) -> tuple[float, float]:
    """Return the seconds of some parts, and the processor's seconds for each."""
    started, before = time.perf_counter(), time.process_time()
    for future in as_completed(client.map(wait, [part_s] * parts, **HOW), loop=client.loop):
        future.result()
    return time.perf_counter() - started, (time.process_time() - before) / parts


def wait(part_s: float) -> None:
    """Take as long as a part whose server answers once a tick."""
    time.sleep(part_s)


def local() -> Iterator[Figure]:
    """Yield images a second of local workers, without their start."""
    with TemporaryDirectory() as folder:
        whole = job(128)
        make(replace(whole, out=Path(folder) / "warm", poses=whole.poses[:16]))
        one = rate(partial(make, replace(whole, out=Path(folder) / "one")))
        for workers in (1, 2):
            there = replace(whole, out=Path(folder) / f"local-{workers}")
            ours = rate(partial(cluster.make, there, cluster.place(f"local:{workers}")), workers - 1)
            other = Reference("one process", one)
            yield Figure("panoramas of 128 x 64, mock://", f"local:{workers}", "images/s", ours, peer=other)


def rate(make: Callable[..., object], skipped: int = 0) -> float:
    """Return images a second, from when the first are done to when the last are; some reports are skipped."""
    noted: list[tuple[float, float]] = []
    make(progress=lambda done, _: noted.append((time.perf_counter(), done)))
    (first, before), (last, after) = noted[skipped], noted[-1]
    return (after - before) / (last - first)


def job(count: int) -> Job:
    """Return a job of panoramas, each from a place of its own."""
    poses = tuple(Pose.from_angles((-1 + 2 * i / count, 0.2, 1.5)) for i in range(count))
    camera = omniscv.cameras.create("equirectangular", width=128, height=64)
    return Job("mock://four-wall", {"pano": camera}, poses, Path(), ("lit", "object_mask", "depth"))
