"""omniscv: omnidirectional images with exact ground truth, from perspective captures of virtual worlds."""

from __future__ import annotations

from omniscv import cameras
from omniscv.captures import open_source, record
from omniscv.errors import OmniscvError
from omniscv.geometry import Pose
from omniscv.output.image import OmniImage
from omniscv.render import render

__all__ = ["OmniImage", "OmniscvError", "Pose", "__version__", "cameras", "open_source", "record", "render"]

__version__ = "0.1.0"
