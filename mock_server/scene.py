"""Analytic scenes, traced exactly: the reference for composed images.

World frame: right-handed, metres, X forward, Y left, Z up. Lengths in the YAML are metres, angles degrees.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mock_server import scene_file, solids, textures, yaml_text
from mock_server.scene_file import Room
from mock_server.settings import SCENES, scene_names
from mock_server.solids import COLUMNS, RECTANGLE, SPHERE, nearest_hits
from mock_server.textures import Texture

Array = NDArray[np.float64]
Poses = Mapping[str, tuple[ArrayLike, ArrayLike]]
"""By object, ``R_w_o`` (3, 3) and the centre (3,) of its box, metres, world frame."""

LATEST_S = 1e9
"""The latest time of a scene, seconds, before which no motion overflows."""

_CHUNK = 1 << 13
_THREADS = 2
_SOME_DIRECTIONS = np.array([[1, 2, 3], [-3, 1, 2], [2, -3, -1], [-1, -2, 3]]) / np.sqrt(14)


class NotShownError(Exception):
    """Another renderer behind the server has no such picture; the server replies why."""


@dataclass(frozen=True, eq=False)
class Hits:
    """The first surfaces that rays hit.

    Attributes:
        label: (...) uint16, 1 + rank of the object's name in sorted order; 0 for the sky.
        distance: (...) float64, metres along the unit direction; +inf for the sky.
        normal: (..., 3) float64, unit, towards the ray's side of the surface; 0 for the sky.
        paint: computes ``color``.
    """

    label: NDArray[np.uint16]
    distance: Array
    normal: Array
    paint: Callable[[], Array] = field(repr=False)

    @cached_property
    def color(self) -> Array:
        """(..., 3) float64, 0..1; the sky's where nothing is hit. Computed when first used."""
        return self.paint()


@dataclass(frozen=True, eq=False)
class ViewHits(Hits):
    """A perspective view (H, W) in every mode.

    Attributes:
        depth: planar, float64, metres, +inf for the sky.
        mask: (H, W, 3) colours of object masks; None for those of the objects, by ``label``.
    """

    depth: Array
    mask: NDArray[np.uint8] | None = None

    @cached_property
    def codes(self) -> NDArray[np.uint8]:
        """(H, W, 3) uint8, ``round(255 c)`` of the colours; computed when first used."""
        return np.round(255 * np.clip(self.paint(), 0, 1)).astype(np.uint8)


class Scene:
    """Solids with names and textures, or a pattern on the sphere of directions.

    Picklable; safe in several threads and forked processes. Methods that take the name of an object raise
    ValueError if none has it.

    Args:
        name: the scene's name.
        description: of a scene's YAML file; docs/scenes.md explains the keys.

    Attributes:
        name: of the scene.
        objects: names of the objects, sorted.
        solids: (N, 20) float64, one row per solid; see ``solids.COLUMNS``.
        moving: names of the objects with a motion, sorted.
        static: names of the objects that commands cannot move: those of the room, and those with ``movable:
            false``.
        time: of the scene, seconds; 0 when loaded.
        room: the room; None without one, or if a wall of it has moved.

    Raises:
        ValueError: a wrong key or value of the description.
    """

    def __init__(self, name: str, description: Mapping[str, object]) -> None:
        file = scene_file.read(description, name)
        self.name = name
        self._sky = np.array(file.sky)
        self._pattern = file.pattern
        self._whole_room: Room | None = file.room
        self._moving = file.moving
        self.moving = tuple(sorted(file.moving))
        self.static = frozenset(file.static)
        self.time = 0.0
        self._describe(np.array(file.rows).reshape(-1, COLUMNS), file.names, file.textures)

    def _describe(self, rows: Array, owners: Sequence[str], textures: Sequence[Texture]) -> None:
        """Set the solids as described: the row, object and texture of each."""
        self._described = rows
        self.objects: tuple[str, ...] = tuple(sorted(set(owners)))
        labels = {name: label for label, name in enumerate(self.objects, start=1)}
        self._labels = np.array([0] + [labels[name] for name in owners], dtype=np.uint16)
        self._textures = list(dict.fromkeys(textures))
        indices = {texture: index for index, texture in enumerate(self._textures)}
        self._texture_of = np.array([indices[texture] for texture in textures] + [-1], dtype=np.int16)
        self._owner = np.array(owners, dtype=object)
        self._move({})

    def label(self, name: str) -> int:
        """Return an object's label: 1 + its rank in ``objects``."""
        return 1 + self.objects.index(name)

    def digest(self) -> str:
        """Return the SHA-256 of the description, hexadecimal; lengths are rounded to micrometres."""
        colors = self._sky if self._pattern is None else self._pattern(_SOME_DIRECTIONS)
        numbers = [_rounded(self._described), _rounded(colors)]
        visible = (self.objects, numbers, self._labels.tolist(), self._textures, self._texture_of.tolist())
        moving = repr(sorted(self._moving.items())) if self._moving else ""
        return hashlib.sha256((repr(visible) + moving).encode()).hexdigest()

    def bounds(self, name: str) -> tuple[Array, Array]:
        """Return the least and the greatest corner of an object's bounding box, (3,) metres, world frame."""
        return solids.extent(self._of(name, self.solids), np.eye(3))

    def box(self, name: str) -> tuple[Array, Array, Array]:
        """Return the smallest box around an object with the axes of its largest solid that is not a sphere.

        Returns:
            Its centre (3,), its axes as rows (3, 3), and its size along them (3,); metres, world frame.
        """
        rows = self._of(name, self.solids)
        turned = rows[rows[:, 0] != SPHERE]
        largest = turned[turned[:, 17].argmax()] if len(turned) else None
        axes = np.eye(3) if largest is None else largest[5:14].reshape(3, 3)
        if largest is not None and largest[0] == RECTANGLE:  # walls, floors: their z is the most upright
            up = int(np.abs(axes[:, 2]).argmax())
            axes = np.roll(axes, 2 - up, axis=0)
            axes = axes * np.array([[1.0], [1.0], [1.0]] if axes[2, 2] > 0 else [[1.0], [-1.0], [-1.0]])
        low, high = solids.extent(rows, axes)
        return (low + high) / 2 @ axes, axes, high - low

    def vertices(self, name: str) -> Array:
        """Return (N, 3) mesh points of an object, metres, world frame: those of ``solids.points``."""
        return solids.points(self._of(name, self.solids))

    def _of(self, name: str, rows: Array) -> Array:
        """Return an object's rows of solids."""
        if name not in self.objects:
            raise ValueError(f"object: expected one of {', '.join(self.objects)}; got {name!r}")
        return np.asarray(rows[self._owner == name])

    def pose(self, name: str) -> tuple[Array, Array]:
        """Return an object's pose: ``R_w_o`` (3, 3), the identity as described, and the centre (3,) of its
        box, which rotates with it; metres, world frame.
        """
        return self._poses.get(name) or (np.eye(3), self._center(name))

    def at(self, time_s: float, poses: Poses | None = None) -> Scene:
        """Return the scene at a time. Textures move with their objects.

        Args:
            time_s: seconds; of moving objects.
            poses: of objects that are moved, in place of their motions.

        Raises:
            ValueError: a time beyond ``LATEST_S``, or no object of a name.
        """
        if not abs(time_s) <= LATEST_S:
            raise ValueError(f"time: expected -{LATEST_S:g} to {LATEST_S:g} seconds, got {time_s!r}")
        if not (poses or self.moving or self._poses):
            return self
        result = copy.copy(self)
        result.time = time_s
        result._move(poses or {})
        return result

    def scaled(self, name: str, factors: ArrayLike) -> Scene:
        """Return another scene, with the object ``name`` scaled along the world's axes.

        It is scaled by three ``factors`` about the centre of its box; see :func:`mock_server.solids.scaled`.
        """
        result = copy.copy(self)
        rows = self._owner == name
        result._described = self._described.copy()
        result._described[rows] = solids.scaled(self._described[rows], np.array(factors), self._center(name))
        result._move({})
        return result

    def joined(self, name: str, description: Mapping[str, object]) -> Scene:
        """Return another scene with one more object, described as in a scene's file.

        Raises:
            ValueError: a wrong description, or a name that exists.
        """
        if name in self.objects:
            raise ValueError(f"object: expected a name that is not taken, got {name!r}")
        added = scene_file.read({"objects": {name: description}}, self.name)
        result = copy.copy(self)
        used = [self._textures[index] for index in self._texture_of[:-1]]
        result._moving = self._moving | added.moving
        result.moving = tuple(sorted(result._moving))
        rows = np.concatenate([self._described, added.rows])
        result._describe(rows, [*self._owner, *added.names], [*used, *added.textures])
        return result

    def _move(self, poses: Poses) -> None:
        """Move objects from their description to these poses, or to those of their motions at this time."""
        self.solids = self._described
        self.room = self._whole_room
        self._tree: solids.Tree | None = None  # made when rays are traced
        self._poses: dict[str, tuple[Array, Array]] = {}
        for name in self.moving:
            if name not in poses:
                function, axis = self._moving[name]
                offset, turn_deg = function.at(self.time)
                R = scene_file.turned(turn_deg)
                center = self._center(name)
                pivot = center if axis is None else np.array([*axis, 0.0])
                self._poses[name] = R, R @ (center - pivot) + pivot + offset
        for name, (R_w_o, target) in poses.items():
            self._poses[name] = np.array(R_w_o, dtype=np.float64), np.array(target, dtype=np.float64)
        if self._poses:
            self.solids = self._described.copy()
        for name, (R, center) in self._poses.items():
            rows = self._owner == name
            self.solids[rows] = solids.moved(self._described[rows], R, self._center(name), center)
        if self.room and self._poses.keys() & {*self.room.walls, self.room.floor, self.room.ceiling}:
            self.room = None

    def _center(self, name: str) -> Array:
        """Return the centre (3,) of an object's box as described."""
        return solids.center(self._of(name, self._described))

    def view(
        self,
        center: Array,
        rays: Array,
        length: Array,
        hidden: Iterable[str] = frozenset(),
        near_m: float = 0.0,
    ) -> ViewHits:
        """Return what a camera sees. Another renderer behind the server draws its pictures here.

        Args:
            center: (3,) the optical centre, metres, world frame.
            rays: (H, W, 3) unit directions, world frame: of :func:`mock_server.pixels.pinhole_rays`.
            length: (H, W) of the rays per metre of depth.
            hidden: names of objects to omit.
            near_m: the least planar depth at which surfaces are seen, metres.
        """
        skipped = near_m * length
        hits = self.trace(center + skipped[..., None] * rays if near_m else center, rays, hidden)
        distance = hits.distance + skipped
        return ViewHits(hits.label, distance, hits.normal, hits.paint, distance / length)

    def trace(self, origins: ArrayLike, directions: ArrayLike, hidden: Iterable[str] = frozenset()) -> Hits:
        """Return the first surfaces that rays hit, exact to float64 rounding.

        Args:
            origins: (..., 3) metres, world frame; broadcast against the directions.
            directions: (..., 3), of any length but zero; distances are along the unit direction. A ray with
                NaN hits nothing.
            hidden: names of objects to omit.

        Returns:
            Hits of shape (...). A ray that starts inside a solid hits its wall from inside.
        """
        o = np.asarray(origins, dtype=np.float64)
        d = np.asarray(directions, dtype=np.float64)
        shape = np.broadcast_shapes(o.shape, d.shape)
        o = _rows_of(o, shape)
        d = _rows_of(d, shape)
        shown = ~np.isin(self._owner, list(hidden))
        count = len(d)
        if self._tree is None:
            self._tree = solids.tree(self.solids)
        rows = self.solids
        tree = self._tree
        distance = np.full(count, np.inf)
        normal = np.zeros((count, 3))
        row = np.full(count, -1, np.int64)

        def chunk(part: slice) -> None:
            nearest_hits(o[part], d[part], rows, tree, shown, distance[part], row[part], normal[part])

        _by_chunks(chunk, count)
        outer = shape[:-1]
        paint = partial(self._paint, shape, o, d, distance, row, normal)
        labels = self._labels[row + 1].reshape(outer)
        return Hits(labels, distance.reshape(outer), normal.reshape(shape), paint)

    def _paint(self, shape: tuple[int, ...], *rays: NDArray[Any]) -> Array:
        """Return the colours of rays: origins, directions, distances, rows and normals."""
        color = np.empty((len(rays[0]), 3))

        def chunk(part: slice) -> None:
            color[part] = self._color(*(values[part] for values in rays))

        _by_chunks(chunk, len(color))
        return color.reshape(shape)

    def _color(self, o: Array, d: Array, distance: Array, row: NDArray[np.int64], normal: Array) -> Array:
        texture_of = self._texture_of[row]
        order = np.argsort(texture_of, kind="stable")  # -1 first: rays that hit nothing
        ends = np.cumsum(np.bincount(texture_of + 1, minlength=1))
        missed = order[: ends[0]]
        color = np.empty_like(d)
        o = np.ascontiguousarray(o)
        color[: ends[0]] = self._sky if self._pattern is None else self._pattern(d[missed])
        for index, (start, stop) in enumerate(pairwise(ends)):
            if start < stop:
                hits = order[start:stop]
                # take() copies rows in a fifth of the time of an index in brackets
                facing = normal.take(hits, axis=0)
                points = d.take(hits, axis=0)
                points *= distance[hits, None]
                points += o.take(hits, axis=0)
                points, normals = self._as_described(points, facing, row[hits])
                color[start:stop] = textures.paint(self._textures[index], points, normals, facing)
        inverse = np.empty_like(order)
        inverse[order] = np.arange(len(order))
        return color.take(inverse, axis=0)

    def _as_described(self, points: Array, normals: Array, row: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return points and normals (N, 3) before their objects were moved: textures move with objects."""
        if not self._poses:
            return points, normals
        turned = normals.copy()
        labels = self._labels[row + 1]
        for name, (R, center) in self._poses.items():
            hits = labels == self.label(name)
            points[hits] = (points[hits] - center) @ R + self._center(name)
            turned[hits] = normals[hits] @ R
        return points, turned


def _rows_of(vectors: Array, shape: tuple[int, ...]) -> Array:
    """Return vectors, broadcast to a shape (..., 3), as a copy (N, 3) in C order."""
    return np.array(np.broadcast_to(vectors, shape), order="C").reshape(-1, 3)


def _rounded(array: Array) -> Any:
    """Return an array as nested lists, rounded to 6 digits behind the point, without negative zeros."""
    return (np.round(array, 6) + 0.0).tolist()


def _by_chunks(work: Callable[[slice], None], count: int) -> None:
    """Call a function with chunks of a range, in several threads."""
    parts = [slice(start, start + _CHUNK) for start in range(0, count, _CHUNK)]
    if len(parts) < 2:
        for part in parts:
            work(part)
        return
    # New threads: a pool kept between calls would hang in a forked process.
    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(work, parts))


def load_scene(name_or_path: str | Path) -> Scene:
    """Return a scene by its name, or from a YAML file.

    Raises:
        ValueError: an unknown name, a file that cannot be read, or a wrong key or value in it.
    """
    path = _path(name_or_path)
    return _packaged(path) if path.parent == SCENES else _read(path)


def _read(path: Path) -> Scene:
    try:
        text = yaml_text.read_text(path, yaml_text.MOST_SCENE_BYTES)
        description = yaml_text.parse(text, yaml_text.MOST_SCENE_VALUES)
    except ValueError as cause:
        raise ValueError(f"scene: {path}: {cause}") from cause
    return Scene(path.stem, _located(description, path.parent))


def _located(value: Any, folder: Path) -> Any:
    """Return a description in which the files of pictures are relative to the current folder."""
    if isinstance(value, list):
        return [_located(item, folder) for item in value]
    if not isinstance(value, dict):
        return value
    located = {key: _located(item, folder) for key, item in value.items()}
    if value.get("kind") == "image" and isinstance(value.get("file"), str):
        located["file"] = str(folder / value["file"])
    return located


_packaged = cache(_read)  # files of this package do not change


def summary(name_or_path: str | Path) -> str:
    """Return the comment at the start of a scene's file, in one line; empty without one.

    Raises:
        ValueError: as :func:`load_scene`.
    """
    text = yaml_text.read_text(_path(name_or_path), yaml_text.MOST_SCENE_BYTES)
    lines = takewhile(lambda line: line.startswith("#"), text.splitlines())
    return " ".join(line.strip("# ") for line in lines)


def _path(name_or_path: str | Path) -> Path:
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return path
    if str(name_or_path) not in scene_names():
        known = ", ".join(scene_names())
        raise ValueError(f"scene: expected one of {known}, or a YAML file; got {str(name_or_path)!r}")
    return SCENES / f"{name_or_path}.yaml"
