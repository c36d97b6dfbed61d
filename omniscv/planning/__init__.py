"""From a camera and a pose to the views that its image needs."""

from omniscv.planning.plans import Plan, rounds, share_captures
from omniscv.planning.ray_marching import KnownDepth
from omniscv.planning.rays import ImageRays, RayGroup
from omniscv.planning.strategies import (
    Auto,
    Cube,
    Exact,
    face_viewpoints,
)
from omniscv.planning.strategy import (
    Kept,
    Round,
    Rounds,
    Strategy,
    Task,
    Viewpoint,
    captured,
    captured_progress,
    drive,
    get,
    names,
    register,
)
from omniscv.render_options import FILTERS, Filter, RenderKeywords, RenderOptions

for _strategy in (Auto, Exact, Cube):
    register(_strategy)

__all__ = [
    "FILTERS",
    "Filter",
    "ImageRays",
    "Kept",
    "KnownDepth",
    "Plan",
    "RayGroup",
    "RenderKeywords",
    "RenderOptions",
    "Round",
    "Rounds",
    "Strategy",
    "Task",
    "Viewpoint",
    "captured",
    "captured_progress",
    "drive",
    "face_viewpoints",
    "get",
    "names",
    "register",
    "rounds",
    "share_captures",
]
