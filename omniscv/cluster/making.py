"""Make the dataset of a job by the workers of a cluster.

A task runs in a worker, which has one open server. Only counts return to the scheduler, or what is wrong with
the job.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from distributed import Client, Future, WorkerPlugin, as_completed, get_worker

from omniscv.cluster.workers import RESOURCE, Workers
from omniscv.errors import ArgumentError, ClusterError, DatasetError, OmniscvError
from omniscv.job import Job
from omniscv.make import Made, Part, check_dataset, finish, opened, parts_of, run_part, source_options
from omniscv.memory import keep_freed_memory
from omniscv.sources.base import Source
from omniscv.sources.registry import SourceOptions, open_source

T = TypeVar("T")

SERVER_PLUGIN, JOB_PLUGIN = "omniscv-server", "omniscv-job"
"""Names of the plugins of workers."""

TOPIC = "omniscv"
"""Topic of the events with which workers report failures that they retry."""

RETRIES = 5
"""How often a failed part is tried again, by whichever worker is free."""

TASK_OPTIONS = {"resources": RESOURCE, "retries": RETRIES, "pure": False}
"""How tasks are submitted."""

_LONGEST_WAIT_S = 60.0
_AGAIN = "what is made is kept: run the same command again"


def make(
    job: Job,
    workers: Workers,
    *,
    progress: Callable[[int, int], None] | None = None,
    warn: Callable[[str], None] | None = None,
    note: Callable[[str], None] | None = None,
) -> Made:
    """Make the dataset of a job, the same bytes as :func:`omniscv.make.make`; continue one that exists.

    Args:
        job: what to make; workers reach its addresses and its ``out``.
        workers: where they run.
        progress: called with (frames done, frames of the job).
        warn: called with lines about doubtful pixels, and servers that failed and are retried.
        note: called with the address of the dashboard.

    Raises:
        ArgumentError: the dataset cannot be made of this job.
        ClusterError: the scheduler is gone, or a part failed at every attempt; frames that were made stay.
        OmniscvError: as :func:`omniscv.make.make`.
    """
    check_dataset(job)
    if job.worlds:
        wanted = "expected a job with one source for workers that keep it open"
        raise ArgumentError(f"worlds: {wanted}, got {len(job.worlds)}; run parts with --shard I/N instead")
    with workers.client(job.sources) as client:
        if note:
            note(f"dashboard: {client.dashboard_link}")
        job, made = _make_parts(client, job, progress, warn)
    finish(job, len(parts_of(job)), warn)
    return made


def _make_parts(
    client: Client,
    job: Job,
    progress: Callable[[int, int], None] | None,
    warn: Callable[[str], None] | None,
) -> tuple[Job, Made]:
    """Make all parts; return the job with its poses, and the counts of frames."""
    if warn:
        client.subscribe_topic(TOPIC, lambda event: warn(str(event[1])))
    written = kept = warnings = 0
    try:
        client.register_plugin(ServerPlugin(job.sources, source_options(job)))
        if job.sampling is not None:
            (job,) = _results(client, [client.submit(with_poses, job, **TASK_OPTIONS)])
        client.register_plugin(JobPlugin(job))
        for done in _results(client, client.map(make_part, parts_of(job), **TASK_OPTIONS)):
            if isinstance(done, Exception):
                raise done
            made, marked = done
            written, kept, warnings = written + made.written, kept + made.kept, warnings + marked
            if progress:
                progress(written + kept, len(job))
    finally:
        for name in (SERVER_PLUGIN, JOB_PLUGIN) if client.status == "running" else ():
            with suppress(OSError, ValueError):  # the scheduler is gone, or the plugin was not registered
                client.unregister_worker_plugin(name)
    if warnings and warn:
        warn(f"{warnings} images have unsure or occluded pixels: see their layers unsure and occluded")
    return job, Made(written, kept)


def _results(client: Client, futures: Sequence[Future]) -> Iterator[Any]:
    """Yield the results of tasks as they complete; cancel the rest if one fails.

    Raises:
        ClusterError: a task failed at every attempt, or the scheduler is gone.
    """
    try:
        for future in as_completed(futures, loop=client.loop):
            if future.status == "cancelled":
                raise ClusterError(f"expected the scheduler to stay, its connection is lost; {_AGAIN}")
            if future.status == "error":
                fault = future.exception()
                times = f"expected every part to be made, one failed {RETRIES + 1} times"
                raise ClusterError(f"{times}: {type(fault).__name__}: {fault}; {_AGAIN}") from fault
            yield future.result()
    finally:
        if client.status == "running":
            client.cancel(list(futures), force=True)


# -- in a worker -----------------------------------------------------------------------------------------


class ServerPlugin(WorkerPlugin):  # type: ignore[misc] # distributed is imported without its types
    """The server of a worker: a game that it launches, one at an address, or a mock server.

    It is opened by the first task, not when the worker starts: a game may take minutes, and Dask takes a
    worker that does not answer meanwhile for dead.

    Args:
        addresses: of the job's source; if there are several, a worker takes the one of its number.
        options: of :func:`omniscv.open_source`.
    """

    name = SERVER_PLUGIN

    def __init__(self, addresses: Sequence[str], options: SourceOptions) -> None:
        self._addresses, self._options = tuple(addresses), options

    def setup(self, worker: Any) -> None:
        """Start without a source."""
        self._worker = worker
        self._source: Source | None = None
        self._failures, self._ending = 0, False
        keep_freed_memory()

    async def teardown(self, worker: Any) -> None:
        """Close the source, and with it what it launched."""
        self._ending = True
        await asyncio.to_thread(self._close)

    def use(self, work: Callable[[Source], T]) -> T:
        """Run a function of the source. After a failure the next call opens the source again.

        Repeated failures wait longer and longer, up to a minute: a worker without a server would otherwise
        fail tasks faster than other workers complete them.

        Raises:
            Exception: as the function, or opening the source.
        """
        try:
            if self._source is None:
                self._source = open_source(self._address(), **self._options)
            result = work(self._source)
        except Exception as fault:
            with suppress(OmniscvError, OSError):  # of a server that is gone
                self._close()
            if not (self._ending or isinstance(fault, ArgumentError)):
                self._worker.log_event(TOPIC, f"worker {self._worker.name}: {fault}")
                time.sleep(min(_LONGEST_WAIT_S, 0.1 * (2**self._failures - 1)))
                self._failures += 1
            raise
        self._failures = 0
        return result

    def _address(self) -> str:
        if len(self._addresses) == 1:
            return self._addresses[0]
        number = str(self._worker.name)
        if not number.isdecimal() or int(number) >= len(self._addresses):
            last = len(self._addresses) - 1
            wanted = f"expected workers named 0 to {last}, for the addresses of the source"
            raise ArgumentError(f"--cluster: {wanted}, got {number!r}; start them with --name")
        return self._addresses[int(number)]

    def _close(self) -> None:
        source, self._source = self._source, None
        if source is not None:
            source.close()


class JobPlugin(WorkerPlugin):  # type: ignore[misc] # distributed is imported without its types
    """The job, sent to every worker once, not with every task."""

    name = JOB_PLUGIN

    def __init__(self, job: Job) -> None:
        self.job = job


def make_part(part: Part) -> tuple[Made, int] | Exception:
    """Make a part of the worker's job with its server.

    Returns:
        The counts of frames, and how many have unsure or occluded pixels; or what is wrong with the job,
        which another attempt would not mend.
    """
    plugins, warnings = get_worker().plugins, list[str]()

    def work(source: Source) -> Made:
        return run_part(plugins[JOB_PLUGIN].job, part, source=source, warn=warnings.append)

    try:
        return plugins[SERVER_PLUGIN].use(work), len(warnings)
    except (ArgumentError, DatasetError) as refused:
        return refused


def with_poses(job: Job) -> Job:
    """Return a job with the poses that it samples in the worker's source."""

    def work(source: Source) -> Job:
        with opened(job, source) as (sampled, _):
            return sampled

    sampled: Job = get_worker().plugins[SERVER_PLUGIN].use(work)
    return sampled
