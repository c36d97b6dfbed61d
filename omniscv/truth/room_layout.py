"""The layout of a room, and how well it is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from omniscv.arguments import number, numbers, shown
from omniscv.compose.image import OmniImage
from omniscv.errors import ArgumentError
from omniscv.geometry.scene_geometry import Room, SceneGeometry
from omniscv.truth.classes import ClassTable
from omniscv.truth.room_fit import Pictured, fit_room


@dataclass(frozen=True, eq=False)
class RoomLayout:
    """A room, and how well it is known.

    Attributes:
        room: the walls, the floor, the ceiling.
        source: as the scene has it, or fitted to what images show.
        residual_m: rms distance of the points that it was fitted to, metres; 0 of a scene.

    Raises:
        ArgumentError: no ring of corners counterclockwise, or a ceiling not above the floor.
    """

    room: Room
    source: Literal["scene", "fitted"] = "scene"
    residual_m: float = 0.0

    def __post_init__(self) -> None:
        corners = numbers("room.corners_w", self.room.corners_w, (None, 2))
        steps = np.roll(corners, -1, axis=0) - corners
        area = float((corners[:, 0] * steps[:, 1] - corners[:, 1] * steps[:, 0]).sum()) / 2
        if len(corners) < 3 or not np.abs(steps).max(axis=1).all() or area <= 0:
            wanted = "at least 3 corners that differ, counterclockwise from above"
            raise ArgumentError(f"room: expected {wanted}; got {shown(corners)}")
        if len(self.room.walls) != len(corners):
            raise ArgumentError(f"room.walls: expected {len(corners)} names, got {len(self.room.walls)}")
        number("room.ceiling_z", self.room.ceiling_z, above=number("room.floor_z", self.room.floor_z))


def layout(
    scene_or_frames: SceneGeometry | Sequence[Pictured | OmniImage], classes: ClassTable | None = None
) -> RoomLayout:
    """Return the layout of a room, as a scene has it or fitted to images.

    Args:
        scene_or_frames: what a source knows of its shapes; or images, or frames of a dataset, of one room,
            with depth, normals and labels, which together show every wall.
        classes: which objects are ``wall``, ``floor`` or ``ceiling``; those named ``Layout*`` if not given.

    Raises:
        ArgumentError: a scene without a room, or images that a room of upright walls between level planes
            fits worse than 2 cm; see :func:`omniscv.truth.room_fit.fit_room`.
    """
    if not isinstance(scene_or_frames, SceneGeometry):
        room, residual_m = fit_room(scene_or_frames, classes)
        return RoomLayout(room, "fitted", residual_m)
    if scene_or_frames.room is None:
        wanted = "a scene whose room is known"
        raise ArgumentError(f"layout: expected {wanted}, got none; give images to fit a room to")
    return RoomLayout(scene_or_frames.room)
