"""Jobs: the images that a user wants, as data, and what is done with them."""

from omniscv.jobs.dataset import make
from omniscv.jobs.file import EXAMPLE, load
from omniscv.jobs.job import Job
from omniscv.jobs.running import capture, costs, run

__all__ = ["EXAMPLE", "Job", "capture", "costs", "load", "make", "run"]
