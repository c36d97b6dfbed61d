"""From a camera and a pose to the views that its image needs."""

from omniscv.planning.base import (
    FILTERS,
    Filter,
    FoundDepth,
    Kept,
    RenderKeywords,
    RenderOptions,
    Round,
    Rounds,
    Strategy,
    Task,
    Viewpoint,
    captured,
    captured_progress,
    drive,
    sampled,
)
from omniscv.planning.exact import cheapest_viewpoints, face_viewpoints, strip_viewpoints
from omniscv.planning.recorded_faces import RecordedViews
from omniscv.planning.registry import get, names, register, rounds
from omniscv.planning.sharing import together
from omniscv.planning.stillness import proven
from omniscv.planning.viewpoints import CameraRays, RayGroup

__all__ = [
    "FILTERS",
    "CameraRays",
    "Filter",
    "FoundDepth",
    "Kept",
    "RayGroup",
    "RecordedViews",
    "RenderKeywords",
    "RenderOptions",
    "Round",
    "Rounds",
    "Strategy",
    "Task",
    "Viewpoint",
    "captured",
    "captured_progress",
    "cheapest_viewpoints",
    "drive",
    "face_viewpoints",
    "get",
    "names",
    "proven",
    "register",
    "rounds",
    "sampled",
    "strip_viewpoints",
    "together",
]
