"""From a camera and a pose to the views that its image needs: one file per strategy."""

from omniscv.plan.base import Plan, Station
from omniscv.plan.make import STRATEGIES, make_plan

__all__ = ["STRATEGIES", "Plan", "Station", "make_plan"]
