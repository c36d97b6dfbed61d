"""What a worker holds: one open source, opened when it is first needed, and again after it has failed."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from distributed import WorkerPlugin

from omniscv.errors import ArgumentError, OmniscvError
from omniscv.sources.base import Source
from omniscv.sources.registry import SourceOptions, open_source

T = TypeVar("T")

SERVER = "omniscv-server"
TOPIC = "omniscv"
"""Of the events by which workers report failures that they try to mend."""

_LONGEST_WAIT_S = 60.0


class Server(WorkerPlugin):  # type: ignore[misc] # distributed is imported without its types
    """The server of a worker: a game that it launches, one at an address, or a mock server.

    It is opened by the first task, not when the worker starts: a game may take minutes, and a worker that
    does not answer meanwhile is taken for dead.

    Args:
        addresses: of the job's source; where there are several, a worker takes that of its number.
        options: of :func:`omniscv.open_source`.
    """

    name = SERVER

    def __init__(self, addresses: Sequence[str], options: SourceOptions) -> None:
        self._addresses, self._options = tuple(addresses), options

    def setup(self, worker: Any) -> None:
        """Start without a source."""
        self._worker = worker
        self._source: Source | None = None
        self._failed, self._ending = 0, False

    async def teardown(self, worker: Any) -> None:
        """Close the source, and with it what it launched."""
        self._ending = True
        await asyncio.to_thread(self._close)

    def use(self, work: Callable[[Source], T]) -> T:
        """Do some work with the source. After a failure it is opened anew, the next time.

        A server that fails again and again is given a longer time each, up to a minute: its worker would
        else fail tasks faster than others do them.

        Raises:
            Exception: as the work, or opening the source.
        """
        try:
            if self._source is None:
                self._source = open_source(self._address(), **self._options)
            done = work(self._source)
        except Exception as fault:
            with suppress(OmniscvError, OSError):  # of a server that is gone
                self._close()
            if not (self._ending or isinstance(fault, ArgumentError)):
                self._worker.log_event(TOPIC, f"worker {self._worker.name}: {fault}")
                time.sleep(min(_LONGEST_WAIT_S, 0.1 * (2**self._failed - 1)))
                self._failed += 1
            raise
        self._failed = 0
        return done

    def _address(self) -> str:
        """The worker's own address."""
        if len(self._addresses) == 1:
            return self._addresses[0]
        number = str(self._worker.name)
        if not number.isdecimal() or int(number) >= len(self._addresses):
            wanted = (
                f"expected workers named 0 to {len(self._addresses) - 1}, for the addresses of the source"
            )
            raise ArgumentError(f"--cluster: {wanted}, got {number!r}; start them with --name")
        return self._addresses[int(number)]

    def _close(self) -> None:
        source, self._source = self._source, None
        if source is not None:
            source.close()
