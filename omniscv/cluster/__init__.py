"""Datasets on many machines: the parts of a job as tasks of Dask, one server for each worker.

Nothing here schedules: Dask does. A worker holds one server, and makes parts with it; what it makes goes to
the dataset's folder, and only counts come back.
"""

from omniscv.cluster.making import make
from omniscv.cluster.places import place

__all__ = ["make", "place"]
