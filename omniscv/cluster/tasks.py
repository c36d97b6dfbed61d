"""Tasks of a run, by the means of Dask: submitted a few at a time, and again where workers fail or end.

Dask chooses the worker. A task that failed names those that it may go to: the others. A worker that fails
several tasks in a row gets no more. Of a worker that ended, its last event names the frame that it made: the
task is then done frame by frame, and a frame that ends a second worker is left out, or ends the run.
"""

import queue
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, field
from typing import Any

from distributed import Client, Future
from distributed.scheduler import KilledWorker

from omniscv.cluster.inside import Failure, How
from omniscv.cluster.workers import RESOURCE
from omniscv.errors import ArgumentError, ClusterError

PATIENCE_S = 600.0
"""Seconds without news of any worker after which a run ends."""

RETRIES = 5
"""How often a failed task is tried again."""

_FAILED_IN_A_ROW = 3  # tasks of one worker, after which it is set aside
_DEATHS = 2  # of workers that made one frame, after which it counts as failed
_MOST_DEATHS = 6  # of workers that had one task, without a frame that is known
# of a run without workers, and of one that waits for them
_FIRST_LINE_S = 10.0
_LINES_EVERY_S = 60.0
_LOOK_EVERY_S = 2.0
_ANSWER_S = 30.0
_LONGEST_WAIT_S = 60.0
_AGAIN = "what is made is kept: making the dataset again goes on"


@dataclass(eq=False)
class Task:
    """Work for a worker, and what came of it so far.

    Attributes:
        name: in messages.
        function: of a run's name, the task's number, :class:`How`, and ``arguments``.
        failures: attempts that failed.
        tried: addresses of workers at which they did.
        due_s: by the monotonic clock, before which it is not tried again.
        worker: address and name of the one that has begun it; empty before.
        frame: that this worker has begun last; empty before.
        deaths: of workers, by the frame that they had begun.
        lost: frames that are left out, with the error of each.
        missing: how many frames the first attempt had to make; None if it did not say.
    """

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    failures: int = 0
    tried: set[str] = field(default_factory=set)
    due_s: float = 0.0
    worker: tuple[str, str] = ("", "")
    frame: str = ""
    deaths: Counter[str] = field(default_factory=Counter)
    lost: dict[str, str] = field(default_factory=dict)
    missing: int | None = None


class Tasks:
    """Tasks of a run.

    Args:
        client: of the scheduler.
        run: the run's name, and topic of its events.
        patience_s: seconds without news after which the run ends.
        warn: called with lines about workers that fail, end, or are missing.
    """

    def __init__(self, client: Client, run: str, patience_s: float, warn: Callable[[str], None]) -> None:
        self._client = client
        self._run = run
        self._patience_s = patience_s
        self._warn = warn
        self._alive: dict[str, str] = {}
        self._aside: set[str] = set()
        self._failed: Counter[str] = Counter()  # tasks in a row, by address
        self._ended: set[str] = set()  # addresses whose end was laid to a task
        self._running: dict[Future, tuple[int, Task]] = {}
        self._news: queue.SimpleQueue[Future | dict[str, Any]] = queue.SimpleQueue()
        self._looked_s = 0.0
        self._heard_s = time.monotonic()
        self._line_s = _FIRST_LINE_S
        client.subscribe_topic(run, lambda event: self._news.put(event[1]))

    @property
    def workers(self) -> int:
        """How many workers take tasks."""
        return len(self._alive.keys() - self._aside)

    def results(
        self, tasks: Sequence[Task], most_lost: float, report: Callable[[], None] = lambda: None
    ) -> Iterator[tuple[Task, Any]]:
        """Yield tasks with their results, as they are done.

        Args:
            tasks: to be done.
            most_lost: how many frames may be left out, because workers died of them.
            report: called about once a second.

        Raises:
            ClusterError: the scheduler is gone; or nothing was heard of any worker; or a task failed at every
                attempt, or for a reason that no attempt mends.
            OmniscvError: such a reason of a task.
        """
        left = deque(enumerate(tasks))
        self._heard_s = time.monotonic()
        try:
            while left or self._running:
                may_lose = most_lost - sum(len(task.lost) for task in tasks)
                left.extendleft(self._look(may_lose))
                self._submit(left)
                report()
                for news in self._arrived():
                    if isinstance(news, dict):
                        self._began(news)
                    elif news in self._running:
                        number, task = self._running.pop(news)
                        outcome = self._outcome(news, task, may_lose)
                        if outcome is None:
                            left.appendleft((number, task))
                        else:
                            yield task, outcome[0]
        finally:
            if self._client.status == "running":
                self._client.cancel(list(self._running), force=True)
            self._running.clear()

    def _arrived(self) -> list[Future | dict[str, Any]]:
        """Return what has come within a second, or at once if something is there."""
        news = []
        try:
            news.append(self._news.get(timeout=1.0))
            while True:
                news.append(self._news.get_nowait())
        except queue.Empty:
            return sorted(news, key=lambda item: not isinstance(item, dict))  # what was begun, then results

    # -- submitting ---------------------------------------------------------------------------------------

    def _submit(self, left: deque[tuple[int, Task]]) -> None:
        """Submit as many tasks as workers can soon begin: more would wait at one that may fail."""
        now = time.monotonic()
        most = 2 * self.workers + 2
        for _ in range(len(left)):
            if len(self._running) >= most:
                return
            number, task = left.popleft()
            if task.due_s > now:
                left.append((number, task))
                continue
            self._submit_one(number, task)

    def _submit_one(self, number: int, task: Task) -> None:
        task.worker = ("", "")
        task.frame = ""
        how = How(carefully=bool(task.deaths or task.lost), lost=dict(task.lost))
        untried = self._alive.keys() - self._aside - task.tried
        usable = untried or self._alive.keys() - self._aside
        only = sorted(usable) if usable != self._alive.keys() else None
        future = self._client.submit(
            task.function,
            self._run,
            number,
            how,
            *task.arguments,
            key=f"{self._run}-{number}-{time.monotonic_ns()}",
            pure=False,
            retries=0,
            resources=RESOURCE,
            workers=only,
            allow_other_workers=only is not None,
        )
        self._running[future] = number, task
        future.add_done_callback(self._news.put)

    # -- what comes ---------------------------------------------------------------------------------------

    def _began(self, event: dict[str, Any]) -> None:
        self._heard()
        for number, task in self._running.values():
            if number == event["task"]:
                task.worker = event["worker"], event["name"]
                task.frame = event["frame"] or task.frame
                if task.missing is None:
                    task.missing = event["missing"]

    def _heard(self) -> None:
        self._heard_s = time.monotonic()
        self._line_s = _FIRST_LINE_S

    def _outcome(self, future: Future, task: Task, may_lose: float) -> tuple[Any] | None:
        """Return the result of a task, in a tuple; None if it is to be submitted again."""
        if future.status == "finished":
            self._heard()
            result = future.result()
            if not isinstance(result, Failure):
                self._failed[task.worker[0]] = 0
                return (result,)
            self._fail(task, result)
            return None
        fault = future.exception() if future.status == "error" else None
        if isinstance(fault, KilledWorker):
            self._die(task, fault.last_worker.address, may_lose)
            return None
        if fault is None:
            raise self._lost_scheduler()
        raise ClusterError(f"{task.name}: expected a result, got {type(fault).__name__}: {fault}; {_AGAIN}")

    def _fail(self, task: Task, failure: Failure) -> None:
        """Count a failed attempt; raise what no other attempt mends."""
        address, name = failure.worker
        if failure.is_final:
            if type(failure.error) is ArgumentError:  # of this worker perhaps, as of other versions there
                raise ArgumentError(f"worker {name}: {failure.error.message}")
            if failure.error is not None:
                raise failure.error
            raise ClusterError(f"{task.name}, at worker {name}: {failure.message}; {_AGAIN}")
        task.failures += 1
        task.tried.add(address)
        self._failed[address] += 1
        if address not in self._aside:
            self._warn(f"worker {name}: {failure.message}")
        if task.failures > RETRIES:
            times = f"expected every part to be made, {task.name} failed {task.failures} times"
            raise ClusterError(f"{times}, the last time at worker {name}: {failure.message}; {_AGAIN}")
        if self._failed[address] == _FAILED_IN_A_ROW and self._others_work(address):
            self._aside.add(address)
            row = f"it failed {_FAILED_IN_A_ROW} parts in a row"
            self._warn(f"worker {name}: set aside, because {row}; the others go on")
        if (
            not self._alive.keys() - self._aside - task.tried
        ):  # all have failed: each may start its server anew
            wait_s = min(_LONGEST_WAIT_S, 0.1 * (2**task.failures - 1))
            task.due_s = time.monotonic() + wait_s

    def _others_work(self, address: str) -> bool:
        """Return whether some other worker has not failed last."""
        others = self._alive.keys() - self._aside - {address}
        return any(not self._failed[other] for other in others)

    def _die(self, task: Task, address: str, may_lose: float) -> None:
        """Note that a worker ended which had a task, and lay it to the frame that it had begun, if any."""
        name = task.worker[1] if task.worker[0] == address else self._alive.get(address, address)
        others = [other.worker[0] for _, other in self._running.values()]
        if task.worker[0] != address and (address in self._ended or address in others):
            return  # another task was being done
        self._ended.add(address)
        task.deaths[task.frame] += 1
        if task.frame and task.deaths[task.frame] >= _DEATHS:
            line = f"{task.frame}: expected a frame, but {_DEATHS} workers ended while they made it"
            if may_lose < 1:
                raise ClusterError(f"{line}; 'failures: {{skip: 0.01}}' leaves such frames out; {_AGAIN}")
            task.lost[task.frame] = line.partition(": ")[2]
            task.deaths.clear()
            return
        if task.deaths.total() >= _MOST_DEATHS:
            times = f"expected every part to be made, but {_MOST_DEATHS} workers ended that had {task.name}"
            raise ClusterError(f"{times}; is there enough memory? {_AGAIN}")
        when = f" while it made {task.frame}" if task.frame else ""
        self._warn(f"worker {name}: ended{when}; {task.name} is made again, frame by frame")

    # -- watching -----------------------------------------------------------------------------------------

    def _look(self, may_lose: float) -> list[tuple[int, Task]]:
        """See which workers are there, and return the tasks of those that are gone; say if none are, or if
        nothing happens, and end if that lasts too long."""
        now = time.monotonic()
        if now - self._looked_s < _LOOK_EVERY_S:
            return []
        self._looked_s = now
        try:
            identity = self._client.scheduler.identity
            answer = self._client.sync(identity, n_workers=-1, callback_timeout=_ANSWER_S)
        except (OSError, TimeoutError, AttributeError, ValueError) as cause:
            raise self._lost_scheduler() from cause
        workers = {}
        for address, worker in answer["workers"].items():
            if RESOURCE.keys() <= worker["resources"].keys():
                workers[address] = str(worker["name"])
        if workers and not self._alive:
            self._heard()
        gone = self._taken_back(self._alive.keys() - workers.keys(), may_lose)
        self._alive = workers
        self._say_silence(now - self._heard_s)
        return gone

    def _taken_back(self, addresses: Set[str], may_lose: float) -> list[tuple[int, Task]]:
        """Take back the tasks of workers that are gone, which Dask would give to others as they are."""
        gone = []
        tasks = []
        for future, (number, task) in self._running.items():
            if task.worker[0] in addresses and future.status == "pending":
                gone.append(future)
                tasks.append((number, task))
        self._client.cancel(gone, force=True)
        for future in gone:
            del self._running[future]
        for _, task in tasks:
            self._die(task, task.worker[0], may_lose)
        return tasks

    def _say_silence(self, seconds: float) -> None:
        if seconds > self._patience_s:
            silence = f"{self.workers} workers, and nothing for {self._patience_s:.0f} s"
            raise ClusterError(
                f"expected workers that make frames, got {silence}; {_AGAIN}; a longer --patience waits"
            )
        wait_s = self._line_s if not self._alive else max(self._line_s, _LINES_EVERY_S)
        if seconds < wait_s:
            return
        self._line_s = wait_s + _LINES_EVERY_S
        patience = f"--patience is {self._patience_s:.0f} s"
        if not self._alive:
            self._warn(f"0 workers, waiting since {seconds:.0f} s; {patience}")
            return
        busy = []
        for _, task in self._running.values():
            if task.worker[0]:
                busy.append(f"{task.worker[1]} at {task.frame or task.name}")
        waiting = f"workers {', '.join(busy[:4])}" if busy else f"{self.workers} workers"
        self._warn(f"nothing for {seconds:.0f} s, waiting for {waiting}; {patience}")

    def _lost_scheduler(self) -> ClusterError:
        return ClusterError(f"expected the scheduler to stay, its connection is lost; {_AGAIN}")
