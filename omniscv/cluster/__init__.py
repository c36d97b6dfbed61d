"""Datasets on many machines: the parts of a job as tasks of Dask, one server for each worker.

Dask schedules the tasks. A worker opens one server and makes parts with it. It writes into the dataset's
folder and returns only counts, or what is wrong with the job. Workers run at ``local:4``, or at the address
of a scheduler (:mod:`omniscv.cluster.workers`); what runs in them is :mod:`omniscv.cluster.inside`.
"""

import secrets
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from distributed import Client, Lock, WorkerPlugin
from distributed.protocol.pickle import dumps

from omniscv.cluster.inside import JobPlugin, ServerPlugin, make_part, with_poses
from omniscv.cluster.tasks import PATIENCE_S, Task, Tasks
from omniscv.cluster.workers import Workers, check_versions, scheduler_at, workers_of
from omniscv.errors import ArgumentError, ClusterError
from omniscv.job import Job
from omniscv.make import Made, check_dataset, chosen_keys, finish, parts_of, source_options, with_places
from omniscv.storage import is_url
from omniscv.storage.remote import scheme_of

__all__ = ["PATIENCE_S", "Progress", "Workers", "make", "scheduler_at", "workers_of"]

_ANSWER_S = 60.0
_CLOSED_S = 15.0
"""Seconds for all workers to take a plugin; and at the end to close their servers, which goes on later."""

_LOCK_WAIT_S = 40.0
"""Longer than Dask keeps the lock of a client that was killed."""


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Attributes:
        frames: that are made, or existed.
        of_frames: all that are to be made.
        parts: that are finished.
        of_parts: all that are to be finished.
        workers: that take tasks.
    """

    frames: int
    of_frames: int
    parts: int
    of_parts: int
    workers: int


def make(
    job: Job,
    workers: Workers,
    *,
    limit: int | None = None,
    patience_s: float = PATIENCE_S,
    progress: Callable[[Progress], None] | None = None,
    warn: Callable[[str], None] | None = None,
    note: Callable[[str], None] | None = None,
) -> Made:
    """Make the dataset of a job, the same bytes as :func:`omniscv.make.make`; continue one that exists.

    Args:
        job: what to make; workers reach its addresses and its ``out``.
        workers: where they run.
        limit: only so many frames, as :func:`omniscv.make.make` chooses them.
        patience_s: after which a run ends that has no workers, or whose workers do nothing.
        progress: called about once a second.
        warn: called with lines about doubtful pixels, frames that are left out, workers that fail or end.
        note: called with the address of the dashboard.

    Raises:
        ArgumentError: the dataset cannot be made of this job, or not by these workers.
        ClusterError: the scheduler is gone, nothing happens, a part failed at every attempt, or workers died
            of a frame; frames that were made stay.
        OmniscvError: as :func:`omniscv.make.make`.
    """
    for world in job.each:
        check_dataset(world)
    if is_url(job.out) and scheme_of(str(job.out)) == "memory":
        wanted = "expected a folder or store that all workers reach"
        raise ArgumentError(f"out: {wanted}, got {job.out}, which is of one process; or without --cluster")
    warn = warn or (lambda line: None)
    with workers(job.sources) as client, _alone(client, warn):
        if note:
            note(f"dashboard: {client.dashboard_link}")
        check_versions(client)
        run = _Run(client, patience_s, progress, warn)
        with run.registered(ServerPlugin(run.name, () if job.worlds else job.sources, source_options(job))):
            job = run.with_poses(job)
            chosen = None if limit is None else chosen_keys(job, limit)
            count, made = run.make_parts(job, chosen)
    finish(job, count, warn, limited=chosen is not None)
    return made


@contextmanager
def _alone(client: Client, warn: Callable[[str], None]) -> Iterator[None]:
    """Refuse a scheduler that another run uses: its jobs would share workers, and their servers."""
    lock = Lock("omniscv", scheduler_rpc=client.scheduler, loop=client.loop)
    if not lock.acquire(timeout=1):
        warn(f"another run uses this scheduler, or was just killed; waiting {_LOCK_WAIT_S:.0f} s")
        if not lock.acquire(timeout=_LOCK_WAIT_S):
            busy = f"{client.scheduler.address}, which another run uses"
            raise ClusterError(
                f"--cluster: expected a scheduler for this job alone, got {busy}; start another one"
            )
    try:
        yield
    finally:
        if client.status == "running":
            with suppress(OSError, RuntimeError):  # the scheduler has just ended
                lock.release()


class _Run:
    """A job that is made by the workers of a scheduler."""

    def __init__(
        self,
        client: Client,
        patience_s: float,
        progress: Callable[[Progress], None] | None,
        warn: Callable[[str], None],
    ) -> None:
        self.name = f"omniscv-{secrets.token_hex(4)}"
        self._client = client
        self._progress = progress
        self._warn = warn
        self._tasks = Tasks(client, self.name, patience_s, warn)

    @contextmanager
    def registered(self, plugin: WorkerPlugin) -> Iterator[None]:
        """Give every worker a plugin, also those that join later.

        The scheduler waits for the answers of all workers. The client's own calls would wait for a frozen one
        for ever.
        """
        scheduler = self._client.scheduler
        try:
            plugin_bytes = dumps(plugin)
            self._sync(
                _ANSWER_S,
                scheduler.register_worker_plugin,
                plugin=plugin_bytes,
                idempotent=False,
                name=plugin.name,
            )
            yield
        finally:
            if self._client.status == "running":
                with suppress(OSError, ValueError, ClusterError):  # it is gone, or was not registered
                    self._sync(_CLOSED_S, scheduler.unregister_worker_plugin, name=plugin.name)

    def _sync(self, seconds: float, call: Callable[..., Any], **arguments: Any) -> None:
        """Call the scheduler, and raise what a worker answers, or that one does not."""
        try:
            answers = self._client.sync(call, **arguments, callback_timeout=seconds)
        except TimeoutError as cause:
            wanted = f"expected all workers to answer in {seconds:.0f} s"
            raise ClusterError(f"--cluster: {wanted}, one is frozen, or unreachable; end it") from cause
        for answer in answers.values():
            if answer["status"] == "error":
                fault = answer.get("exception_text", answer)
                raise ClusterError(f"--cluster: expected workers that take the job, got: {fault}")

    def with_poses(self, job: Job) -> Job:
        """Return a job with the poses that a worker's sources give, and the places of all."""
        opens = any(world.sampling is not None or world.own_cameras for world in job.each)
        if opens or job.worlds:
            task = Task("poses", with_poses, (job,))
            ((_, job),) = self._tasks.results([task], 1.0)
        return job if job.worlds else with_places(job)

    def make_parts(self, job: Job, chosen: Collection[str] | None) -> tuple[int, Made]:
        """Make all parts of a ``job``; return their number, and the counts of frames.

        ``chosen`` are the keys of the frames that are made; None: all frames are.
        """
        frames = sum(map(len, job.each)) if chosen is None else len(chosen)
        parts = parts_of(job, frames)
        tasks = [Task(f"part {part.index}", make_part, (part,)) for part in parts]
        written = 0
        kept = 0
        failed = 0
        finished = 0
        said: set[str] = set()

        def report() -> None:
            if self._progress:
                state = Progress(
                    frames=written + kept,
                    of_frames=frames,
                    parts=finished,
                    of_parts=len(parts),
                    workers=self._tasks.workers,
                )
                self._progress(state)

        with self.registered(JobPlugin(self.name, job, chosen)):
            for task, result in self._tasks.results(tasks, job.failures.skip * frames, report):
                made, lines = result
                # The last attempt finds frames that earlier ones have made.
                earlier = 0 if task.missing is None else task.missing - made.failed - made.written
                written += made.written + max(0, earlier)
                kept += made.kept - max(0, earlier)
                failed += made.failed
                finished += 1
                for line in lines:
                    if line not in said:  # some are of the whole job
                        said.add(line)
                        self._warn(line)
                report()
        return len(parts), Made(written, kept, failed=failed)
