"""The default strategy: capture finer until an image reaches the accuracy that the options ask for."""

from omniscv.planning import tuned
from omniscv.planning.one_center import OneCenter
from omniscv.planning.plan import Plan, Strategy
from omniscv.planning.refinement import Refinement
from omniscv.planning.rounds import Rounds
from omniscv.planning.several_centers import SeveralCenters, searches_given_centers
from omniscv.planning.strategies import Exact


class Auto(Strategy):
    """Capture finer until an image reaches the accuracy that the options ask for.

    Without one, cameras with many optical centres have a share of their own; of few, each is captured, as
    :class:`Exact` does. So have those for which the options give a number of centres.
    """

    name = "auto"
    own_centers = True

    def rounds(self, plan: Plan) -> Rounds:
        if plan.doubt_share is None:
            return Exact().rounds(plan)
        return _refinement(plan).counted()

    def doubt_share(self, plan: Plan) -> float | None:
        if plan.options.accuracy is not None or plan.rays.one_center:
            return plan.options.accuracy
        has_many_centers = plan.scattered or len(plan.rays.groups()) > tuned.FEW_CENTERS
        if has_many_centers or searches_given_centers(plan):
            return tuned.DEFAULT_DOUBT_SHARE
        return None

    def expected(self, plan: Plan) -> tuple[int, int]:
        if plan.doubt_share is None:
            return super().expected(plan)
        return _refinement(plan).expected()


def _refinement(plan: Plan) -> Refinement:
    """Return the way in which captures become finer: by the number of the image's optical centres."""
    return OneCenter(plan) if plan.rays.origins is None else SeveralCenters(plan)
