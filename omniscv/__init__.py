"""omniscv: omnidirectional images with exact ground truth, from perspective captures of virtual worlds.

Public names are imported when they are first used, so that ``import omniscv`` is quick.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omniscv import cameras, dataset, score, truth
    from omniscv.cameras.rig import Rig, RigCamera
    from omniscv.compose.image import OmniImage
    from omniscv.compose.renderer import Renderer, render, render_rig
    from omniscv.errors import OmniscvError
    from omniscv.geometry import Pose
    from omniscv.geometry.instant import Instant, Motion, object_pose
    from omniscv.planning import RenderOptions
    from omniscv.reprojection import reproject
    from omniscv.sources.recording import record
    from omniscv.sources.registry import open_source

__version__ = "0.2.0"

_HOMES = {
    "": ("cameras", "dataset", "modalities", "planning", "score", "sources", "truth"),
    ".cameras.rig": ("Rig", "RigCamera"),
    ".compose.image": ("OmniImage",),
    ".compose.renderer": ("Renderer", "render", "render_rig"),
    ".errors": ("OmniscvError",),
    ".geometry": ("Pose",),
    ".geometry.instant": ("Instant", "Motion", "object_pose"),
    ".planning": ("RenderOptions",),
    ".reprojection": ("reproject",),
    ".sources.recording": ("record",),
    ".sources.registry": ("open_source",),
}
"""By module, the names that are imported from it when they are first used."""

__all__ = ["Instant", "Motion", "OmniImage", "OmniscvError", "Pose", "RenderOptions", "Renderer", "Rig",
           "RigCamera", "__version__", "cameras", "dataset", "object_pose", "open_source", "record", "render",
           "render_rig", "reproject", "score", "truth"]  # fmt: skip


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            globals()[name] = resolve_name(f"omniscv{module}:{name}" if module else f"omniscv.{name}:")
            return globals()[name]
    raise AttributeError(f"module 'omniscv' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *sum(_HOMES.values(), ())})
