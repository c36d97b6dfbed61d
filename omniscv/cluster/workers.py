"""Where workers are: processes on this machine, or those of a running scheduler."""

import logging
import re
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import Any

from omniscv.arguments import wrong
from omniscv.errors import ArgumentError, ClusterError

try:
    from dask import config
    from distributed import Client, LocalCluster
    from distributed.versions import get_versions
except ImportError as cause:
    wanted = "expected the packages of clusters: pip install 'omniscv[cluster]'"
    raise ArgumentError(f"--cluster: {wanted}; got: {cause}") from cause

RESOURCE = {"server": 1}
"""Dask resource: one unit per worker, one per task, so that each worker runs one task at a time."""

SETTINGS: dict[str, Any] = {
    # When a worker dies, its tasks come back, and are tried again in a way that finds what ended it.
    "distributed.scheduler.allowed-failures": 0,
    # Seconds after which a process that is frozen is taken for dead.
    "distributed.scheduler.worker-ttl": "60s",
    "distributed.scheduler.worker-saturation": 1.0,
    # Near its memory limit a worker pauses until it has spilled results: there are none.
    "distributed.worker.memory.pause": False,
    # A hundred samples a second of each worker, for a page of the dashboard.
    "distributed.worker.profile.enabled": False,
}
"""Of the schedulers and workers that are started here; docs/scale.md lists them for others."""

_ANSWER_S = 20.0
_LOGGERS = ("distributed", "tornado", "bokeh", "asyncio")


def settings() -> dict[str, Any]:
    """Return the ``SETTINGS`` that the user's files and environment for Dask leave open."""
    configured = config.collect()
    open_settings = {}
    for key, value in SETTINGS.items():
        if config.get(key, None, config=configured) is None:
            open_settings[key] = value
    return open_settings


def dask_setup(worker: object) -> None:
    """Ignore SIGINT in local workers, which preload this module: Ctrl-C reaches them too, and the command
    ends them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


Workers = Callable[[Sequence[str]], AbstractContextManager[Client]]
"""Gives a client of a scheduler whose workers have, or will have, one server each; the addresses of a job's
source, its argument, are each for one worker if there are several."""


def workers_of(place: str) -> Workers:
    """Return the workers that a word describes: ``local:4`` or a scheduler's address."""
    kind, _, count = place.partition(":")
    if kind == "local" and re.fullmatch(r"[1-9][0-9]{0,3}|", count):
        return partial(_local, int(count) if count else None)
    if re.fullmatch(r"(tcp|tls|ucx|ws|wss)://.+", place):
        return partial(scheduler_at, place)
    raise wrong("--cluster", "local, local:N or a scheduler such as tcp://host:8786", place)


@contextmanager
def _local(workers: int | None, sources: Sequence[str]) -> Iterator[Client]:
    """Start processes on this machine, as many as the source has addresses if None; they end with the
    context. Dask restarts a worker that dies. The scheduler runs in this process."""
    workers = workers or len(sources)
    if workers > len(sources) > 1:
        wanted = f"expected at most {len(sources)} workers, one for each address of the source"
        raise ArgumentError(f"--cluster: {wanted}, got {workers}")
    with (
        _quiet(),
        config.set(settings()),
        _start_cluster(workers) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


def _start_cluster(workers: int) -> LocalCluster:
    """Start a scheduler in this process, and processes of one thread each as its workers.

    Raises:
        ClusterError: a worker ended while it started.
    """
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
        wanted = f"--cluster: expected {workers} workers to start, but one ended, as when memory runs out"
        raise ClusterError(f"{wanted}: {str(cause).rstrip('.')}; run again, or with fewer") from cause


@contextmanager
def scheduler_at(address: str, sources: Sequence[str], timeout_s: float = 10.0) -> Iterator[Client]:
    """Connect to a running scheduler whose workers have a server each.

    Args:
        address: such as ``tcp://node7:8786``.
        sources: addresses of the job's source; not used, since workers choose theirs by their numbers.
        timeout_s: of connecting, seconds.

    Raises:
        ClusterError: no scheduler is there, or workers lack the resource ``server``.
    """
    with _quiet():
        try:
            client = Client(address, timeout=timeout_s, set_as_default=False)
        except (OSError, ValueError) as cause:
            wanted = f"expected a scheduler of Dask at {address}"
            raise ClusterError(f"{wanted}, got: {cause}; start it with 'dask scheduler'") from cause
        with client:
            names = []
            for worker in client.scheduler_info(n_workers=-1)["workers"].values():
                if not RESOURCE.keys() <= worker["resources"].keys():
                    names.append(worker["name"])
            if names:
                wanted = "expected workers started with --resources 'server=1'"
                raise ClusterError(f"{address}: {wanted}, got {len(names)} without, such as {names[0]}")
            yield client


def check_versions(client: Client) -> None:
    """Refuse workers that have another version of this package than the client, or none.

    Workers that join later compare it themselves. Those that do not answer are left to the run's patience.
    """
    message = {"op": "versions", "packages": ["omniscv"]}
    try:
        answers = client.sync(
            client.scheduler.broadcast, msg=message, on_error="ignore", callback_timeout=_ANSWER_S
        )
    except TimeoutError:
        return
    own = get_versions(packages=["omniscv"])["packages"]["omniscv"]
    workers = client.scheduler_info(n_workers=-1)["workers"]
    for address, answer in answers.items():
        version = answer["packages"].get("omniscv")
        if version != own:
            name = workers.get(address, {}).get("name", address)
            wanted = f"expected workers with omniscv {own}, as here"
            other = f"{version or 'none'} at worker {name}, {address}"
            advice = f"install it there: pip install 'omniscv[cluster]=={own}'"
            raise ClusterError(f"--cluster: {wanted}, got {other}; {advice}")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's own log lines and tracebacks off the terminal: what matters is said by this package."""
    known = [*_LOGGERS, *logging.root.manager.loggerDict]
    names = [name for name in known if name.partition(".")[0] in _LOGGERS]
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)
