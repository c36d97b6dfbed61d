"""Workers as jobs of SLURM, from a file.

::

    workers: 16                      # jobs that run at a time; each is one worker with one server
    walltime: "04:00:00"             # of each job; a worker leaves a while before, and another is queued
    cores: 4                         # of each job
    memory: 16 GB
    queue: gpu                       # optional, as all that follow
    account: vision
    directives: ["--gres=gpu:1"]     # further lines of the job's header
    prologue: [module load unreal]   # commands before the worker
    log_directory: logs
    interface: ib0                   # network that workers reach the scheduler by
    python: /path/to/python          # on the nodes; this one if not given
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING, Any

from omniscv.arguments import Reader, fields, shown, text, texts, whole_number, within
from omniscv.cluster.places import MOST_WORKERS, settings
from omniscv.errors import ArgumentError, ClusterError
from omniscv.storage import bounded

if TYPE_CHECKING:
    from dask_jobqueue import SLURMCluster
    from distributed import Client

_SHORTEST_MIN, _SLOWEST_S = 10, 60.0


@dataclass(frozen=True)
class Slurm:
    """Jobs of SLURM, each with one worker.

    Attributes:
        workers: jobs at a time.
        walltime_min: minutes that SLURM gives each.
        options: of ``dask_jobqueue.SLURMCluster``.
    """

    workers: int
    walltime_min: int
    options: dict[str, Any]

    def cluster(self) -> SLURMCluster:
        """Return the cluster, without jobs as yet: ``job_script()`` is what is submitted.

        A worker leaves when 17 twentieths of its time are over, give or take a twentieth, so that not all
        leave at once: the parts that it has are then made by others.

        Raises:
            ArgumentError: the package is missing.
        """
        try:
            from dask_jobqueue import SLURMCluster
        except ImportError as cause:
            wanted = "expected dask-jobqueue: pip install 'omniscv[cluster]'"
            raise ArgumentError(f"--cluster slurm: {wanted}; got: {cause}") from cause
        seconds = 60 * self.walltime_min
        life = ["--lifetime", f"{17 * seconds // 20}s", "--lifetime-stagger", f"{seconds // 20}s"]
        given = {key: value for key, value in settings().items() if key.startswith("distributed.worker.")}
        exports = [f"export DASK_{key.upper().replace('.', '__')}={value}" for key, value in given.items()]
        prologue = [*exports, *self.options.get("job_script_prologue", ())]
        return SLURMCluster(
            processes=1,
            worker_extra_args=["--resources", "server=1", *life],
            scheduler_options={"dashboard_address": ":0"},
            **(self.options | {"job_script_prologue": prologue}),
        )

    @contextmanager
    def client(self, sources: Sequence[str]) -> Iterator[Client]:
        """Submit the jobs; they are cancelled with the context. A job that ends is replaced.

        Raises:
            ArgumentError: several addresses: workers on nodes have no numbers to choose one by.
            ClusterError: SLURM takes no job.
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
    """Raise ClusterError where SLURM would not take a job: Dask submits in the background, without a word."""
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
        ArgumentError: it cannot be read, or a field is unknown, missing or wrong.
    """
    with within(path):
        given = fields("", bounded.parse_yaml(bounded.read_text(path)), _FIELDS, needed=_NEEDED)
    names = {"directives": "job_extra_directives", "prologue": "job_script_prologue"}
    workers, walltime = given.pop("workers"), given["walltime"]
    options = {names.get(key, key): list(v) if isinstance(v, tuple) else v for key, v in given.items()}
    return Slurm(workers, _minutes(walltime), options)


def _walltime(name: str, value: object) -> str:
    found = text(name, value)
    if not re.fullmatch(r"([0-9]+-)?[0-9]{1,3}:[0-9]{2}:[0-9]{2}", found) or _minutes(found) < _SHORTEST_MIN:
        wanted = f"expected hours:minutes:seconds, at least {_SHORTEST_MIN} minutes, such as '04:00:00'"
        raise ArgumentError(f"{name}: {wanted}, got {shown(value)}")
    return found


def _minutes(walltime: str) -> int:
    days, _, clock = walltime.rpartition("-")
    hours, minutes, _ = clock.split(":")
    return 60 * (24 * int(days or 0) + int(hours)) + int(minutes)


def _memory(name: str, value: object) -> str:
    if not re.fullmatch(r"[0-9]+(\.[0-9]+)? ?[KMGT]i?B", text(name, value)):
        raise ArgumentError(f"{name}: expected an amount such as 16 GB, got {shown(value)}")
    return str(value)


_FIELDS: dict[str, Reader] = {
    "workers": partial(whole_number, least=1, most=MOST_WORKERS),
    "walltime": _walltime,
    "cores": partial(whole_number, least=1, most=4096),
    "memory": _memory,
    "queue": text,
    "account": text,
    "directives": texts,
    "prologue": texts,
    "log_directory": text,
    "interface": text,
    "python": text,
}
_NEEDED = ("workers", "walltime", "cores", "memory")
