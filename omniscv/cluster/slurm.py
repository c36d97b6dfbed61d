"""Workers as jobs of SLURM, from a file.

::

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

import re
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING

from omniscv.arguments import shown, text, texts, whole_number, within
from omniscv.cluster.workers import MOST_WORKERS, settings
from omniscv.errors import ArgumentError, ClusterError
from omniscv.records import checked, record
from omniscv.records import read as read_record
from omniscv.storage import bounded

if TYPE_CHECKING:
    from dask_jobqueue import SLURMCluster
    from distributed import Client

_SHORTEST_MIN, _SLOWEST_S = 10, 60.0


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

    workers: int = checked(whole_number, most=MOST_WORKERS, help="jobs at a time")
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

    def cluster(self) -> SLURMCluster:
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
        of_workers = {
            key: value for key, value in settings().items() if key.startswith("distributed.worker.")
        }
        exports = [
            f"export DASK_{key.upper().replace('.', '__')}={value}" for key, value in of_workers.items()
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
        import dask
        from distributed import Client

        if len(sources) > 1:
            wanted = "expected one address, which every worker opens on its own node"
            raise ArgumentError(f"--cluster slurm: {wanted}, got a list of {len(sources)}")
        with (
            dask.config.set(settings()),
            self.cluster() as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            _check(cluster.job_script())
            cluster.adapt(minimum=self.workers, maximum=self.workers)
            yield client


def _check(script: str) -> None:
    """Raise ClusterError if SLURM would refuse a job: Dask submits in the background and reports nothing."""
    with NamedTemporaryFile("w", prefix="omniscv-", suffix=".sh") as file:
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


def read(path: Path) -> Slurm:
    """Return what a file describes.

    Raises:
        ArgumentError: it cannot be read, or a key is unknown, missing or wrong.
    """
    with within(path):
        return read_record(Slurm, bounded.parse_yaml(bounded.read_text(path)))
