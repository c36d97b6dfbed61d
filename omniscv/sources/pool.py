"""Several replicas of one scene as one source; the requests of a replica that fails go to the others."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import fields
from functools import cached_property
from itertools import islice
from queue import SimpleQueue
from typing import Any, NoReturn, TypeVar

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, SourceError
from omniscv.geometry.instant import Instant
from omniscv.sources.base import (
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    SourceWrapper,
    View,
    closed_error,
    not_picklable,
)
from omniscv.sources.world import SharedExposure

T = TypeVar("T", Capabilities, ObjectTable, SceneIdentity)

_BATCH = 96  # requests that a replica gets at once: enough for a live source to hide latency
_BATCH_PX = 1 << 24  # pixels that it gets at once, which wait in memory
_BATCHES_AHEAD = 2  # per replica: captured ahead of those that are used

_log = logging.getLogger("omniscv")


class SourcePool(SourceWrapper):
    """Captures from one or more replicas of one scene, such as copies of one game; they are closed with it.

    A replica that fails is not used again: the others capture its requests, and a warning is logged. All have
    the exposure that the first one finds. Raises ArgumentError for no source, or sources with other
    capabilities, objects or mask colours.
    """

    def __init__(self, sources: Sequence[Source], exposure: SharedExposure | None = None) -> None:
        if not sources:
            raise ArgumentError("sources: expected at least one, got none")
        self._sources = tuple(sources)
        self._working = list(sources)
        self._capabilities = _same_in_all([source.capabilities for source in sources])
        self._objects = _same_in_all([source.objects() for source in sources])
        self._scene = _same_in_all([source.scene_identity for source in sources])
        self._digest = sources[0].world_digest
        self._last_fault = closed_error("pool")
        self._lock = threading.Lock()
        self._closed = False
        self.share_exposure(exposure or SharedExposure())

    # of all replicas, as these:
    recorded = Source.recorded
    recorded_in = Source.recorded_in
    one_instant = Source.one_instant
    world = Source.world

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._scene

    @property
    def world_digest(self) -> str:
        return self._digest

    def objects(self) -> ObjectTable:
        self._check_working()
        return self._objects

    def recorded_views(self) -> tuple[View, ...] | None:
        """The views that every replica can replay; None where one of them is live."""
        return self._recorded_views

    def without(self, objects: Iterable[str]) -> Source:
        """A pool of the working replicas, each without the objects."""
        names = list(objects)
        return self._pool_of(lambda replica: replica.without(names))

    def at(self, instant: Instant) -> Source:
        """A pool of the working replicas at the instant; ArgumentError if they are at several, as read."""
        pool = self._pool_of(lambda replica: replica.at(instant))
        if len({replica.state for replica in pool._working}) > 1:
            pool.close()
            expected = "expected replicas at one instant, got different poses"
            raise ArgumentError(f"sources: {expected}; use one source, or freeze='puppet'")
        return pool

    def command(self, text: str) -> str:
        """Send a command to every working replica, and return the first one's reply."""
        self._check_working()
        replies = [replica.command(text) for replica in self._working]
        return replies[0]

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; the fault of the last replica is raised when all have failed."""
        self._check_working()
        batches = self._batches(iter(requests))
        idle = SimpleQueue[Source]()
        for replica in self._working:
            idle.put(replica)
        under_way: deque[Future[list[Capture]]] = deque()
        threads = ThreadPoolExecutor(len(self._sources), "capture")
        try:
            while True:
                ahead = _BATCHES_AHEAD * max(1, len(self._working))
                while len(under_way) < ahead and (batch := next(batches, None)):
                    under_way.append(threads.submit(self._capture_batch, batch, idle))
                if not under_way:
                    return
                yield from under_way.popleft().result()
        finally:
            threads.shutdown(cancel_futures=True)

    def share_exposure(self, shared: SharedExposure) -> None:
        self._exposure = shared
        for source in self._sources:
            source.share_exposure(shared)

    def close(self) -> None:
        self._closed = True
        with ExitStack() as stack:
            for source in self._sources:
                stack.callback(source.close)

    def __reduce__(self) -> NoReturn:
        raise not_picklable("pool")

    def _batches(self, requests: Iterator[Request]) -> Iterator[list[Request]]:
        """Divide requests into batches; a few requests are divided evenly, so that every replica has some."""
        while first := next(requests, None):
            replicas = max(1, len(self._working))
            most = max(1, min(_BATCH, _BATCH_PX // (first.view.width * first.view.height)))
            block = [first, *islice(requests, most * replicas - 1)]
            size = -(-len(block) // replicas)
            for start in range(0, len(block), size):
                yield block[start : start + size]

    def _capture_batch(self, requests: list[Request], idle: SimpleQueue[Source]) -> list[Capture]:
        """Capture requests on an idle replica; after its fault, the rest on the next one."""
        captures: list[Capture] = []
        while True:
            replica = idle.get()
            try:
                self._check_working()
                if replica in self._working:
                    for capture in replica.capture(requests[len(captures) :]):
                        captures.append(capture)
                    if len(captures) != len(requests):
                        raise SourceError(f"replica: expected {len(requests)} captures, got {len(captures)}")
                    return captures
            except SourceError as fault:
                self._remove(replica, fault)
                self._check_working()
            finally:
                if replica in self._working or not self._working:  # the latter for threads that wait for one
                    idle.put(replica)

    def _remove(self, replica: Source, fault: SourceError) -> None:
        with self._lock:
            if replica in self._working:
                self._working.remove(replica)
                self._last_fault = fault
                if count := len(self._working):
                    _log.warning("a replica failed, %d left to capture its requests: %s", count, fault)

    @cached_property
    def _recorded_views(self) -> tuple[View, ...] | None:
        recorded: list[tuple[View, ...]] = []
        for source in self._sources:
            views = source.recorded_views()
            if views is None:
                return None
            recorded.append(views)
        common = set.intersection(*map(set, recorded))
        return tuple(view for view in recorded[0] if view in common)

    @property
    def _source(self) -> Source:  # type: ignore[override]
        """The replica that says what all know, such as the boxes of objects."""
        return (self._working or self._sources)[0]

    def _pool_of(self, change: Callable[[Source], Source]) -> SourcePool:
        """Return a pool of every working replica, changed."""
        self._check_working()
        with ExitStack() as opened:
            replicas = [opened.enter_context(change(replica)) for replica in self._working]
            pool = SourcePool(replicas, self._exposure)
            opened.pop_all()
            return pool

    def _check_working(self) -> None:
        if self._closed or not self._working:
            raise closed_error("pool") if self._closed else self._last_fault


def _same_in_all(values: Sequence[T]) -> T:
    """Return the value of all sources; ArgumentError if one differs."""
    first, *others = values
    for number, value in enumerate(others, start=2):
        for field in fields(first):
            first_part = getattr(first, field.name)
            part = getattr(value, field.name)
            if first_part != part:
                fault = f"source {number} differs from source 1 in {field.name}"
                both = f"{_excerpt(part, first_part)} against {_excerpt(first_part, part)}"
                raise ArgumentError(f"sources: expected replicas of one scene, but {fault}: {both}")
    return first


def _excerpt(value: Any, other: Any) -> str:
    """Return a value in a few words; for a table, the first entry that is not in another table."""
    if not isinstance(value, dict):
        return shown(value)
    differences = sorted(set(value.items()) - set(other.items()))
    if not differences:
        return "nothing more"
    name, entry = differences[0]
    return f"{shown(name)}: {shown(entry)}"
