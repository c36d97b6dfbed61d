"""Ground truth as records: pure functions from images and scenes; nothing here reads or writes files."""

from omniscv.truth.flow import Flow, flow
from omniscv.truth.points import Points, merged, points

__all__ = ["Flow", "Points", "flow", "merged", "points"]
