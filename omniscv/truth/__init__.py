"""Ground truth as records: pure functions from images and scenes; nothing here reads or writes files."""

from omniscv.truth.boxes import boxes
from omniscv.truth.boxes3d import boxes3d
from omniscv.truth.spherical import SphericalBox, fov_iou, spherical_iou
from omniscv.truth.spherical_fit import bfov
from omniscv.truth.visibility import amodal

__all__ = ["SphericalBox", "amodal", "bfov", "boxes", "boxes3d", "fov_iou", "spherical_iou"]
