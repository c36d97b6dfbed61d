"""Datasets: images with all their truth, as files that other programs read."""

from omniscv.dataset.frames import Frame
from omniscv.dataset.registry import Format, get, names, register
from omniscv.dataset.truths import Observation, Truth

__all__ = ["Format", "Frame", "Observation", "Truth", "get", "names", "register"]
