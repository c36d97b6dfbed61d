"""What many workers make of their number: parts a second by 1 to 64 of them, and what Dask itself takes.

A waiting task stands for a part whose server answers once a tick, on a machine of its own: it takes three
seconds and no processor. The scheduler and the client share this process, as in a command; its time is all
that scheduling takes. All waiting workers share another. Local workers are processes with a mock server each:
what they take of the cores for an image is compared with one process without Dask. Where there are cores for
all of them, the time by the clock is shared among them.

Jobs of more and more poses are planned, and a part of each is made a second time, which finds all of its
frames: what it takes then is what a part takes beside its frames. ``scripts/draw-growth`` draws these.
"""

import asyncio
import logging
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AsyncExitStack, contextmanager
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import dask
from distributed import Client, LocalCluster, Worker, as_completed

from benches import Figure, Reference
from omniscv.cluster.workers import RESOURCE, settings
from omniscv.errors import OmniscvError
from omniscv.job import load
from omniscv.make import parts_of, run_part, with_places
from omniscv.sources.registry import open_source

EACH = 5  # parts of a worker
OPTIONS = {"resources": RESOURCE, "pure": False}  # of tasks, as of a run's
ELSEWHERE = {"distributed.admin.system-monitor.interval": "60s"}  # else, each on cores of its own
FEW, MANY = 32, 160  # images
PLAN, BESIDE = "plan of many poses", "a part of a job of many poses, beside its frames"
JOB = """
source: mock://four-wall
cameras: {{pano: {{model: equirectangular, width: 32, height: 16}}}}
poses: {{path: {{waypoints: [[-1, 0.2, 1.5], [1, 0.2, 1.5]], speed: 1, rate: {rate}}}}}
modes: [lit, object_mask, depth]
face_size: 16
out: {out}
"""


def measure(quick: bool) -> Iterator[Figure]:
    part_s, counts = (0.01, (1,)) if quick else (3.0, (1, 8, 64))
    for count in counts:
        with waiting(count) as client:
            run(client, count, part_s)  # what is done once
            seconds, processor = run(client, EACH * count, part_s)
        ideal = Reference("workers alone", count / part_s)
        yield Figure("waiting parts", f"{count} workers", "parts/s", EACH * count / seconds, limit=ideal)
        yield Figure("waiting parts", f"{count} workers: Dask", "ms of the processor a part", 1e3 * processor)
    yield from growth((100,) if quick else (1_000, 10_000, 50_000))
    if not quick:
        yield from local()


@contextmanager
def waiting(count: int) -> Iterator[Client]:
    """Give a client of a scheduler in this process, and of workers that are threads of another."""
    with (
        dask.config.set(settings()),
        LocalCluster(
            n_workers=0,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as started,
        Client(started, set_as_default=False) as client,
    ):
        workers = multiprocessing.get_context("spawn").Process(
            target=work, args=(started.scheduler_address, count), daemon=True
        )
        workers.start()
        client.wait_for_workers(count)
        try:
            yield client
        finally:
            workers.kill()
            workers.join()


def work(address: str, count: int) -> None:
    """Be so many workers, until killed."""

    async def serve() -> None:
        async with AsyncExitStack() as held:
            for name in range(count):
                worker = Worker(
                    address, nthreads=1, name=name, resources=RESOURCE, host="127.0.0.1", memory_limit=0
                )
                await held.enter_async_context(worker)
            await asyncio.Event().wait()

    logging.disable(logging.CRITICAL)
    with dask.config.set({**settings(), **ELSEWHERE}):
        asyncio.run(serve())


def run(client: Client, parts: int, part_s: float) -> tuple[float, float]:
    """Return the seconds of some parts, and the processor's seconds for each."""
    started, before = time.perf_counter(), time.process_time()
    for future in as_completed(client.map(wait, [part_s] * parts, **OPTIONS), loop=client.loop):
        future.result()
    return time.perf_counter() - started, (time.process_time() - before) / parts


def wait(part_s: float) -> None:
    """Take as long as a part whose server answers once a tick."""
    time.sleep(part_s)


def growth(counts: Sequence[int]) -> Iterator[Figure]:
    """Yield what jobs of more and more poses take: to plan, and for a part beside its frames."""
    with TemporaryDirectory() as folder, ProcessPoolExecutor(1, get_context("spawn")) as alone:
        for count in counts:
            path = Path(folder) / f"poses-{count}.yaml"
            text = JOB.format(out=path.stem, rate=(count - 0.5) / 2)
            path.write_text(f"{text}split: {{train: 0.8, val: 0.2}}\n".replace("mock:", "scene:"))
            seconds, megabytes = planned(path)
            yield Figure(PLAN, f"{count} poses", "CPU s", seconds)
            yield Figure(PLAN, f"{count} poses", "MB at most", megabytes)
            yield Figure(BESIDE, f"{count} poses", "ms", alone.submit(beside_frames, path).result())


def planned(path: Path) -> tuple[float, float]:
    """Return the processor's seconds and the memory, MB, of ``omniscv plan``."""
    command = [sys.executable, "-c", "from omniscv.cli import main; main()", "plan", path]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise OmniscvError(f"{path}: expected a plan, got code {os.waitstatus_to_exitcode(status)}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e3


def beside_frames(path: Path) -> float:
    """Return the processor's ms of a part whose frames are there, the least of some."""
    job = with_places(load(path))
    last = parts_of(job)[-1]
    taken = []
    with open_source(job.sources[0]) as source:
        run_part(job, last, source=source)
        for _ in range(5):
            before = time.process_time()
            run_part(job, last, source=source)
            taken.append(1e3 * (time.process_time() - before))
    return min(taken)


def local() -> Iterator[Figure]:
    """Yield what an image takes of all cores by local workers, without their start."""
    with TemporaryDirectory() as folder:
        processor(Path(folder), "warm", FEW)
        one = each(Path(folder), "one")
        for workers in (1, 2):
            ours = each(Path(folder), f"workers-{workers}", "--cluster", f"local:{workers}")
            other = Reference("one process", one)
            yield Figure(
                "panoramas of 32 x 16, mock://", f"local:{workers}", "ms of the processor", ours, peer=other
            )


def each(folder: Path, name: str, *how: str) -> float:
    """Return ms of the processor for an image after the first few, whose time that of the start is in."""
    few, many = (processor(folder, f"{name}-{count}", count, *how) for count in (FEW, MANY))
    return 1e3 * (many - few) / (MANY - FEW)


def processor(folder: Path, name: str, count: int, *how: str) -> float:
    """Return the processor's seconds, the workers' too, of a command that makes some images."""
    path = folder / f"{name}.yaml"
    path.write_text(JOB.format(out=name, rate=(count - 0.5) / 2))
    command = [sys.executable, "-c", "from omniscv.cli import main; main()", "dataset", "make", path, *how]
    before = os.times()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return sum(after[2:4]) - sum(before[2:4])  # of children
