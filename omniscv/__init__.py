"""omniscv: omnidirectional images with exact ground truth, from perspective captures of virtual worlds."""

from __future__ import annotations

from omniscv import cameras
from omniscv.errors import OmniscvError
from omniscv.geometry import Pose

__all__ = ["OmniscvError", "Pose", "__version__", "cameras"]

__version__ = "0.1.0"
