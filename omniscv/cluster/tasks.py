"""What workers do: parts of a job. Only counts, or what is wrong with the job, come back."""

from __future__ import annotations

from typing import Any, NamedTuple

from distributed import WorkerPlugin, get_worker

from omniscv.cluster.places import RESOURCE
from omniscv.cluster.servers import SERVER
from omniscv.errors import ArgumentError, DatasetError
from omniscv.job import Job
from omniscv.make import Part, opened, run_part
from omniscv.sources.base import Source

WORK = "omniscv-job"

RETRIES = 5
"""How often a part is tried again that failed, on whichever worker is free."""

HOW = {"resources": RESOURCE, "retries": RETRIES, "pure": False}
"""How tasks are submitted."""


class Work(WorkerPlugin):  # type: ignore[misc] # distributed is imported without its types
    """The job, sent to every worker once, not with every task."""

    name = WORK

    def __init__(self, job: Job) -> None:
        self.job = job


class Done(NamedTuple):
    """What a task returns.

    Attributes:
        written, kept: frames, as :func:`omniscv.jobs.run_part`.
        warnings: how many images have unsure or occluded pixels.
        refused: what is wrong with the job, which no other attempt mends.
    """

    written: int = 0
    kept: int = 0
    warnings: int = 0
    refused: Exception | None = None


def make_part(part: Part) -> Done:
    """Make a part of the worker's job with its server."""
    warned: list[str] = []

    def work(source: Source) -> Done:
        made = run_part(_plugin(WORK).job, part, source=source, warn=warned.append)
        return Done(made.written, made.kept, len(warned))

    try:
        done: Done = _plugin(SERVER).use(work)
    except (ArgumentError, DatasetError) as refused:
        return Done(refused=refused)
    return done


def posed(job: Job) -> Job:
    """Return a job with the poses that it samples in the worker's source."""

    def work(source: Source) -> Job:
        with opened(job, source) as (found, _):
            return found

    found: Job = _plugin(SERVER).use(work)
    return found


def _plugin(name: str) -> Any:
    return get_worker().plugins[name]
