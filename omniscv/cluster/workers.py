"""Where workers run: ``local:4``, or the address of a scheduler."""

from __future__ import annotations

import logging
import re
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from dask import config
from distributed import Client, LocalCluster

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, ClusterError

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


@dataclass(frozen=True)
class Local:
    """``workers`` processes on this machine; as many as the source has addresses if None.

    Dask restarts a worker that dies. The scheduler runs in this process.
    """

    workers: int | None = None

    @contextmanager
    def client(self, sources: Sequence[str]) -> Iterator[Client]:
        """Start them; they end with the context.

        Raises:
            ArgumentError: more workers than addresses, if there are several.
            ClusterError: one has ended while it started.
        """
        workers = len(sources) if self.workers is None else self.workers
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
        wanted = f"--cluster: expected {workers} workers to start, but one ended"
        why = str(cause).rstrip(".")
        raise ClusterError(f"{wanted}, as when memory runs out: {why}; run again, or with fewer") from cause


@dataclass(frozen=True)
class Address:
    """A running scheduler, such as ``tcp://node7:8786``, with its own workers."""

    address: str
    timeout_s: float = 10.0

    @contextmanager
    def client(self, sources: Sequence[str]) -> Iterator[Client]:
        """Connect to it; ClusterError if that fails, or workers have no server."""
        try:
            client = Client(self.address, timeout=self.timeout_s, set_as_default=False)
        except (OSError, ValueError) as cause:
            wanted = f"expected a scheduler of Dask at {self.address}"
            raise ClusterError(f"{wanted}, got: {cause}; start it with 'dask scheduler'") from cause
        with client:
            workers = client.scheduler_info(n_workers=-1)["workers"].values()
            names = [
                worker["name"] for worker in workers if not RESOURCE.keys() <= worker["resources"].keys()
            ]
            if names:
                wanted = "expected workers started with --resources 'server=1'"
                raise ClusterError(f"{self.address}: {wanted}, got {len(names)} without, such as {names[0]}")
            yield client


Workers = Local | Address
"""``client(sources)`` gives a client of a scheduler whose workers have, or will have, one server each; the
addresses of a job's source are each for one worker if there are several."""


def workers_of(place: str) -> Workers:
    """Return the workers that a word describes: ``local:4`` or a scheduler's address.

    Raises:
        ArgumentError: another word.
    """
    kind, _, rest = place.partition(":")
    if kind == "local" and re.fullmatch(r"[1-9][0-9]{0,3}|", rest):
        return Local(int(rest) if rest else None)
    if re.fullmatch(r"(tcp|tls|ucx|ws|wss)://.+", place):
        return Address(place)
    wanted = "expected local, local:N or a scheduler such as tcp://host:8786"
    raise ArgumentError(f"--cluster: {wanted}, got {shown(place)}")
