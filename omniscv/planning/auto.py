"""The planner: the fewest captures with which an image reaches an accuracy."""

from __future__ import annotations

from omniscv.planning import tuned
from omniscv.planning.plan import Plan, Strategy
from omniscv.planning.refinement import OneCenter, Refinement
from omniscv.planning.rounds import Rounds
from omniscv.planning.several_centers import SeveralCenters
from omniscv.planning.strategies import Exact


class Auto(Strategy):
    """Capture finer until an image reaches the accuracy that the options ask for.

    Without one, cameras with many optical centres have an aim of its own; of few, each is captured, as
    :class:`Exact` does.
    """

    name, own_centers = "auto", True

    def rounds(self, plan: Plan) -> Rounds:
        return Exact().rounds(plan) if plan.aim is None else _refinement(plan).counted()

    def aim(self, plan: Plan) -> float | None:
        if plan.options.accuracy is not None or plan.rays.one_center:
            return plan.options.accuracy
        return tuned.DEFAULT_AIM if plan.scattered or len(plan.rays.groups()) > tuned.FEW_CENTERS else None

    def expected(self, plan: Plan) -> tuple[int, int]:
        return super().expected(plan) if plan.aim is None else _refinement(plan).expected()


def _refinement(plan: Plan) -> Refinement:
    return OneCenter(plan) if plan.rays.origins is None else SeveralCenters(plan)
