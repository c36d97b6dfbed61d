"""Run a job: render its images, capture what they need, count what that costs, or make its dataset."""

from omniscv.make.contents import check, check_dataset, check_worlds
from omniscv.make.dataset import Made, Part, chosen_keys, finish, make, parts_of, run_part
from omniscv.make.estimates import costs
from omniscv.make.instants import with_places
from omniscv.make.render import capture, run
from omniscv.make.source import opened, source_options

__all__ = [
    "Made", "Part", "capture", "check", "check_dataset", "check_worlds", "chosen_keys", "costs", "finish",
    "make", "opened", "parts_of", "run", "run_part", "source_options", "with_places"
]  # fmt: skip
