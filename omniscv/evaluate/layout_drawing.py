"""A layout of corners alone, drawn: CFL's maps, and the curves of its edges."""

from __future__ import annotations

from typing import Any

import numpy as np

from omniscv.cameras import create
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.truth.cor_id import room_seen
from omniscv.truth.layout_maps import Map, exact_maps
from omniscv.truth.layout_record import project_layout


def maps_of(corners: Array, width: int) -> tuple[Map, Map]:
    """Return the maps of edges and of corners of a room in an upright panorama, as exact truth is drawn.

    Args:
        corners: (2N, 2) px; see :mod:`omniscv.truth.cor_id`.
        width: of the panorama, px.

    Raises:
        ArgumentError: corners of no room.
    """
    return exact_maps(_record(corners, width), create("equirectangular", width, width // 2))


def curves_of(corners: Array, width: int) -> list[Array]:
    """Return the pieces of a room's edges that no wall hides, (P, 2) px; arguments as :func:`maps_of`."""
    pieces = [piece for edge in _record(corners, width)["edges"] for piece in edge["pieces"]]
    return [np.array(piece["pixels"]) for piece in pieces if piece["visible_room"]]


def _record(corners: Array, width: int) -> dict[str, Any]:
    camera = create("equirectangular", width, width // 2)
    return project_layout(room_seen(corners, width, width // 2), camera, Pose.from_angles((0.0, 0.0, 0.0)))
