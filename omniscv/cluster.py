"""Datasets on many machines: the parts of a job as tasks of Dask, one server for each worker.

Dask schedules the tasks. A worker opens one server and makes parts with it. It writes into the dataset's
folder and returns only counts, or what is wrong with the job. Workers run at ``local:4``, or at the address
of a scheduler.
"""

import asyncio
import logging
import re
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from typing import Any, TypeVar

from omniscv.arguments import wrong
from omniscv.errors import ArgumentError, ClusterError, DatasetError, OmniscvError
from omniscv.job import Job
from omniscv.make import Made, Part, check_dataset, finish, opened, parts_of, run_part, source_options
from omniscv.parallel import keep_freed_memory
from omniscv.sources.base import Source
from omniscv.sources.registry import SourceOptions, open_source

try:
    from dask import config
    from distributed import Client, Future, LocalCluster, WorkerPlugin, as_completed, get_worker
except ImportError as cause:
    wanted = "expected the packages of clusters: pip install 'omniscv[cluster]'"
    raise ArgumentError(f"--cluster: {wanted}; got: {cause}") from cause

T = TypeVar("T")

RESOURCE = {"server": 1}
"""Dask resource: one unit per worker, one per task, so that each worker runs one task at a time."""

SETTINGS: dict[str, Any] = {
    # When a worker dies, Dask counts a failure for all tasks assigned to it, not only the one that it ran.
    "distributed.scheduler.allowed-failures": 20,
    "distributed.scheduler.worker-saturation": 1.0,
    # Near its memory limit a worker pauses until it has spilled results: there are none.
    "distributed.worker.memory.pause": False,
    # A hundred samples a second of each worker, for a page of the dashboard.
    "distributed.worker.profile.enabled": False,
}
"""Of the schedulers and workers that are started here; docs/scale.md lists them for others."""


def settings() -> dict[str, Any]:
    """Return the ``SETTINGS`` that the user's files and environment for Dask leave open."""
    configured = config.collect()
    return {key: value for key, value in SETTINGS.items() if config.get(key, None, config=configured) is None}


def dask_setup(worker: object) -> None:
    """Ignore SIGINT in local workers, which preload this module: Ctrl-C reaches them too, and the command
    ends them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


Workers = Callable[[Sequence[str]], AbstractContextManager[Client]]
"""Gives a client of a scheduler whose workers have, or will have, one server each; the addresses of a job's
source, its argument, are each for one worker if there are several."""


def workers_of(place: str) -> Workers:
    """Return the workers that a word describes: ``local:4`` or a scheduler's address."""
    kind, _, rest = place.partition(":")
    if kind == "local" and re.fullmatch(r"[1-9][0-9]{0,3}|", rest):
        return partial(_local, int(rest) if rest else None)
    if re.fullmatch(r"(tcp|tls|ucx|ws|wss)://.+", place):
        return partial(scheduler_at, place)
    raise wrong("--cluster", "local, local:N or a scheduler such as tcp://host:8786", place)


@contextmanager
def _local(workers: int | None, sources: Sequence[str]) -> Iterator[Client]:
    """Start processes on this machine, as many as the source has addresses if None; they end with the
    context. Dask restarts a worker that dies. The scheduler runs in this process."""
    workers = workers or len(sources)
    if workers > len(sources) > 1:
        wanted = f"expected at most {len(sources)} workers, one for each address of the source"
        raise ArgumentError(f"--cluster: {wanted}, got {workers}")
    with (
        config.set(settings()),
        _started(workers) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


def _started(workers: int) -> LocalCluster:
    try:
        return LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=0,  # an equal share may be less than one worker needs
            silence_logs=logging.CRITICAL,
            resources=RESOURCE,
            preload=[__name__],
        )
    except (RuntimeError, OSError) as cause:
        wanted = f"--cluster: expected {workers} workers to start, but one ended, as when memory runs out"
        raise ClusterError(f"{wanted}: {str(cause).rstrip('.')}; run again, or with fewer") from cause


@contextmanager
def scheduler_at(address: str, sources: Sequence[str], timeout_s: float = 10.0) -> Iterator[Client]:
    """Connect to a running scheduler, such as ``tcp://node7:8786``, whose workers have a server each."""
    try:
        client = Client(address, timeout=timeout_s, set_as_default=False)
    except (OSError, ValueError) as cause:
        wanted = f"expected a scheduler of Dask at {address}"
        raise ClusterError(f"{wanted}, got: {cause}; start it with 'dask scheduler'") from cause
    with client:
        workers = client.scheduler_info(n_workers=-1)["workers"].values()
        names = [worker["name"] for worker in workers if not RESOURCE.keys() <= worker["resources"].keys()]
        if names:
            wanted = "expected workers started with --resources 'server=1'"
            raise ClusterError(f"{address}: {wanted}, got {len(names)} without, such as {names[0]}")
        yield client


# -- making ---------------------------------------------------------------------------------------------

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
    with workers(job.sources) as client:
        if note:
            note(f"dashboard: {client.dashboard_link}")
        job, made = _make_parts(client, job, progress, warn)
    finish(job, len(parts_of(job)), warn)
    return made


def _make_parts(
    client: Client, job: Job, progress: Callable[[int, int], None] | None, warn: Callable[[str], None] | None
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
    """Yield the results of tasks as they complete; cancel the rest if one fails."""
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
    worker that does not answer meanwhile for dead. Of several addresses it is that of the worker's number.
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
    """Make a part of the worker's job with its server; return the counts of frames, and how many have unsure
    or occluded pixels; or what is wrong with the job, which another attempt would not mend."""
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
