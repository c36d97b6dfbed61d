"""Datasets: images with all their truth, as files that other programs read."""

from omniscv.dataset.checking import check
from omniscv.dataset.exported import export
from omniscv.dataset.exporting import Format, get, names, register
from omniscv.dataset.manifest import open
from omniscv.dataset.stepping import episodes
from omniscv.dataset.writer import Writer
from omniscv.frame import Frame
from omniscv.truth import registry as truths
from omniscv.truth.registry import Truth
from omniscv.truth.registry import register as register_truth

__all__ = [
    "Format", "Frame", "Truth", "Writer", "check", "episodes", "export", "get", "names", "open", "register",
    "register_truth", "truths"
]  # fmt: skip
