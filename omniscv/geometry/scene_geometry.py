"""Shapes of a scene that a source knows beyond its pictures: boxes of objects, and the room."""

from collections.abc import Mapping
from typing import Any, Literal, Self, get_args

import numpy as np

from omniscv.arguments import number, numbers, one_of, text, texts, wrong
from omniscv.errors import ArgumentError
from omniscv.geometry.pose import Array, rotation_reader
from omniscv.records import checked, named, nested, optional, read, record

BoxSource = Literal["scene", "vertices", "bounds", "points"]

_SQUARE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
_CORNERS = 0.5 * np.array([*((x, y, -1.0) for x, y in _SQUARE), *((x, y, 1.0) for x, y in _SQUARE)])
BOX_EDGES = np.array([
    [0, 1], [4, 5], [0, 4],
    [1, 2], [5, 6], [1, 5],
    [2, 3], [6, 7], [2, 6],
    [3, 0], [7, 4], [3, 7],
])  # fmt: skip
"""(12, 2): the pairs of corners of :meth:`ObjectBox.corners_w` that are joined by an edge."""


def _size(name: str, value: Any) -> Array:
    """Return lengths (3,), none of them negative."""
    size = numbers(name, value, (3,))
    if (size < 0).any():
        raise wrong(name, "lengths of at least 0", size)
    return size


def _rotation(name: str, value: Any) -> Array:
    """Return a rotation (3, 3), an array as it is."""
    rotation = rotation_reader(name, value)
    return value if isinstance(value, np.ndarray) else rotation  # with its -0.0, which files hold


@record(eq=False)
class ObjectBox:
    """An oriented box around an object.

    Attributes:
        center_w: (3,) metres, world frame.
        R_w_b: (3, 3) from the box's frame to the world.
        size: (3,) metres along the box's axes.
        source: where it comes from: an analytic scene, an object's vertices, an engine's bounds along the
            world's axes, or points that were seen, which may cover only a part of the object.
    """

    center_w: Array = checked(numbers, shape=(3,), key="center")
    R_w_b: Array = checked(_rotation, key="rotation")
    size: Array = checked(_size)
    source: BoxSource = checked(one_of, words=get_args(BoxSource))

    @classmethod
    def of(cls, center_w: Array, axes_w: Array, size: Array, source: BoxSource) -> Self:
        """Return a box by the axes of an object's own frame.

        Args:
            center_w: (3,) metres, world frame.
            axes_w: (3, 3) x, y and z of the frame as unit rows; of a left-handed one, z is turned.
            size: (3,) metres along these axes.
            source: as of :class:`ObjectBox`.
        """
        own = axes_w * np.array([[1.0], [1.0], [1.0 if np.linalg.det(axes_w) > 0 else -1.0]])
        return cls(center_w, own.T, size, source)

    def corners_w(self) -> Array:
        """Return the corners, (8, 3) metres, world frame, in the order of Omni3D.

        In the box's frame: around the side of least z ((x, y) least; x greatest; both greatest; y greatest),
        then around the side of greatest z.
        """
        return self.center_w + (_CORNERS * self.size) @ self.R_w_b.T

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "center": self.center_w.tolist(),
            "rotation": self.R_w_b.tolist(),
            "size": self.size.tolist(),
            "source": self.source,
        }


@record(eq=False)
class Room:
    """A room with upright walls between a level floor and a level ceiling.

    Attributes:
        corners_w: (N, 2) metres, X and Y of the floor's corners, counterclockwise from above.
        floor_z: metres, world frame.
        ceiling_z: metres, world frame.
        walls: N names; wall i goes from corner i to corner i + 1.
        floor: its name.
        ceiling: its name.
    """

    corners_w: Array = checked(numbers, shape=(None, 2), key="corners")
    floor_z: float = checked(number)
    ceiling_z: float = checked(number)
    walls: tuple[str, ...] = checked(texts)
    floor: str = checked(text)
    ceiling: str = checked(text)

    def __post_init__(self) -> None:
        if not len(self.corners_w) == len(self.walls) >= 3:
            counts = f"{len(self.corners_w)} corners and {len(self.walls)} walls"
            raise ArgumentError(f"room: expected at least 3 corners and as many walls, got {counts}")

    @property
    def surfaces(self) -> tuple[str, ...]:
        """The names of the objects that the room is made of."""
        return (*self.walls, self.floor, self.ceiling)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "corners": self.corners_w.tolist(),
            "floor_z": self.floor_z,
            "ceiling_z": self.ceiling_z,
            "walls": list(self.walls),
            "floor": self.floor,
            "ceiling": self.ceiling,
        }


@record(eq=False)
class SceneGeometry:
    """The shapes that a source knows in its scene; empty if it knows none.

    Attributes:
        boxes: by object name.
        room: the room around the cameras.
    """

    boxes: Mapping[str, ObjectBox] = checked(named(nested(ObjectBox)), default_factory=dict)
    room: Room | None = checked(optional(nested(Room)), default=None)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, the boxes in the order of their names."""
        boxes = {name: self.boxes[name].to_dict() for name in sorted(self.boxes)}
        return {"boxes": boxes, "room": None if self.room is None else self.room.to_dict()}

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the shapes that :meth:`to_dict` described; ArgumentError for anything else."""
        return read(cls, data)

    def __bool__(self) -> bool:
        return bool(self.boxes) or self.room is not None
