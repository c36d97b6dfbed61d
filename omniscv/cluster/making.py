"""Make the dataset of a job by the workers of a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from omniscv.cluster.workers import Workers
from omniscv.errors import ClusterError
from omniscv.job import Job
from omniscv.make import Made, check_dataset, finish, parts_of, source_options

if TYPE_CHECKING:
    from distributed import Client, Future

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
    from omniscv.cluster.tasks import (
        JOB_PLUGIN,
        SERVER_PLUGIN,
        TASK_OPTIONS,
        TOPIC,
        JobPlugin,
        ServerPlugin,
        make_part,
        with_poses,
    )

    if warn:
        client.subscribe_topic(TOPIC, lambda event: warn(str(event[1])))
    written = kept = warnings = 0
    try:
        client.register_plugin(ServerPlugin(job.sources, source_options(job)))
        if job.sampling is not None:
            (job,) = _results(client, [client.submit(with_poses, job, **TASK_OPTIONS)])
        client.register_plugin(JobPlugin(job))
        for done in _results(client, client.map(make_part, parts_of(job), **TASK_OPTIONS)):
            if done.refused is not None:
                raise done.refused
            written, kept = written + done.written, kept + done.kept
            warnings += done.warnings
            if progress:
                progress(written + kept, len(job))
    finally:
        for name in (SERVER_PLUGIN, JOB_PLUGIN) if client.status == "running" else ():
            with suppress(OSError, ValueError):  # the scheduler is gone, or the plugin was not registered
                client.unregister_worker_plugin(name)
    if warnings and warn:
        warn(f"{warnings} images have unsure or occluded pixels: see their STEM.unsure.png and occluded.png")
    return job, Made(written, kept)


def _results(client: Client, futures: Sequence[Future]) -> Iterator[Any]:
    """Yield the results of tasks as they complete; cancel the rest if one fails.

    Raises:
        ClusterError: a task failed at every attempt, or the scheduler is gone.
    """
    from distributed import as_completed

    from omniscv.cluster.tasks import RETRIES

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
