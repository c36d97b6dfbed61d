"""Run a job: render its images, capture what they need, count what that costs, or make its dataset."""

from omniscv.make.contents import check, check_dataset, check_worlds
from omniscv.make.dataset import Made, Part, finish, make, parts_of, run_part
from omniscv.make.render import capture, costs, measured_price, run
from omniscv.make.source import opened, source_options

__all__ = [
    "Made", "Part", "capture", "check", "check_dataset", "check_worlds", "costs", "finish", "make",
    "measured_price", "opened", "parts_of", "run", "run_part", "source_options"
]  # fmt: skip
