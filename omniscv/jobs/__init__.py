"""Jobs: the images that a user wants, as data, and what is done with them."""

from omniscv.jobs.dataset import make, run_part
from omniscv.jobs.file import EXAMPLE, load
from omniscv.jobs.finishing import finish
from omniscv.jobs.job import Job
from omniscv.jobs.parts import Part
from omniscv.jobs.running import capture, costs, run

__all__ = ["EXAMPLE", "Job", "Part", "capture", "costs", "finish", "load", "make", "run", "run_part"]
