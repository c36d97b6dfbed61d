"""What is known of the shapes in a scene beyond its pictures: boxes of objects, and the room."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

from omniscv.geometry.pose import Array

BoxSource = Literal["scene", "vertices", "bounds", "points"]


@dataclass(frozen=True, eq=False)
class ObjectBox:
    """An oriented box around an object.

    Attributes:
        center_w: (3,) metres, world frame.
        R_w_b: (3, 3) from the box's frame to the world.
        size: (3,) metres along the box's axes.
        source: where it comes from: an analytic scene, an object's vertices, an engine's bounds along the
            world's axes, or points that were seen, which may be a part of the object.
    """

    center_w: Array
    R_w_b: Array
    size: Array
    source: BoxSource


@dataclass(frozen=True, eq=False)
class Room:
    """A room with upright walls between a level floor and a level ceiling.

    Attributes:
        corners_w: (N, 2) metres, X and Y of the floor's corners, counterclockwise from above.
        floor_z, ceiling_z: metres, world frame.
        walls: N names, of the wall from corner i to corner i + 1.
        floor, ceiling: names.
    """

    corners_w: Array
    floor_z: float
    ceiling_z: float
    walls: tuple[str, ...]
    floor: str
    ceiling: str


@dataclass(frozen=True, eq=False)
class SceneGeometry:
    """What a source knows of the shapes in its scene; empty where it knows nothing.

    Attributes:
        boxes: by object name.
        room: the room around the cameras.
    """

    boxes: Mapping[str, ObjectBox] = field(default_factory=lambda: MappingProxyType({}))
    room: Room | None = None
