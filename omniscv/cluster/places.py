"""Where workers are: ``local:4``, ``slurm:FILE.yaml``, or the address of a scheduler."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, ClusterError

if TYPE_CHECKING:
    from distributed import Client

RESOURCE = {"server": 1}
"""What a worker has one of, and a task takes: so no worker makes two parts at a time."""

SETTINGS: dict[str, Any] = {
    # A worker that dies makes all tasks that wait for it suspects, not only the one that it worked on.
    "distributed.scheduler.allowed-failures": 20,
    "distributed.scheduler.worker-saturation": 1.0,
    # Near its limit a worker waits until it has spilled results: there are none.
    "distributed.worker.memory.pause": False,
    # A hundred samples a second of each worker, for a page of the dashboard.
    "distributed.worker.profile.enabled": False,
}
"""Of schedulers and workers that are started here; docs/scale.md has them for others."""

MOST_WORKERS = 10_000


def settings() -> dict[str, Any]:
    """Return those of ``SETTINGS`` that the user's files and environment for Dask leave open."""
    from dask import config

    given = config.collect()
    return {key: value for key, value in SETTINGS.items() if config.get(key, None, config=given) is None}


class Place(Protocol):
    """Where workers are."""

    def client(self, sources: Sequence[str]) -> AbstractContextManager[Client]:
        """Give a client of a scheduler whose workers have, or will have, a server each.

        Args:
            sources: addresses of the job's source; several are for one worker each.
        """


@dataclass(frozen=True)
class Address:
    """A scheduler that runs already, such as ``tcp://node7:8786``; it has workers of its own."""

    address: str
    timeout_s: float = 10.0

    @contextmanager
    def client(self, sources: Sequence[str]) -> Iterator[Client]:
        """Connect to it; ClusterError where that fails, or workers have no server."""
        from distributed import Client

        try:
            client = Client(self.address, timeout=self.timeout_s, set_as_default=False)
        except (OSError, ValueError) as cause:
            wanted = f"expected a scheduler of Dask at {self.address}"
            raise ClusterError(f"{wanted}, got: {cause}; start it with 'dask scheduler'") from cause
        with client:
            workers = client.scheduler_info(n_workers=-1)["workers"].values()
            if bare := [each["name"] for each in workers if not RESOURCE.keys() <= each["resources"].keys()]:
                wanted = "expected workers started with --resources 'server=1'"
                raise ClusterError(f"{self.address}: {wanted}, got {len(bare)} without, such as {bare[0]}")
            yield client


def place(text: str) -> Place:
    """Return the place that a text names: ``local:4``, ``slurm:FILE.yaml`` or a scheduler's address.

    Raises:
        ArgumentError: another text, or a package that is missing.
    """
    from omniscv.cluster.local import Local
    from omniscv.cluster.slurm import read

    _check_packages()
    kind, _, rest = text.partition(":")
    if kind == "local" and re.fullmatch(r"[1-9][0-9]{0,3}|", rest):
        return Local(int(rest) if rest else None)
    if kind == "slurm" and rest:
        return read(Path(rest))
    if re.fullmatch(r"(tcp|tls|ucx|ws|wss)://.+", text):
        return Address(text)
    wanted = "expected local, local:N, slurm:FILE.yaml or a scheduler such as tcp://host:8786"
    raise ArgumentError(f"--cluster: {wanted}, got {shown(text)}")


def _check_packages() -> None:
    try:
        import distributed  # noqa: F401
    except ImportError as cause:
        wanted = "expected the packages of clusters: pip install 'omniscv[cluster]'"
        raise ArgumentError(f"--cluster: {wanted}; got: {cause}") from cause
