"""The layout of a room: as a scene has it, or fitted to images.

A room has upright walls between a level floor and a level ceiling.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number, numbers, wrong
from omniscv.cameras import Camera
from omniscv.compose.image import OmniImage
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.frame.classes import ClassTable
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room, SceneGeometry

LARGEST_RESIDUAL_M = 0.02
"""Largest rms distance of points to the fitted room."""
WIDEST_GAP_M = 1.0
"""Largest distance between the visible end of a wall and the corner where it meets the next one."""

_PREFIX = "layout"
_CLASSES = ("wall", "floor", "ceiling")
# of a normal's vertical part
_UPRIGHT = np.sin(np.radians(6.0))
_LEVEL = np.cos(np.radians(6.0))
_MOST_POINTS = 40_000  # of an image
_LEAST_POINTS = 12  # of a wall
_INLIER_M = 0.03
_TURN_DEG = 3.0  # normals of one wall differ by less
_SPLIT_M = 0.3  # a gap in the points of one plane that may separate two walls


@dataclass(frozen=True, eq=False)
class RoomLayout:
    """A room, and how well it is known.

    Attributes:
        room: the walls, the floor, the ceiling.
        source: the scene, or a fit to images.
        residual_m: rms distance of the points of the fit, metres; 0 of a scene.

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
            raise wrong("room", "at least 3 different corners, counterclockwise from above", corners)
        number("room.ceiling_z", self.room.ceiling_z, above=number("room.floor_z", self.room.floor_z))


def layout(
    scene_or_frames: SceneGeometry | Sequence[Frame | Picture | OmniImage], classes: ClassTable | None = None
) -> RoomLayout:
    """Return the layout of a room, as a scene has it or fitted to images.

    Args:
        scene_or_frames: the geometry of a source; or images, or frames of a dataset, of one room, with depth,
            normals and labels, which together show every wall.
        classes: which objects are ``wall``, ``floor`` or ``ceiling``; those named ``Layout*`` if not given.

    Raises:
        ArgumentError: a scene without a room, or images that a room of upright walls between level planes
            fits worse than 2 cm: no floor, ceiling or wall is visible, the walls do not close, or the room is
            no such prism.
    """
    if not isinstance(scene_or_frames, SceneGeometry):
        return _fit_room(scene_or_frames, classes)
    if scene_or_frames.room is None:
        raise ArgumentError("layout: expected a scene whose room is known, or images to fit one to; got none")
    return RoomLayout(scene_or_frames.room)


@dataclass(frozen=True, eq=False)
class Picture:
    """An image in memory, with the names of a :class:`Frame`.

    Attributes:
        camera: of the image.
        pose: of the camera, world frame.
        files: its layers by name.
        instances: object name to the id that ``labels`` holds.
    """

    camera: Camera
    pose: Pose
    files: Mapping[str, NDArray[Any]]
    instances: Mapping[str, int]

    @classmethod
    def of(cls, image: OmniImage) -> Self:
        """Return a rendered image with its own labels."""
        names = [] if image.objects is None else image.objects.names()
        instances = {name: label for label, name in enumerate(names, start=1)}
        return cls(image.camera, image.pose, image.layers, instances)

    def layer(self, name: str) -> NDArray[Any]:
        """Return a layer; ArgumentError without it."""
        if name not in self.files:
            wanted = "expected an image with depth, normals and labels to fit a room to"
            raise ArgumentError(f"layout: {wanted}, it has {', '.join(self.files)}; render with {name}, too")
        return self.files[name]


class _Surfaces(NamedTuple):
    """Points on surfaces of a room.

    Attributes:
        points_w: (N, 3) metres, world frame.
        normals_w: (N, 3) unit, world frame.
        names: (N,) of the objects that they lie on.
    """

    points_w: Array
    normals_w: Array
    names: NDArray[np.str_]


class _Wall(NamedTuple):
    """A wall in the ground plan: the room is on the left of the way from start to end."""

    name: str
    start: Array
    end: Array

    @property
    def along(self) -> Array:
        return np.asarray((self.end - self.start) / np.linalg.norm(self.end - self.start))


def _fit_room(images: Sequence[Frame | Picture | OmniImage], classes: ClassTable | None) -> RoomLayout:
    """Return the room that images show together.

    Floor and ceiling are at the median height of points with vertical normals. Walls are lines through points
    with horizontal normals, by object and direction; corners are the intersections of those whose ends meet.
    """
    parts = []
    for image in images:
        picture = Picture.of(image) if isinstance(image, OmniImage) else image
        parts.append(_surfaces(picture, classes))
    if not any(len(part.names) for part in parts):
        objects = "objects named Layout*, or of the classes wall, floor and ceiling"
        raise ArgumentError(f"layout: expected images that show {objects}; got none")
    surfaces = _Surfaces(
        points_w=np.concatenate([part.points_w for part in parts]),
        normals_w=np.concatenate([part.normals_w for part in parts]),
        names=np.concatenate([part.names for part in parts]),
    )
    up = surfaces.normals_w[:, 2]
    floor_z, floor = _level(surfaces, up > _LEVEL, "floor")
    ceiling_z, ceiling = _level(surfaces, up < -_LEVEL, "ceiling")
    walls = _ring(_walls(surfaces, np.abs(up) < _UPRIGHT))
    corners = []
    for index, wall in enumerate(walls):
        corners.append(_meeting(walls[index - 1], wall))
    names = tuple(wall.name for wall in walls)
    room = Room(np.array(corners), floor_z, ceiling_z, names, floor, ceiling)
    residual_m = _residual(surfaces, room)
    if residual_m > LARGEST_RESIDUAL_M:
        wanted = f"upright walls between a level floor and a level ceiling within {LARGEST_RESIDUAL_M} m"
        raise ArgumentError(f"layout: expected {wanted}, got points that are {residual_m:.3f} m off (rms)")
    return RoomLayout(room, "fitted", residual_m)


def _surfaces(image: Frame | Picture, classes: ClassTable | None) -> _Surfaces:
    """The points of an image on objects that are surfaces of the room."""
    depth = image.layer("depth")
    labels = image.layer("labels")
    normals = image.layer("normals")
    name_of = {}
    for name, label in image.instances.items():
        if is_room(name, classes):
            name_of[label] = name
    rays = image.camera.unproject()
    use = rays.valid & np.isin(labels, list(name_of)) & np.isfinite(depth) & (depth > 0)
    use &= np.abs(np.linalg.norm(normals, axis=-1) - 1) < 1e-2
    if "label_edge" in image.files:
        use &= ~image.layer("label_edge")
    indices = np.flatnonzero(use)
    indices = indices[:: max(1, -(-len(indices) // _MOST_POINTS))]
    offsets = rays.directions.reshape(-1, 3)[indices] * depth.reshape(-1)[indices, None].astype(np.float64)
    points_w = image.pose.to_world(rays.origins.reshape(-1, 3)[indices] + offsets)
    normals_w = normals.reshape(-1, 3)[indices].astype(np.float64) @ image.pose.R_w_c.T
    names = np.array([name_of[label] for label in labels.reshape(-1)[indices].tolist()], dtype=np.str_)
    return _Surfaces(points_w, normals_w, names)


def is_room(name: str, classes: ClassTable | None = None) -> bool:
    """Return whether an object is a surface of the room, by its class in ``classes`` or its ``name``."""
    of_class = None if classes is None else classes.of(name)
    is_surface = of_class is not None and of_class.name.lower() in _CLASSES
    return is_surface or name.lower().startswith(_PREFIX)


def _level(surfaces: _Surfaces, use: NDArray[np.bool_], what: str) -> tuple[float, str]:
    if not use.any():
        raise ArgumentError(f"layout: expected images that show the {what}, got none that do")
    name, _ = Counter(surfaces.names[use].tolist()).most_common(1)[0]
    return float(np.median(surfaces.points_w[use, 2])), name


def _walls(surfaces: _Surfaces, use: NDArray[np.bool_]) -> list[_Wall]:
    """The walls on which points lie, by object, the largest first."""
    least = max(_LEAST_POINTS, int(np.count_nonzero(use)) // 2000)
    walls: list[_Wall] = []
    for name in np.unique(surfaces.names[use]).tolist():
        of_object = use & (surfaces.names == name)
        points = surfaces.points_w[of_object, :2]
        normals = surfaces.normals_w[of_object, :2]
        while len(points) >= least:
            inliers = _largest_plane(points, normals)
            if np.count_nonzero(inliers) < least:
                break
            walls += _walls_on_line(name, points[inliers], normals[inliers])
            points = points[~inliers]
            normals = normals[~inliers]
    return walls


def _largest_plane(points: Array, normals: Array) -> NDArray[np.bool_]:
    """The points of the most frequent direction and offset, refined by fitting a line."""
    turn = np.degrees(np.arctan2(normals[:, 1], normals[:, 0]))
    most = np.bincount((np.round(turn / _TURN_DEG).astype(int)) % int(360 / _TURN_DEG)).argmax()
    alike = np.abs((turn - most * _TURN_DEG + 180) % 360 - 180) <= _TURN_DEG
    normal = np.median(normals[alike], axis=0)
    normal /= np.linalg.norm(normal)
    for _ in range(3):
        offset = points @ normal
        bins = np.round((offset[alike] - offset[alike].min()) / _INLIER_M).astype(int)
        middle = np.median(offset[alike][np.abs(bins - np.bincount(bins).argmax()) <= 1])
        inliers = alike & (np.abs(offset - middle) <= 2 * _INLIER_M)
        center = points[inliers].mean(axis=0)
        across = np.linalg.svd(np.cov((points[inliers] - center).T))[2][-1]
        if np.ptp((points[inliers] - center) @ [across[1], -across[0]]) < _INLIER_M:
            break  # too short: the normals give the direction better
        normal = across * np.sign(across @ normal)
    return np.asarray(inliers)


def _walls_on_line(name: str, points: Array, normals: Array) -> list[_Wall]:
    """The line through points of one plane, cut at wide gaps, where it may be two walls."""
    center = points.mean(axis=0)
    inward = np.median(normals, axis=0)
    along = np.linalg.svd(np.cov((points - center).T))[2][0]
    if along @ [inward[1], -inward[0]] < 0:  # the room is on the left
        along = -along
    offsets = np.sort((points - center) @ along)
    walls = []
    for piece in np.split(offsets, np.flatnonzero(np.diff(offsets) > _SPLIT_M) + 1):
        if len(piece) > 1 and np.ptp(piece) > 0:
            walls.append(_Wall(name, center + piece[0] * along, center + piece[-1] * along))
    return walls


def _meeting(wall: _Wall, following: _Wall) -> Array:
    """(2,) metres, the intersection of two walls; NaN of parallel ones."""
    a = wall.along
    b = following.along
    turn = a[0] * b[1] - a[1] * b[0]
    if abs(turn) < np.sin(np.radians(_TURN_DEG)):
        return np.full(2, np.nan)
    offset = following.start - wall.end
    return np.asarray(wall.end + (offset[0] * b[1] - offset[1] * b[0]) / turn * a)


def _gap(wall: _Wall, following: _Wall) -> float:
    """Metres between two walls that no point covers, if one follows the other; inf if it does not."""
    corner = _meeting(wall, following)
    if np.isfinite(corner).all():
        return float(np.linalg.norm(corner - wall.end) + np.linalg.norm(corner - following.start))
    offset = following.start - wall.end
    aside = abs(offset[0] * wall.along[1] - offset[1] * wall.along[0])
    onward = aside <= 2 * _INLIER_M and following.along @ wall.along > 0 and offset @ wall.along > -_INLIER_M
    return float(np.linalg.norm(offset)) if onward else np.inf


def _ring(walls: list[_Wall]) -> list[_Wall]:
    """Return the walls counterclockwise from above, each followed by another so that the sum of all gaps is
    least."""
    from scipy.optimize import linear_sum_assignment

    largest = 1e6  # metres: of walls that do not follow each other
    gaps = np.full((len(walls), len(walls)), largest)
    for index, wall in enumerate(walls):
        for other, following in enumerate(walls):
            if other != index:
                gaps[index, other] = min(_gap(wall, following), largest)
    follower = linear_sum_assignment(gaps)[1].tolist() if len(walls) > 2 else []
    ring = list[int]()
    widest = 0.0
    index = 0
    while follower and index not in ring:
        ring.append(index)
        widest = max(widest, gaps[index, follower[index]])
        index = follower[index]
    if len(ring) < len(walls) or len(ring) < 3 or widest > 2 * WIDEST_GAP_M:
        names = ", ".join(sorted({wall.name for wall in walls})) or "none"
        wanted = "expected images that show every wall of one room, nearly from corner to corner"
        raise ArgumentError(f"layout: {wanted}; got walls that do not close: {names[:120]}")
    return _merge_collinear([walls[index] for index in ring])


def _merge_collinear(ring: list[_Wall]) -> list[_Wall]:
    """The ring in which neighbours on one line are one wall, named as the longer one."""
    merged: list[_Wall] = []
    for wall in ring:
        if merged and np.isnan(_meeting(merged[-1], wall)).any():
            wall = _join(merged.pop(), wall)
        merged.append(wall)
    if len(merged) > 1 and np.isnan(_meeting(merged[-1], merged[0])).any():
        merged[0] = _join(merged.pop(), merged[0])
    return merged


def _join(wall: _Wall, following: _Wall) -> _Wall:
    longer = max((wall, following), key=lambda piece: float(np.linalg.norm(piece.end - piece.start)))
    return _Wall(longer.name, wall.start, following.end)


def _residual(surfaces: _Surfaces, room: Room) -> float:
    """Rms distance, metres, of points to the nearest surface of the room."""
    height = surfaces.points_w[:, 2]
    plan = surfaces.points_w[:, :2]
    nearest = np.minimum(np.abs(height - room.floor_z), np.abs(height - room.ceiling_z))
    for start, end in zip(room.corners_w, np.roll(room.corners_w, -1, axis=0), strict=True):
        along = end - start
        share = np.clip((plan - start) @ along / (along @ along), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(plan - start - share[:, None] * along, axis=1))
    return float(np.sqrt(np.mean(nearest**2)))
