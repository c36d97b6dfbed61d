"""Make the dataset of a job by the workers of a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from omniscv.cluster.places import Place
from omniscv.errors import ClusterError
from omniscv.job import Job
from omniscv.make import Made, check_dataset, finish, parts_of, source_options

if TYPE_CHECKING:
    from distributed import Client, Future

_AGAIN = "what is made is kept: run the same command again"


def make(
    job: Job,
    where: Place,
    *,
    progress: Callable[[int, int], None] | None = None,
    warn: Callable[[str], None] | None = None,
    note: Callable[[str], None] | None = None,
) -> Made:
    """Make the dataset of a job, the same bytes as :func:`omniscv.jobs.make`; go on with one that is there.

    Args:
        job: what to make; its addresses, and its ``out``, are those that workers reach.
        where: the workers.
        progress: called with (frames done, frames of the job).
        warn: called with a line for what is worth a look, as a server that failed and is tried again.
        note: called with a line that says where the dashboard is.

    Raises:
        ArgumentError: the dataset cannot be made of this job.
        ClusterError: the scheduler is gone, or a part failed again and again; frames that were made stay.
        OmniscvError: as :func:`omniscv.jobs.make`.
    """
    check_dataset(job)
    with where.client(job.sources) as client:
        if note:
            note(f"dashboard: {client.dashboard_link}")
        job, done = _on(client, job, progress, warn)
    finish(job, len(parts_of(job)), warn)
    return done


def _on(
    client: Client,
    job: Job,
    progress: Callable[[int, int], None] | None,
    warn: Callable[[str], None] | None,
) -> tuple[Job, Made]:
    """Make all parts; return the job with its poses, and what was done."""
    from omniscv.cluster.servers import SERVER, TOPIC, Server
    from omniscv.cluster.tasks import HOW, WORK, Work, make_part, posed

    if warn:
        client.subscribe_topic(TOPIC, lambda event: warn(str(event[1])))
    try:
        client.register_plugin(Server(job.sources, source_options(job)))
        if job.sampling is not None:
            (job,) = _results(client, [client.submit(posed, job, **HOW)])
        client.register_plugin(Work(job))
        wanted = parts_of(job)
        futures = client.map(make_part, wanted, **HOW)
        return job, _gathered(client, futures, len(job), progress, warn)
    finally:
        for name in (SERVER, WORK) if client.status == "running" else ():
            with suppress(OSError, ValueError):  # the scheduler has just gone, or the plugin never came
                client.unregister_worker_plugin(name)


def _gathered(
    client: Client,
    futures: Sequence[Future],
    total: int,
    progress: Callable[[int, int], None] | None,
    warn: Callable[[str], None] | None,
) -> Made:
    """Add up what tasks return, as it comes."""
    written = kept = warnings = 0
    for done in _results(client, futures):
        if done.refused is not None:
            raise done.refused
        written, kept = written + done.written, kept + done.kept
        warnings += done.warnings
        if progress:
            progress(written + kept, total)
    if warnings and warn:
        warn(f"{warnings} images have unsure or occluded pixels: see their STEM.unsure.png and occluded.png")
    return Made(written, kept, 0)


def _results(client: Client, futures: Sequence[Future]) -> Iterator[Any]:
    """Yield the results of tasks as they come; cancel the rest where one fails.

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
