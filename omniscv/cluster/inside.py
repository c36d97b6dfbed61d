"""What runs inside workers: their server, the job, and its parts.

A worker sends an event before each frame. If its process ends, the last event names the frame that ended it.
A worker returns a failure at once: it neither waits nor tries again, because another worker may be free.
"""

import asyncio
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from distributed import WorkerPlugin, get_worker

from omniscv import __version__
from omniscv.errors import (
    ArgumentError,
    ClusterError,
    OmniscvError,
    SourceError,
    StorageError,
    StoreRefusedError,
)
from omniscv.job import Job
from omniscv.make import Made, Part, check_worlds, opened, run_part
from omniscv.parallel import keep_freed_memory
from omniscv.progress import Progress
from omniscv.sources.base import Source
from omniscv.sources.registry import SourceOptions, open_source

T = TypeVar("T")

_FLUSH_S = 0.005
"""Seconds in which an event leaves the process, before a frame that may end it."""
_SLOW_FLUSH_S = 0.1
"""The same for a task of which a worker has ended before."""
_NEWS_EVERY_S = 5.0  # events of progress within a frame


class How(NamedTuple):
    """How a task is done after workers have died of it.

    Attributes:
        carefully: one frame after the other, with an event that surely comes before each.
        lost: frames that are left out, with the error of each.
    """

    carefully: bool = False
    lost: Mapping[str, str] = {}


@dataclass(frozen=True)
class Failure:
    """What came of a task in place of its result.

    Attributes:
        worker: its address and name.
        message: in one line.
        is_final: whether another attempt, or worker, would fail alike.
        error: to be raised as it is; None for one that is no error of this package.
    """

    worker: tuple[str, str]
    message: str
    is_final: bool
    error: OmniscvError | None = None


class ServerPlugin(WorkerPlugin):  # type: ignore[misc] # distributed is imported without its types
    """The server of a worker: a game that it launches, one at an address, or a mock server.

    It is opened by the first task, not when the worker starts: a game may take minutes, and Dask takes a
    worker that does not answer meanwhile for dead.

    Args:
        run: the name of the run.
        addresses: of the source: one, or one for each worker by its number; empty if tasks open their own.
        options: with which the source is opened.
    """

    def __init__(self, run: str, addresses: Sequence[str], options: SourceOptions) -> None:
        self.name = _server(run)
        self.version = __version__
        self._addresses = tuple(addresses)
        self._options = options

    def setup(self, worker: Any) -> None:
        """Start without a source."""
        self._worker = worker
        self._source: Source | None = None
        keep_freed_memory()

    async def teardown(self, worker: Any) -> None:
        """Close the source, and with it what it launched."""
        await asyncio.to_thread(self._close)

    def use(self, work: Callable[[Source | None], T]) -> T:
        """Run a function of the source. After a failure the next call opens the source again."""
        try:
            if self._source is None and self._addresses:
                self._source = open_source(self._address(), **self._options)
            return work(self._source)
        except Exception:
            with suppress(OmniscvError, OSError):  # of a server that is gone
                self._close()
            raise

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
        source = self._source
        self._source = None
        if source is not None:
            source.close()


class JobPlugin(WorkerPlugin):  # type: ignore[misc] # distributed is imported without its types
    """The job, and the keys of its frames that are chosen: sent to every worker once, not with every task.

    Args:
        run: the name of the run.
        job: whose parts are made.
        chosen: the keys of the frames that are made; None for all.
    """

    def __init__(self, run: str, job: Job, chosen: Collection[str] | None) -> None:
        self.name = _job(run)
        self.job = job
        self.chosen = chosen


def make_part(run: str, task: int, how: How, part: Part) -> tuple[Made, list[str]] | Failure:
    """Make a part of the run's job; return the counts of its frames, and lines about them.

    Args:
        run: the name of the run.
        task: its number.
        how: it is done.
        part: to be made.
    """
    lines: list[str] = []

    def work(source: Source | None, begins: Callable[[str], None], heard: Callable[[Progress], None]) -> Made:
        """Make the part in a ``source``; ``begins`` gets the keys of frames, ``heard`` the progress."""
        plugin = get_worker().plugins[_job(run)]
        return run_part(
            plugin.job,
            part,
            source=source,
            warn=lines.append,
            progress=heard,
            chosen=plugin.chosen,
            begins=begins,
            lost=how.lost,
            carefully=how.carefully,
        )

    made = _done(run, task, how, work)
    return made if isinstance(made, Failure) else (made, lines)


def with_poses(run: str, task: int, how: How, job: Job) -> Job | Failure:
    """Return a job with the poses that it samples in the worker's source, or in the sources of its worlds.

    Args:
        run: the name of the run.
        task: its number.
        how: it is done.
        job: whose poses are sampled.
    """

    def work(source: Source | None, *_: object) -> Job:
        if job.worlds:
            return check_worlds(job, dataset=True)
        with opened(job, source) as opening:
            return opening[0]

    return _done(run, task, how, work)


def _done(run: str, task: int, how: How, work: Callable[..., T]) -> T | Failure:  # noqa: PLR0915 - the order of a part's steps
    """Return the result of a function of the worker's source, a function to call with each frame's key before
    it is begun, and one to call with its progress; or what failed."""
    worker = get_worker()
    names = worker.address, str(worker.name)
    last_s = 0.0
    is_counted = False

    def send_event(frame: str, missing: int | None = None) -> None:
        """Send an event: the ``frame`` that is begun, and how many frames are ``missing`` at the start."""
        nonlocal last_s
        last_s = time.monotonic()
        event = {"task": task, "name": names[1], "frame": frame, "missing": missing}
        worker.log_event(run, event)  # Dask adds the worker's address

    def begins(frame: str) -> None:
        send_event(frame)
        time.sleep(_SLOW_FLUSH_S if how.carefully else _FLUSH_S)

    def heard(progress: Progress) -> None:
        nonlocal is_counted
        if not is_counted or time.monotonic() - last_s > _NEWS_EVERY_S:
            is_counted = True
            send_event("", progress.of_images)

    begins("")
    try:
        server = worker.plugins.get(_server(run))
        if server is None or server.version != __version__:
            version = "another" if server is None else server.version
            wanted = f"expected omniscv {version} at worker {names[1]}, as where the command runs"
            raise ClusterError(f"--cluster: {wanted}, got {__version__}; install the same version there")
        result: T = server.use(lambda source: work(source, begins, heard))
        return result
    except OmniscvError as fault:
        is_passing = isinstance(fault, SourceError | StorageError) and not isinstance(
            fault, StoreRefusedError
        )
        return Failure(names, fault.message, not is_passing, fault)
    except (OSError, MemoryError) as fault:  # of this worker, such as a full disk
        return Failure(names, f"{type(fault).__name__}: {fault}", is_final=False)
    except Exception as fault:  # a fault of the program
        return Failure(names, f"{type(fault).__name__}: {fault}", is_final=True)


def _server(run: str) -> str:
    return f"{run}-server"


def _job(run: str) -> str:
    return f"{run}-job"
