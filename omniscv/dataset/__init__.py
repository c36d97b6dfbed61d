"""Datasets: images with all their truth, as files that other programs read."""

from omniscv.dataset.checking import check
from omniscv.dataset.exporting import export
from omniscv.dataset.frames import Frame
from omniscv.dataset.reading import open
from omniscv.dataset.registry import Format, get, names, register
from omniscv.dataset.truths import Observation, Truth
from omniscv.dataset.truths import register as register_truth
from omniscv.dataset.writer import Writer

__all__ = [
    "Format",
    "Frame",
    "Observation",
    "Truth",
    "Writer",
    "check",
    "export",
    "get",
    "names",
    "open",
    "register",
    "register_truth",
]
