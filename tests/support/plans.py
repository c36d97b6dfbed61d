"""Plans made without captures: what a strategy yields when it is sent nothing."""

from omniscv.planning import ImageRays, RenderOptions, Task, drive, rounds
from omniscv.sources import Capabilities


def task_of(camera, pose, capabilities=None, *, border_px=None, cover=lambda view: (view,), **options):
    rays, chosen = ImageRays(camera), RenderOptions(**options)
    return Task(rays, pose, capabilities or Capabilities(), chosen, cover, border_px=border_px)


def viewpoints_of(task):
    """The viewpoints that serve pixels."""
    found = []
    drive(rounds(task), lambda round_: found.extend(v for v in round_.viewpoints if len(v.pixels)))
    return found


def views_of(task):
    """Every view of those viewpoints, in the order of capture."""
    return [view for viewpoint in viewpoints_of(task) for view in viewpoint.views]
