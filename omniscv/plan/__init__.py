"""From a camera and a pose to the views that its image needs: one file per strategy."""

from omniscv.plan.base import PROBE_MODES, Plan, Station
from omniscv.plan.make import STRATEGIES, make_plan

__all__ = ["PROBE_MODES", "STRATEGIES", "Plan", "Station", "make_plan"]
