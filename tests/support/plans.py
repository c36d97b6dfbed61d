"""Plans made without captures: what a strategy yields when it is sent nothing."""

from omniscv.planning import ImageRays, Plan, RenderOptions, drive
from omniscv.sources import Capabilities


def plan_of(camera, pose, capabilities=None, *, border_px=None, cover=lambda view: (view,), **options):
    rays = ImageRays(camera)
    chosen = RenderOptions(**options)
    return Plan(rays, pose, capabilities or Capabilities(), chosen, cover, border_px=border_px)


def viewpoints_of(plan):
    found = []
    drive(plan.rounds(), lambda round_: found.extend(v for v in round_.viewpoints if len(v.pixels)))
    return found


def views_of(plan):
    """Every view of those viewpoints, in the order of capture."""
    return [view for viewpoint in viewpoints_of(plan) for view in viewpoint.views]
