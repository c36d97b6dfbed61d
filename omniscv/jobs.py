"""Jobs from Python: :mod:`omniscv.job`, a job as data, and :mod:`omniscv.make`, which runs it."""

from omniscv.job import EXAMPLE, Job, load
from omniscv.make import Part, capture, check, check_dataset, costs, finish, make, run, run_part

__all__ = [
    "EXAMPLE",
    "Job",
    "Part",
    "capture",
    "check",
    "check_dataset",
    "costs",
    "finish",
    "load",
    "make",
    "run",
    "run_part",
]
