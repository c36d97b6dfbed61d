"""A job as data: the images that a user wants, and the file that describes them."""

from omniscv.job.file import EXAMPLE, Key, address, keys, load, overridden, read
from omniscv.job.job import Exposure, FailureLimit, Job, within_path
from omniscv.job.recipe import Recipe, Split

__all__ = [
    "EXAMPLE", "Exposure", "FailureLimit", "Job", "Key", "Recipe", "Split", "address", "keys", "load",
    "overridden", "read", "within_path"
]  # fmt: skip
