"""From a camera and a pose to the views that its image needs."""

from omniscv.depth.hits import KnownDepth
from omniscv.planning.auto import Auto
from omniscv.planning.plan import Plan, Strategy, get, names, register
from omniscv.planning.rays import ImageRays, RayGroup
from omniscv.planning.rounds import Captures, Round, Rounds, Viewpoint, captured, captured_progress, drive
from omniscv.planning.sharing import share_captures
from omniscv.planning.strategies import Cube, Exact
from omniscv.planning.viewpoints import face_viewpoints
from omniscv.render_options import FILTERS, Filter, RenderKeywords, RenderOptions

for _strategy in (Auto, Exact, Cube):
    register(_strategy)

__all__ = [
    "FILTERS", "Captures", "Filter", "ImageRays", "KnownDepth", "Plan", "RayGroup", "RenderKeywords",
    "RenderOptions", "Round", "Rounds", "Strategy", "Viewpoint", "captured", "captured_progress", "drive",
    "face_viewpoints", "get", "names", "register", "share_captures"
]  # fmt: skip
