"""Several sources of one scene as one: captures are shared out, and so is what a lost source leaves."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass, field, fields
from itertools import islice
from typing import Any, TypeVar

from omniscv.captures.opening import open_source
from omniscv.captures.source import Capabilities, ObjectTable, Source
from omniscv.captures.view import Capture, Request
from omniscv.errors import ArgumentError, SourceError

T = TypeVar("T", Capabilities, ObjectTable)

_SHARE = 24
"""Captures handed out at once: what a live source has under way."""

_QUEUED = 2
"""Shares that a source has been given: it works on one while the captures of another are looked at."""

_AHEAD = 4
"""Shares a source that may be done, and wait for an earlier one, before no more are handed out."""

_log = logging.getLogger("omniscv")


@dataclass(eq=False)
class _Share:
    """Some requests in a row, and their captures as far as they are made.

    Attributes:
        done: all are made, and the source that made the last has ended well.
    """

    requests: list[Request]
    captures: list[Capture] = field(default_factory=list)
    done: bool = False

    def work(self, worker: _Worker) -> None:
        """Captures what is missing; what comes before a fault is kept."""
        if worker.lost is not None:
            raise worker.lost
        for capture in worker.source.capture(self.requests[len(self.captures) :]):
            self.captures.append(capture)


class _Worker:
    """A source with a thread of its own, in which all its captures are made."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.lost: SourceError | None = None
        self.shares: dict[Future[None], _Share] = {}
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="capture")

    def give(self, share: _Share) -> None:
        self.shares[self._thread.submit(share.work, self)] = share

    def stop(self) -> None:
        """Waits for the share in hand, drops the others."""
        for future in self.shares:
            future.cancel()
        wait(self.shares)
        self.shares.clear()

    def close(self) -> None:
        self._thread.shutdown(cancel_futures=True)
        self.source.close()


class SharedSource(Source):
    """Captures from several sources of the same scene, such as running copies of one game.

    A source that fails is not asked again: the others do its share, and a warning is logged.

    Args:
        sources: two or more; closed with this.

    Raises:
        ArgumentError: they differ in what they can do, or in their objects and mask colours, so that their
            captures do not belong in one image.
    """

    def __init__(self, sources: Sequence[Source]) -> None:
        self._capabilities = _the_same([source.capabilities for source in sources])
        self._objects = _the_same([source.objects() for source in sources])
        self._workers = [_Worker(source) for source in sources]

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def objects(self) -> ObjectTable:
        return self._objects

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; fails when the last source does, with its error."""
        coming = iter(requests)
        in_order: deque[_Share] = deque()
        left: deque[_Share] = deque()  # by sources that were lost
        try:
            while True:
                self._hand_out(coming, in_order, left)
                if not in_order:
                    return
                while in_order and in_order[0].done:
                    yield from in_order.popleft().captures
                if in_order:
                    self._look(left)
        finally:
            for worker in self._workers:
                worker.stop()

    def close(self) -> None:
        for worker in self._workers:
            worker.close()

    def _hand_out(self, coming: Iterator[Request], in_order: deque[_Share], left: deque[_Share]) -> None:
        """Gives every source enough to do, what lost sources left first."""
        working = [worker for worker in self._workers if worker.lost is None]
        for _ in range(_QUEUED):
            for worker in working:
                if len(worker.shares) >= _QUEUED:
                    continue
                if left:
                    worker.give(left.popleft())
                elif len(in_order) < _AHEAD * len(working) and (few := list(islice(coming, _SHARE))):
                    in_order.append(_Share(few))
                    worker.give(in_order[-1])

    def _look(self, left: deque[_Share]) -> None:
        """Waits until a source has finished a share, or is lost."""
        wait([future for worker in self._workers for future in worker.shares], return_when=FIRST_COMPLETED)
        for worker in self._workers:
            for future in [future for future in worker.shares if future.done()]:
                share = worker.shares.pop(future)
                try:
                    future.result()
                    share.done = True
                except SourceError as fault:
                    self._lose(worker, fault)
                    left.append(share)

    def _lose(self, worker: _Worker, fault: SourceError) -> None:
        if worker.lost is not None:
            return
        worker.lost = fault
        others = sum(each.lost is None for each in self._workers)
        if not others:
            raise fault
        _log.warning("lost a source, %d left to do its share: %s", others, fault)


def open_shared(uris: Sequence[str], **options: Any) -> Source:
    """Opens one source, or several that share the captures out.

    Args:
        uris: as for :func:`omniscv.open_source`; of the same scene.
        options: for each of them.

    Raises:
        ArgumentError, SourceError, RecordError: as :func:`omniscv.open_source`, for any of them;
            ArgumentError too where they differ, as :class:`SharedSource`.
    """
    with ExitStack() as opened:
        sources = [opened.enter_context(open_source(uri, **options)) for uri in uris]
        source = sources[0] if len(sources) == 1 else SharedSource(sources)
        opened.pop_all()
        return source


def _the_same(values: Sequence[T]) -> T:
    """What all sources agree on."""
    first = values[0]
    for number, value in enumerate(values[1:], start=2):
        for each in fields(first):
            a, b = getattr(first, each.name), getattr(value, each.name)
            if a != b:
                raise ArgumentError(
                    f"sources: expected copies of one game, but source {number} differs from source 1 in "
                    f"{each.name}: {_shortly(b, a)} against {_shortly(a, b)}"
                )
    return first


def _shortly(value: Any, other: Any) -> str:
    """A value; of a table, its first entry that another table does not have."""
    if isinstance(value, dict):
        apart = sorted(set(value.items()) - set(other.items()))
        return "nothing more" if not apart else "{}: {}".format(*apart[0])
    return repr(value)
