"""omniscv: omnidirectional images with exact ground truth, from perspective captures of virtual worlds.

Public names are imported when they are first used, so that ``import omniscv`` is quick.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omniscv import cameras, dataset, truth
    from omniscv.cameras.rig import Rig, RigCamera
    from omniscv.compose.image import OmniImage
    from omniscv.compose.renderer import Renderer, render, render_rig
    from omniscv.errors import OmniscvError
    from omniscv.geometry import Pose
    from omniscv.geometry.instant import Instant, Motion, object_pose
    from omniscv.planning import RenderOptions
    from omniscv.sources.recording import record
    from omniscv.sources.registry import open_source

__version__ = "0.2.0"

_HOMES = {
    "Instant": "omniscv.geometry.instant:Instant",
    "Motion": "omniscv.geometry.instant:Motion",
    "OmniImage": "omniscv.compose.image:OmniImage",
    "OmniscvError": "omniscv.errors:OmniscvError",
    "Pose": "omniscv.geometry:Pose",
    "RenderOptions": "omniscv.planning:RenderOptions",
    "Renderer": "omniscv.compose.renderer:Renderer",
    "Rig": "omniscv.cameras.rig:Rig",
    "RigCamera": "omniscv.cameras.rig:RigCamera",
    "cameras": "omniscv.cameras:",
    "dataset": "omniscv.dataset:",
    "modalities": "omniscv.modalities:",
    "object_pose": "omniscv.geometry.instant:object_pose",
    "open_source": "omniscv.sources.registry:open_source",
    "planning": "omniscv.planning:",
    "record": "omniscv.sources.recording:record",
    "render": "omniscv.compose.renderer:render",
    "render_rig": "omniscv.compose.renderer:render_rig",
    "sources": "omniscv.sources:",
    "truth": "omniscv.truth:",
}

__all__ = [
    "Instant",
    "Motion",
    "OmniImage",
    "OmniscvError",
    "Pose",
    "RenderOptions",
    "Renderer",
    "Rig",
    "RigCamera",
    "__version__",
    "cameras",
    "dataset",
    "object_pose",
    "open_source",
    "record",
    "render",
    "render_rig",
    "truth",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'omniscv' has no attribute {name!r}")
    globals()[name] = resolve_name(_HOMES[name])
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
