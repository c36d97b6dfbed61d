"""What is known of the shapes in a scene beyond its pictures: boxes of objects, and the room."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any, Literal, Self, get_args

import numpy as np

from omniscv.arguments import Reader, fields, number, numbers, one_of, shown, text, texts
from omniscv.errors import ArgumentError
from omniscv.geometry.pose import Array

BoxSource = Literal["scene", "vertices", "bounds", "points"]

_CORNERS = 0.5 * np.array(
    [(x, y, z) for z in (-1.0, 1.0) for x, y in ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))]
)
BOX_EDGES = np.array([e for i in range(4) for e in ((i, (i + 1) % 4), (4 + i, 4 + (i + 1) % 4), (i, 4 + i))])
"""(12, 2): which of the corners of :meth:`ObjectBox.corners_w` are joined."""

_ORDERS = tuple(itertools.permutations(range(3)))
_SIGNS = tuple(itertools.product((1.0, -1.0), repeat=3))
_ORTHONORMAL = 1e-6
_BOX: Mapping[str, Reader] = {
    "center": partial(numbers, shape=(3,)),
    "rotation": partial(numbers, shape=(3, 3)),
    "size": partial(numbers, shape=(3,)),
    "source": partial(one_of, words=get_args(BoxSource)),
}
_ROOM: Mapping[str, Reader] = {
    "corners": partial(numbers, shape=(None, 2)),
    "floor_z": number,
    "ceiling_z": number,
    "walls": texts,
    "floor": text,
    "ceiling": text,
}


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

    @classmethod
    def of(cls, center_w: Array, axes_w: Array, size: Array, source: BoxSource) -> Self:
        """Return a box of its axes, (3, 3) unit rows in any order and sense: its frame is the one of them
        that is turned the least from the world's."""
        turns = [np.array(signs)[:, None] * axes_w[list(order)] for order in _ORDERS for signs in _SIGNS]
        R_b_w = max((turn for turn in turns if np.linalg.det(turn) > 0), key=np.trace)
        return cls(center_w, R_b_w.T, np.abs(R_b_w @ axes_w.T) @ size, source)

    def corners_w(self) -> Array:
        """Return (8, 3) metres, world frame, in the order of Omni3D: around the side of least z of the box's
        frame (x, y least; x greatest; both; y), then around that of greatest z."""
        return self.center_w + (_CORNERS * self.size) @ self.R_w_b.T

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        numbers = {"center": self.center_w.tolist(), "rotation": self.R_w_b.tolist()}
        return {**numbers, "size": self.size.tolist(), "source": self.source}

    @classmethod
    def from_dict(cls, name: str, data: object) -> Self:
        """Return the inverse of :meth:`to_dict`; ArgumentError, which begins with ``name``, for all else."""
        found = fields(name, data, _BOX, needed=tuple(_BOX))
        if (found["size"] < 0).any():
            raise ArgumentError(f"{name}.size: expected lengths of at least 0, got {shown(found['size'])}")
        R_w_b = found["rotation"]
        if np.abs(R_w_b @ R_w_b.T - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(R_w_b) < 0:
            raise ArgumentError(f"{name}.rotation: expected a rotation matrix, got {shown(R_w_b)}")
        return cls(found["center"], R_w_b, found["size"], found["source"])


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

    @property
    def surfaces(self) -> tuple[str, ...]:
        """The names of the objects that the room is made of."""
        return (*self.walls, self.floor, self.ceiling)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        numbers = {"corners": self.corners_w.tolist(), "floor_z": self.floor_z, "ceiling_z": self.ceiling_z}
        return {**numbers, "walls": list(self.walls), "floor": self.floor, "ceiling": self.ceiling}

    @classmethod
    def from_dict(cls, name: str, data: object) -> Self:
        """Return the inverse of :meth:`to_dict`; ArgumentError, which begins with ``name``, for all else."""
        found = fields(name, data, _ROOM, needed=tuple(_ROOM))
        corners, walls = found["corners"], found["walls"]
        if not len(corners) == len(walls) >= 3:
            got = f"{len(corners)} corners and {len(walls)} walls"
            raise ArgumentError(f"{name}: expected as many walls as corners, at least 3; got {got}")
        return cls(corners, *(found[key] for key in list(_ROOM)[1:]))


@dataclass(frozen=True, eq=False)
class SceneGeometry:
    """What a source knows of the shapes in its scene; empty where it knows nothing.

    Attributes:
        boxes: by object name.
        room: the room around the cameras.
    """

    boxes: Mapping[str, ObjectBox] = field(default_factory=lambda: MappingProxyType({}))
    room: Room | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, the boxes in the order of their names."""
        boxes = {name: self.boxes[name].to_dict() for name in sorted(self.boxes)}
        return {"boxes": boxes, "room": self.room and self.room.to_dict()}

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the inverse of :meth:`to_dict`; ArgumentError for anything else."""
        found = fields("", data, {"boxes": _boxes, "room": _room}, needed=("boxes", "room"))
        return cls(MappingProxyType(found["boxes"]), found["room"])

    def __bool__(self) -> bool:
        return bool(self.boxes) or self.room is not None


def _boxes(name: str, value: object) -> dict[str, ObjectBox]:
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{name}: expected a mapping of object names to boxes, got {shown(value)}")
    return {
        text(name, key): ObjectBox.from_dict(f"{name}: {shown(key)}", each) for key, each in value.items()
    }


def _room(name: str, value: object) -> Room | None:
    return None if value is None else Room.from_dict(name, value)
