"""Workers on this machine, each a process of its own."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from omniscv.cluster.places import RESOURCE, settings
from omniscv.errors import ArgumentError

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class Local:
    """``workers`` processes on this machine; as many as the source has addresses if None.

    Dask starts a worker again that dies. The scheduler lives in this process.
    """

    workers: int | None = None

    @contextmanager
    def client(self, sources: Sequence[str]) -> Iterator[Client]:
        """Start them; they end with the context.

        Raises:
            ArgumentError: more workers than addresses, where there are several.
        """
        import dask
        from distributed import Client, LocalCluster

        workers = len(sources) if self.workers is None else self.workers
        if workers > len(sources) > 1:
            wanted = f"expected at most {len(sources)} workers, one for each address of the source"
            raise ArgumentError(f"--cluster: {wanted}, got {workers}")
        with (
            dask.config.set(settings()),
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                memory_limit=0,  # an equal share may be less than one of them needs
                silence_logs=logging.CRITICAL,
                resources=RESOURCE,
                preload=["omniscv.cluster.unstopped"],
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            yield client
