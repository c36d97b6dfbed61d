"""Strategies that capture from each pixel's own optical centre, or from as many centres as the options give.

Where the options give fewer centres than the camera has, a live source with depth is searched from these
(:mod:`omniscv.planning.several_centers`). Whole cube maps, sources of colours alone, and recordings from
before the search was there show a pixel from the nearest of the centres
(:func:`omniscv.planning.viewpoints.face_viewpoints`).
"""

from omniscv.depth.depth_shell import DepthShell
from omniscv.errors import ArgumentError
from omniscv.planning import tuned
from omniscv.planning.plan import Plan, Strategy
from omniscv.planning.rays import Groups
from omniscv.planning.rounds import Round, Rounds, Viewpoint
from omniscv.planning.several_centers import SeveralCenters, searches_given_centers
from omniscv.planning.viewpoints import (
    capture_around,
    cheapest_viewpoints,
    edges_around,
    face_viewpoints,
    single_viewpoint,
)


class Exact(Strategy):
    """The fewest captured pixels with which every pixel is captured from its own optical centre.

    At one centre a single view if it holds all rays, else the faces of a cube map that they hit. At several
    centres views that are turned and narrowed to the rays of each; faces where the source cannot set size and
    field of view, or is a recording without those views. Given a number of centres, as :class:`Auto`.
    """

    name = "exact"
    own_centers = True

    def viewpoints(self, plan: Plan, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
        """Return the viewpoints of groups of pixels of a plan; ``around`` is the depth around the camera, if
        captured."""
        if len(groups) > 1:
            return cheapest_viewpoints(plan, groups, around)
        if groups and not plan.shared:
            viewpoint = single_viewpoint(plan, groups[0])
            if viewpoint is not None:
                return (viewpoint,)
        return face_viewpoints(plan, groups, around)

    def doubt_share(self, plan: Plan) -> float | None:
        super().doubt_share(plan)
        return tuned.DEFAULT_DOUBT_SHARE if searches_given_centers(plan) else None

    def rounds(self, plan: Plan) -> Rounds:
        """Yield the viewpoints, after the round in which occluded centres are found."""
        if plan.doubt_share is not None:
            return SeveralCenters(plan).counted()
        return self._each_from_its_center(plan)

    def _each_from_its_center(self, plan: Plan) -> Rounds:
        """Yield the viewpoints of pixels: each from its own centre, or from the nearest of those given."""
        if plan.scattered:
            wanted = "expected 'auto', of a source with depth, or a number of viewpoints"
            why = "for a camera whose every pixel has an optical centre of its own"
            raise ArgumentError(f"strategy: {wanted} {why}, got {self.name!r}")
        groups = plan.groups()
        around = yield from capture_around(plan, groups, edges_around(plan))
        yield Round(self.viewpoints(plan, groups, around))


class Cube(Exact):
    """Capture whole cube maps, as in the paper: one set serves every camera at the same centres."""

    name = "cube"
    own_centers = False

    def viewpoints(self, plan: Plan, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
        """Return those of a plan's groups of pixels; ``around`` is the depth around the camera."""
        return face_viewpoints(plan, groups, around, whole=True)

    def doubt_share(self, plan: Plan) -> float | None:
        return Strategy.doubt_share(self, plan)
