"""Ground truth of images and trajectories as records. Nothing here reads or writes files.

Public names are imported when they are first used.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omniscv.sensor.imu import measure as imu
    from omniscv.truth.layout_record import project_layout, room_of
    from omniscv.truth.object_boxes import boxes, boxes3d
    from omniscv.truth.optical_flow import Flow, flow, motion
    from omniscv.truth.point_cloud import Points, merged, points
    from omniscv.truth.room_layout import RoomLayout, layout
    from omniscv.truth.spherical import SphericalBox, fov_iou, spherical_iou
    from omniscv.truth.spherical_fit import bfov
    from omniscv.truth.visibility import amodal

_NAMES = {
    "layout_record": ("project_layout", "room_of"),
    "object_boxes": ("boxes", "boxes3d"),
    "optical_flow": ("Flow", "flow", "motion"),
    "point_cloud": ("Points", "merged", "points"),
    "room_layout": ("RoomLayout", "layout"),
    "spherical": ("SphericalBox", "fov_iou", "spherical_iou"),
    "spherical_fit": ("bfov",),
    "visibility": ("amodal",),
}
"""By module, the public names."""


def _homes() -> dict[str, str]:
    """Return by public name where it is, ``MODULE:NAME``."""
    homes = {"imu": "omniscv.sensor.imu:measure"}
    for module, names in _NAMES.items():
        for name in names:
            homes[name] = f"omniscv.truth.{module}:{name}"
    return homes


_HOMES = _homes()

__all__ = [
    "Flow", "Points", "RoomLayout", "SphericalBox", "amodal", "bfov", "boxes", "boxes3d", "flow", "fov_iou",
    "imu", "layout", "merged", "motion", "points", "project_layout", "room_of", "spherical_iou"
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'omniscv.truth' has no attribute {name!r}")
    globals()[name] = resolve_name(_HOMES[name])
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
