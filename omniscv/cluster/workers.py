"""Where workers run: ``local:4``, ``slurm:FILE.yaml``, or the address of a scheduler.

The file of SLURM has the keys of :class:`Slurm`::

    workers: 16                      # jobs that run at a time; each is one worker with one server
    walltime: "04:00:00"             # of each job; its worker stops a while before, and another is queued
    cores: 4                         # of each job
    memory: 16 GB
    queue: gpu                       # optional, as all that follow
    account: vision
    directives: ["--gres=gpu:1"]     # further lines of the job's header
    prologue: [module load unreal]   # commands before the worker
    log_directory: logs
    interface: ib0                   # network on which workers reach the scheduler
    python: /path/to/python          # on the nodes; this one if not given
"""

from __future__ import annotations

import logging
import re
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from dask import config
from distributed import Client, LocalCluster

from omniscv.arguments import shown, text, texts, whole_number, within
from omniscv.errors import ArgumentError, ClusterError
from omniscv.records import checked, read, record
from omniscv.storage import bounded

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

_MOST_WORKERS = 10_000
_SHORTEST_MIN, _SLOWEST_S = 10, 60.0


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


def _minutes(walltime: str) -> int:
    days, _, clock = walltime.rpartition("-")
    hours, minutes, _ = clock.split(":")
    return 60 * (24 * int(days or 0) + int(hours)) + int(minutes)


def _walltime(name: str, value: object) -> str:
    walltime = text(name, value)
    pattern = r"([0-9]+-)?[0-9]{1,3}:[0-9]{2}:[0-9]{2}"
    if not re.fullmatch(pattern, walltime) or _minutes(walltime) < _SHORTEST_MIN:
        wanted = f"expected hours:minutes:seconds, at least {_SHORTEST_MIN} minutes, such as '04:00:00'"
        raise ArgumentError(f"{name}: {wanted}, got {shown(value)}")
    return walltime


def _memory(name: str, value: object) -> str:
    if not re.fullmatch(r"[0-9]+(\.[0-9]+)? ?[KMGT]i?B", text(name, value)):
        raise ArgumentError(f"{name}: expected an amount such as 16 GB, got {shown(value)}")
    return str(value)


@record
class Slurm:
    """Jobs of SLURM, each with one worker."""

    workers: int = checked(whole_number, most=_MOST_WORKERS, help="jobs at a time")
    walltime: str = checked(_walltime, help="time that SLURM gives each job")
    cores: int = checked(whole_number, most=4096)
    memory: str = checked(_memory)
    queue: str | None = checked(text, default=None)
    account: str | None = checked(text, default=None)
    directives: tuple[str, ...] = checked(texts, default=())
    prologue: tuple[str, ...] = checked(texts, default=())
    log_directory: str | None = checked(text, default=None)
    interface: str | None = checked(text, default=None)
    python: str | None = checked(text, default=None)

    def cluster(self) -> Any:
        """Return the cluster, without jobs as yet: ``job_script()`` is what is submitted.

        A worker stops after 17 twentieths of its time, give or take a twentieth, so that not all stop at
        once: other workers make its parts then.

        Raises:
            ArgumentError: the package is missing.
        """
        try:
            from dask_jobqueue import SLURMCluster
        except ImportError as cause:
            wanted = "expected dask-jobqueue: pip install 'omniscv[cluster]'"
            raise ArgumentError(f"--cluster slurm: {wanted}; got: {cause}") from cause
        seconds = 60 * _minutes(self.walltime)
        life = ["--lifetime", f"{17 * seconds // 20}s", "--lifetime-stagger", f"{seconds // 20}s"]
        exports = [
            f"export DASK_{key.upper().replace('.', '__')}={value}"
            for key, value in settings().items()
            if key.startswith("distributed.worker.")
        ]
        options = {
            "walltime": self.walltime,
            "cores": self.cores,
            "memory": self.memory,
            "queue": self.queue,
            "account": self.account,
            "job_extra_directives": list(self.directives) or None,
            "log_directory": self.log_directory,
            "interface": self.interface,
            "python": self.python,
        }
        return SLURMCluster(
            processes=1,
            worker_extra_args=["--resources", "server=1", *life],
            scheduler_options={"dashboard_address": ":0"},
            job_script_prologue=[*exports, *self.prologue],
            **{key: value for key, value in options.items() if value is not None},
        )

    @contextmanager
    def client(self, sources: Sequence[str]) -> Iterator[Client]:
        """Submit the jobs; they are cancelled with the context. A job that ends is replaced.

        Raises:
            ArgumentError: several addresses: workers on nodes have no numbers to choose one by.
            ClusterError: SLURM refuses the job.
        """
        if len(sources) > 1:
            wanted = "expected one address, which every worker opens on its own node"
            raise ArgumentError(f"--cluster slurm: {wanted}, got a list of {len(sources)}")
        with (
            config.set(settings()),
            self.cluster() as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            _check_job(cluster.job_script())
            cluster.adapt(minimum=self.workers, maximum=self.workers)
            yield client


def _check_job(script: str) -> None:
    """Raise ClusterError if SLURM would refuse a job: Dask submits in the background and reports nothing."""
    with NamedTemporaryFile("w", encoding="utf-8", prefix="omniscv-", suffix=".sh") as file:
        file.write(script)
        file.flush()
        try:
            command = ["sbatch", "--test-only", file.name]
            done = subprocess.run(command, capture_output=True, text=True, timeout=_SLOWEST_S, check=False)
            got = done.stderr.strip() if done.returncode else ""
        except (OSError, subprocess.TimeoutExpired) as cause:
            got = str(cause)
    if got:
        raise ClusterError(f"expected SLURM to take a job, got: {got}")


Workers = Local | Address | Slurm
"""``client(sources)`` gives a client of a scheduler whose workers have, or will have, one server each; the
addresses of a job's source are each for one worker if there are several."""


def workers_of(place: str) -> Workers:
    """Return the workers that a word describes: ``local:4``, ``slurm:FILE.yaml`` or a scheduler's address.

    Raises:
        ArgumentError: another word, or a file with unknown, missing or wrong keys.
    """
    kind, _, rest = place.partition(":")
    if kind == "local" and re.fullmatch(r"[1-9][0-9]{0,3}|", rest):
        return Local(int(rest) if rest else None)
    if kind == "slurm" and rest:
        with within(rest):
            return read(Slurm, bounded.parse_yaml(bounded.read_text(Path(rest))))
    if re.fullmatch(r"(tcp|tls|ucx|ws|wss)://.+", place):
        return Address(place)
    wanted = "expected local, local:N, slurm:FILE.yaml or a scheduler such as tcp://host:8786"
    raise ArgumentError(f"--cluster: {wanted}, got {shown(place)}")
