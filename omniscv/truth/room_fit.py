"""A room fitted to images: upright walls between a level floor and a level ceiling."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.compose.image import OmniImage
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.truth.classes import ClassTable

LARGEST_RESIDUAL_M = 0.02
WIDEST_GAP_M = 1.0
"""Between the ends of what is seen of two walls and the corner where they meet."""

_PREFIX = "layout"
_CLASSES = ("wall", "floor", "ceiling")
_UPRIGHT, _LEVEL = np.sin(np.radians(6.0)), np.cos(np.radians(6.0))  # of a normal's vertical part
_MOST_POINTS = 40_000  # of an image: more do not make a plane better known
_LEAST_POINTS = 12  # of a wall
_INLIER_M = 0.03
_TURN_DEG = 3.0  # normals of one wall differ by less
_SPLIT_M = 0.3  # of one plane, parts that are so far apart may be two walls


class Pictured(Protocol):
    """What a room is fitted to, such as a frame of a dataset.

    Attributes:
        camera, pose: of the picture.
        files: what layers it has.
        instances: object name to what the layer ``labels`` holds.
    """

    @property
    def camera(self) -> Camera: ...
    @property
    def pose(self) -> Pose: ...
    @property
    def files(self) -> Mapping[str, Any]: ...
    @property
    def instances(self) -> Mapping[str, int]: ...

    def layer(self, name: str) -> NDArray[Any]: ...


@dataclass(frozen=True, eq=False)
class Picture:
    """An image in memory, and what its labels stand for; see :class:`Pictured`."""

    camera: Camera
    pose: Pose
    files: Mapping[str, NDArray[Any]]
    instances: Mapping[str, int]

    @classmethod
    def of(cls, image: OmniImage) -> Self:
        """Return an image with the labels that rendering gave it."""
        names = [] if image.objects is None else image.objects.names()
        return cls(image.camera, image.pose, image.layers, {name: i for i, name in enumerate(names, 1)})

    def layer(self, name: str) -> NDArray[Any]:
        """Return a layer; ArgumentError without it."""
        if name not in self.files:
            wanted = "an image with depth, normals and labels to fit a room to"
            have = ", ".join(self.files)
            raise ArgumentError(f"layout: expected {wanted}, it has {have}; render with {name}, too")
        return self.files[name]


class _Surfaces(NamedTuple):
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


def fit_room(images: Sequence[Pictured | OmniImage], classes: ClassTable | None = None) -> tuple[Room, float]:
    """Return the room that images show together, and the rms distance of its points to it, metres.

    Floor and ceiling are at the median height of what is level; walls are lines through what is upright, by
    object and by direction; neighbours are those whose ends meet, and are intersected.

    Args:
        images: with depth, normals and labels; of one room, every wall of which at least one shows.
        classes: which objects are ``wall``, ``floor`` or ``ceiling``; those named ``Layout*`` if not given.

    Raises:
        ArgumentError: no floor, ceiling or wall is seen, the walls do not close, or the residual is larger
            than 2 cm: the room is no such prism.
    """
    pictures = [Picture.of(image) if isinstance(image, OmniImage) else image for image in images]
    seen = [_surfaces(picture, classes) for picture in pictures]
    surfaces = _Surfaces(*(np.concatenate(parts) for parts in zip(*seen, strict=True))) if seen else None
    if surfaces is None or not len(surfaces.names):
        wanted = "images that show objects named Layout*, or of the classes wall, floor and ceiling"
        raise ArgumentError(f"layout: expected {wanted}; got none")
    up = surfaces.normals_w[:, 2]
    floor_z, floor = _level(surfaces, up > _LEVEL, "floor")
    ceiling_z, ceiling = _level(surfaces, up < -_LEVEL, "ceiling")
    walls = _ring(_walls(surfaces, np.abs(up) < _UPRIGHT))
    corners = np.array([_meeting(walls[i - 1], walls[i]) for i in range(len(walls))])
    room = Room(corners, floor_z, ceiling_z, tuple(wall.name for wall in walls), floor, ceiling)
    residual_m = _residual(surfaces, room)
    if residual_m > LARGEST_RESIDUAL_M:
        wanted = f"upright walls between a level floor and a level ceiling within {LARGEST_RESIDUAL_M} m"
        raise ArgumentError(f"layout: expected {wanted}, got points that are {residual_m:.3f} m off (rms)")
    return room, residual_m


def _surfaces(image: Pictured, classes: ClassTable | None) -> _Surfaces:
    """What an image shows of the objects that make the room."""
    depth, labels, normals = (image.layer(name) for name in ("depth", "labels", "normals"))
    wanted = {label: name for name, label in image.instances.items() if is_room(name, classes)}
    rays = image.camera.unproject()
    use = rays.valid & np.isin(labels, list(wanted)) & np.isfinite(depth) & (depth > 0)
    use &= np.abs(np.linalg.norm(normals, axis=-1) - 1) < 1e-2
    if "label_edge" in image.files:
        use &= ~image.layer("label_edge")
    chosen = np.flatnonzero(use)
    chosen = chosen[:: max(1, -(-len(chosen) // _MOST_POINTS))]
    offsets = rays.directions.reshape(-1, 3)[chosen] * depth.reshape(-1)[chosen, None].astype(np.float64)
    points_w = image.pose.to_world(rays.origins.reshape(-1, 3)[chosen] + offsets)
    normals_w = normals.reshape(-1, 3)[chosen].astype(np.float64) @ image.pose.R_w_c.T
    names = np.array([wanted[label] for label in labels.reshape(-1)[chosen].tolist()], dtype=np.str_)
    return _Surfaces(points_w, normals_w, names)


def is_room(name: str, classes: ClassTable | None = None) -> bool:
    """Return whether an object makes the room: by its class, or by its name."""
    of_class = None if classes is None else classes.of(name)
    if of_class is not None and of_class.name.lower() in _CLASSES:
        return True
    return name.lower().startswith(_PREFIX)


def _level(surfaces: _Surfaces, use: NDArray[np.bool_], what: str) -> tuple[float, str]:
    if not use.any():
        raise ArgumentError(f"layout: expected images that show the {what}, got none that do")
    name, _ = Counter(surfaces.names[use].tolist()).most_common(1)[0]
    return float(np.median(surfaces.points_w[use, 2])), name


def _walls(surfaces: _Surfaces, use: NDArray[np.bool_]) -> list[_Wall]:
    """The walls that points show, by object, largest first."""
    least = max(_LEAST_POINTS, int(np.count_nonzero(use)) // 2000)
    found: list[_Wall] = []
    for name in np.unique(surfaces.names[use]).tolist():
        mine = use & (surfaces.names == name)
        points, normals = surfaces.points_w[mine, :2], surfaces.normals_w[mine, :2]
        while len(points) >= least:
            inliers = _largest_plane(points, normals)
            if np.count_nonzero(inliers) < least:
                break
            found += _parts_of_line(name, points[inliers], normals[inliers])
            points, normals = points[~inliers], normals[~inliers]
    return found


def _largest_plane(points: Array, normals: Array) -> NDArray[np.bool_]:
    """The points of the direction and then of the offset that most of them share, fitted once more."""
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
            break  # a short piece: its normals know its direction better
        normal = across * np.sign(across @ normal)
    return np.asarray(inliers)


def _parts_of_line(name: str, points: Array, normals: Array) -> list[_Wall]:
    """The line through points of one plane, cut where wide gaps show that it may be two walls."""
    center, inward = points.mean(axis=0), np.median(normals, axis=0)
    along = np.linalg.svd(np.cov((points - center).T))[2][0]
    if along @ [inward[1], -inward[0]] < 0:  # the room is on the left
        along = -along
    place = np.sort((points - center) @ along)
    bounds = np.flatnonzero(np.diff(place) > _SPLIT_M) + 1
    parts = [part for part in np.split(place, bounds) if len(part) > 1 and np.ptp(part) > 0]
    return [_Wall(name, center + part[0] * along, center + part[-1] * along) for part in parts]


def _meeting(wall: _Wall, following: _Wall) -> Array:
    """(2,) metres, where two walls meet; NaN of parallel ones."""
    a, b = wall.along, following.along
    turn = a[0] * b[1] - a[1] * b[0]
    if abs(turn) < np.sin(np.radians(_TURN_DEG)):
        return np.full(2, np.nan)
    offset = following.start - wall.end
    return np.asarray(wall.end + (offset[0] * b[1] - offset[1] * b[0]) / turn * a)


def _gap(wall: _Wall, following: _Wall) -> float:
    """Metres that are not seen between two walls, if one follows the other."""
    corner = _meeting(wall, following)
    if np.isfinite(corner).all():
        parts = corner - wall.end, corner - following.start
        return float(sum(np.linalg.norm(part) for part in parts))
    offset = following.start - wall.end
    aside = abs(offset[0] * wall.along[1] - offset[1] * wall.along[0])
    onward = aside <= 2 * _INLIER_M and following.along @ wall.along > 0 and offset @ wall.along > -_INLIER_M
    return float(np.linalg.norm(offset)) if onward else np.inf


def _ring(walls: list[_Wall]) -> list[_Wall]:
    """The walls counterclockwise from above, each followed by the one that it meets with the least gap."""
    from scipy.optimize import linear_sum_assignment

    largest = 1e6
    gaps = [[largest if a is b else min(_gap(a, b), largest) for b in walls] for a in walls]
    follower = linear_sum_assignment(np.array(gaps))[1].tolist() if len(walls) > 2 else []
    ring: list[int] = []
    at = 0
    while follower and len(ring) < len(walls):
        ring.append(at)
        at = follower[at]
        if at == 0:
            break
    widest = max((gaps[i][follower[i]] for i in ring), default=largest)
    if len(ring) < len(walls) or len(ring) < 3 or widest > 2 * WIDEST_GAP_M:
        names = ", ".join(sorted({wall.name for wall in walls})) or "none"
        wanted = "images that show every wall of one room, nearly from corner to corner"
        raise ArgumentError(f"layout: expected {wanted}; got walls that do not close: {names[:120]}")
    return _merged([walls[i] for i in ring])


def _merged(ring: list[_Wall]) -> list[_Wall]:
    """The ring with neighbours on one line made one wall, named as the longer part."""
    merged: list[_Wall] = []
    for wall in ring:
        if merged and np.isnan(_meeting(merged[-1], wall)).any():
            wall = _joined(merged.pop(), wall)
        merged.append(wall)
    if len(merged) > 1 and np.isnan(_meeting(merged[-1], merged[0])).any():
        merged[0] = _joined(merged.pop(), merged[0])
    return merged


def _joined(wall: _Wall, following: _Wall) -> _Wall:
    longer = max((wall, following), key=lambda each: float(np.linalg.norm(each.end - each.start)))
    return _Wall(longer.name, wall.start, following.end)


def _residual(surfaces: _Surfaces, room: Room) -> float:
    """Rms distance, metres, of all points to the nearest of the room's surfaces."""
    x = surfaces.points_w
    nearest = np.minimum(np.abs(x[:, 2] - room.floor_z), np.abs(x[:, 2] - room.ceiling_z))
    for start, end in zip(room.corners_w, np.roll(room.corners_w, -1, axis=0), strict=True):
        along = end - start
        share = np.clip((x[:, :2] - start) @ along / (along @ along), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(x[:, :2] - start - share[:, None] * along, axis=1))
    return float(np.sqrt(np.mean(nearest**2)))
