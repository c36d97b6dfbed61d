"""Where captures come from: live servers, recordings, scenes. Knows no camera model."""

from omniscv.sources.base import (
    Capabilities,
    Capture,
    Lens,
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    SourceWrapper,
    Traced,
    View,
)
from omniscv.sources.brackets import bracketed
from omniscv.sources.pictures import from_faces
from omniscv.sources.registry import open_source, register, schemes

__all__ = [
    "Capabilities", "Capture", "Lens", "ObjectTable", "Request", "SceneIdentity", "Source", "SourceWrapper",
    "Traced", "View", "bracketed", "from_faces", "open_source", "register", "schemes"
]  # fmt: skip
