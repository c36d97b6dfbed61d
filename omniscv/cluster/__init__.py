"""Datasets on many machines: the parts of a job as tasks of Dask, one server for each worker.

Dask schedules the tasks. A worker opens one server and makes parts with it. It writes into the dataset's
folder and returns only counts.
"""

from omniscv.errors import ArgumentError

try:
    import distributed as _distributed  # noqa: F401
except ImportError as cause:
    wanted = "expected the packages of clusters: pip install 'omniscv[cluster]'"
    raise ArgumentError(f"--cluster: {wanted}; got: {cause}") from cause

from omniscv.cluster.making import make
from omniscv.cluster.workers import workers_of

__all__ = ["make", "workers_of"]
