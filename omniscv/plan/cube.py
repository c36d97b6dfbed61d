"""Cube maps: six faces aligned with the world at every optical centre, or only those that rays hit."""

from __future__ import annotations

import numpy as np

from omniscv.captures.view import View
from omniscv.geometry import Array, Pose, cube_rotations


def cube_views(center_w: Array, face_size: int, border_px: int) -> tuple[View, ...]:
    """The six faces at a centre, each ``border_px`` wider than 90 degrees on every side.

    The focal length stays that of the 90 degree face. World-aligned, so that one set of captures
    serves every orientation of a camera at that place.
    """
    width = face_size + 2 * border_px
    fov_deg = 90.0 if border_px == 0 else float(np.degrees(2 * np.arctan(width / face_size)))
    return tuple(View(Pose(center_w, R_w_c), fov_deg, width, width) for _, R_w_c in cube_rotations())


def faces_hit(directions_w: Array) -> Array:
    """(6,) bool: the faces that rays hit, in the order of :func:`cube_views`."""
    seen = [(directions_w @ R_w_c).T for _, R_w_c in cube_rotations()]
    return np.array([(z * (1 + 1e-9) >= np.maximum(abs(x), abs(y))).any() for x, y, z in seen])
