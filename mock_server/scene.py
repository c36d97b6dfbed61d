"""Analytic scenes, traced exactly: the reference for composed images.

World frame: right-handed, metres, X forward, Y left, Z up. Lengths in the YAML are metres, angles degrees.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import pairwise, takewhile
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mock_server import motion, scene_file, solids, textures, yaml_text
from mock_server.kernel import COLUMNS, SPHERE, nearest_hits
from mock_server.scene_file import Room
from mock_server.settings import SCENES, scene_names
from mock_server.textures import Texture

Array = NDArray[np.float64]
Poses = Mapping[str, tuple[ArrayLike, ArrayLike]]
"""By object, ``R_w_o`` (3, 3) and the place (3,) of the middle of its box, metres, world frame."""

LATEST_S = 1e9
"""The greatest time of a scene, seconds: no motion overflows until then."""

_CHUNK = 1 << 13
_THREADS = 2
_SOME_DIRECTIONS = np.array([[1, 2, 3], [-3, 1, 2], [2, -3, -1], [-1, -2, 3]]) / np.sqrt(14)


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


class Scene:
    """Solids with names and textures, or a pattern painted on the sphere of directions.

    Picklable, and safe to use from several threads and in forked processes.

    Args:
        name: the scene's name.
        description: as in a scene's YAML file; docs/scenes.md explains the words.

    Attributes:
        name: as given.
        objects: names of the objects, sorted.
        solids: (N, 20) float64, one row per solid; see ``kernel.COLUMNS``.
        moving: names of the objects that move by themselves, sorted.
        time: the time that is shown, seconds; 0 as loaded.
        sky: (3,) float64, 0..1, the colour of rays that hit nothing; None where a pattern gives it.
        room: the room; None without one, or where a wall of it is elsewhere.

    Raises:
        ValueError: a word or value of the description is wrong; the message names it.
    """

    def __init__(self, name: str, description: Mapping[str, object]) -> None:
        parts = scene_file.read(description, name)
        self.name = name
        self._sky, self._pattern = np.array(parts.sky), parts.pattern
        self.sky = None if self._pattern else self._sky
        self._whole_room: Room | None = parts.room
        self._moving = parts.moving
        self.moving = tuple(sorted(parts.moving))
        self.time = 0.0
        self._take(np.array(parts.rows).reshape(-1, COLUMNS), parts.names, parts.textures)

    def _take(self, rows: Array, names: Sequence[str], each_texture: Sequence[Texture]) -> None:
        """Take solids, each of an object and a texture, as the description."""
        self._described = rows
        self.objects: tuple[str, ...] = tuple(sorted(set(names)))
        labels = {each: label for label, each in enumerate(self.objects, start=1)}
        self._labels = np.array([0] + [labels[each] for each in names], dtype=np.uint16)
        textures_used = {each: index for index, each in enumerate(dict.fromkeys(each_texture))}
        self._textures = list(textures_used)
        self._texture_of = np.array([textures_used[each] for each in each_texture] + [-1], dtype=np.int16)
        self._owner = np.array(names, dtype=object)
        self._place({})

    def label(self, name: str) -> int:
        """Return an object's label: 1 + its rank in ``objects``."""
        return 1 + self.objects.index(name)

    def digest(self) -> str:
        """Return a SHA-256 of the description, hexadecimal; lengths count to the micrometre."""
        colors = self._sky if self._pattern is None else self._pattern(_SOME_DIRECTIONS)
        numbers = [(np.round(each, 6) + 0.0).tolist() for each in (self._described, colors)]
        seen = (self.objects, numbers, self._labels.tolist(), self._textures, self._texture_of.tolist())
        moving = repr(sorted(self._moving.items())) if self._moving else ""
        return hashlib.sha256((repr(seen) + moving).encode()).hexdigest()

    def bounds(self, name: str) -> tuple[Array, Array]:
        """Return the least and the greatest corner of an object's box, (3,) metres each, world frame.

        Raises:
            ValueError: no object has that name.
        """
        return solids.extent(self._rows(name), np.eye(3))

    def box(self, name: str) -> tuple[Array, Array, Array]:
        """Return the smallest box around an object that is turned as its largest solid that is no sphere.

        Returns:
            Its centre (3,), its axes as rows (3, 3), and its size along them (3,); metres, world frame.

        Raises:
            ValueError: no object has that name.
        """
        rows = self._rows(name)
        turned = rows[rows[:, 0] != SPHERE]
        axes = turned[turned[:, 17].argmax(), 5:14].reshape(3, 3) if len(turned) else np.eye(3)
        low, high = solids.extent(rows, axes)
        return (low + high) / 2 @ axes, axes, high - low

    def vertices(self, name: str) -> Array:
        """Return (N, 3) points of an object, metres, world frame, as of a mesh: the corners of its boxes and
        rectangles, 64 on each rim of its cylinders, and on circles of its spheres.

        Raises:
            ValueError: no object has that name.
        """
        return solids.points(self._rows(name))

    def _rows(self, name: str) -> Array:
        rows: Array = self.solids[self._owner == name]
        if not len(rows):
            raise self._no_object(name)
        return rows

    def pose(self, name: str) -> tuple[Array, Array]:
        """Return where an object is: ``R_w_o`` (3, 3), the identity for an object as it is described, and the
        place (3,) of the middle of its box, which turns with it; metres, world frame.

        Raises:
            ValueError: no object has that name.
        """
        return self._poses.get(name) or (np.eye(3), self._middle(name))

    def at(self, time_s: float, poses: Poses | None = None) -> Scene:
        """Return the scene at a time. Textures move with their objects.

        Args:
            time_s: seconds; moving objects are where they are then, all others as described.
            poses: of objects that are elsewhere, moving ones too.

        Raises:
            ValueError: a time beyond ``LATEST_S``, or no object of a name.
        """
        if not abs(time_s) <= LATEST_S:
            raise ValueError(f"time: expected -{LATEST_S:g} to {LATEST_S:g} seconds, got {time_s!r}")
        if not (poses or self.moving or self._poses):
            return self
        result = copy.copy(self)
        result.time = time_s
        result._place(poses or {})
        return result

    def moved(self, moves: Mapping[str, tuple[Array, Array, Array]]) -> Scene:
        """Return another scene, in which some objects are described elsewhere; textures stay as described.

        Args:
            moves: by object, a rotation (3, 3), the point it turns about, and where that point goes
                (both (3,) metres, world frame).
        """
        result = copy.copy(self)
        result._described = self._described.copy()
        for name, how in moves.items():
            rows = self._owner == name
            result._described[rows] = solids.carried(self._described[rows], *how)
        if self._of_room(moves):
            result._whole_room = None
        result._place({})
        return result

    def scaled(self, name: str, factors: ArrayLike) -> Scene:
        """Return another scene, in which an object is larger along the world's axes, by three factors, about
        the middle of its box; :func:`mock_server.solids.scaled` explains what is round."""
        result, rows = copy.copy(self), self._owner == name
        result._described = self._described.copy()
        result._described[rows] = solids.scaled(self._described[rows], np.array(factors), self._middle(name))
        result._place({})
        return result

    def joined(self, name: str, description: Mapping[str, object]) -> Scene:
        """Return another scene with one more object, described as in a scene's file.

        Raises:
            ValueError: a wrong description, or a name that is taken.
        """
        if name in self.objects:
            raise ValueError(f"object: expected a name that is not taken, got {name!r}")
        added, result = scene_file.read({"objects": {name: description}}, self.name), copy.copy(self)
        used = [self._textures[index] for index in self._texture_of[:-1]]
        result._moving = self._moving | added.moving
        result.moving = tuple(sorted(result._moving))
        rows = np.concatenate([self._described, added.rows])
        result._take(rows, [*self._owner, *added.names], [*used, *added.textures])
        return result

    def _place(self, poses: Poses) -> None:
        """Move objects from where they are described to where they are at this time, or to given poses."""
        self.solids, self.room = self._described, self._whole_room
        self._poses: dict[str, tuple[Array, Array]] = {}
        for name in self.moving:
            if name not in poses:
                how, axis = self._moving[name]
                offset, turn_deg = how.at(self.time)
                R, middle = motion.turned(turn_deg), self._middle(name)
                pivot = middle if axis is None else np.array([*axis, 0.0])
                self._poses[name] = R, R @ (middle - pivot) + pivot + offset
        for name, (R_w_o, place) in poses.items():
            self._poses[name] = np.array(R_w_o, dtype=np.float64), np.array(place, dtype=np.float64)
        if self._poses:
            self.solids = self._described.copy()
        for name, (R, place) in self._poses.items():
            rows = self._owner == name
            self.solids[rows] = solids.carried(self._described[rows], R, self._middle(name), place)
        if self._of_room(self._poses):
            self.room = None

    def _of_room(self, names: Mapping[str, object]) -> bool:
        room = self._whole_room
        return room is not None and bool({*room.walls, room.floor, room.ceiling} & names.keys())

    def _middle(self, name: str) -> Array:
        """Return the middle (3,) of an object's box as described."""
        rows = self._described[self._owner == name]
        if not len(rows):
            raise self._no_object(name)
        return solids.middle(rows)

    def _no_object(self, name: str) -> ValueError:
        return ValueError(f"object: expected one of {', '.join(self.objects)}; got {name!r}")

    def trace(self, origins: ArrayLike, directions: ArrayLike, hidden: Iterable[str] = frozenset()) -> Hits:
        """Return the first surfaces that rays hit, exact to float64 rounding.

        Args:
            origins: (..., 3) metres, world frame; broadcast against the directions.
            directions: (..., 3), any length but zero; distances are along the unit direction. A ray
                with NaN in it hits nothing.
            hidden: names of objects to leave out.

        Returns:
            Hits of shape (...). A ray that starts inside a solid hits its wall from inside.
        """
        o, d = np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        shape = np.broadcast_shapes(o.shape, d.shape)
        o, d = (np.array(np.broadcast_to(each, shape), order="C").reshape(-1, 3) for each in (o, d))
        kept = np.flatnonzero(~np.isin(self._owner, list(hidden)))
        rows, count = np.ascontiguousarray(self.solids[kept]), len(d)
        distance, normal, row = np.full(count, np.inf), np.zeros((count, 3)), np.full(count, -1, np.int64)

        def chunk(part: slice) -> None:
            nearest_hits(o[part], d[part], rows, distance[part], row[part], normal[part])

        _by_chunks(chunk, count)
        if kept.size:
            row = np.where(row < 0, -1, kept[row])
        outer = shape[:-1]
        given = np.broadcast_to(np.asarray(origins, dtype=np.float64), shape).reshape(-1, 3)
        paint = partial(self._painted, given, d, distance, row, normal, shape)
        return Hits(
            self._labels[row + 1].reshape(outer), distance.reshape(outer), normal.reshape(shape), paint
        )

    def _painted(
        self,
        o: Array,
        d: Array,
        distance: Array,
        row: NDArray[np.int64],
        normal: Array,
        shape: tuple[int, ...],
    ) -> Array:
        color = np.empty((len(d), 3))

        def chunk(part: slice) -> None:
            color[part] = self._color(o[part], d[part], distance[part], row[part], normal[part])

        _by_chunks(chunk, len(d))
        return color.reshape(shape)

    def _color(self, o: Array, d: Array, distance: Array, row: NDArray[np.int64], normal: Array) -> Array:
        texture_of = self._texture_of[row]
        order = np.argsort(texture_of, kind="stable")  # -1 first: rays that hit nothing
        ends = np.cumsum(np.bincount(texture_of + 1, minlength=1))
        missed, color, o = order[: ends[0]], np.empty_like(d), np.ascontiguousarray(o)
        color[: ends[0]] = self._sky if self._pattern is None else self._pattern(d[missed])
        for index, (start, stop) in enumerate(pairwise(ends)):
            if start < stop:
                mine = order[start:stop]
                # take() copies rows in a fifth of the time of an index in brackets
                facing, points = normal.take(mine, axis=0), d.take(mine, axis=0)
                points *= distance[mine, None]
                points += o.take(mine, axis=0)
                points, faced = self._carried_back(points, facing, row[mine])
                color[start:stop] = textures.paint(self._textures[index], points, faced, facing)
        inverse = np.empty_like(order)
        inverse[order] = np.arange(len(order))
        return color.take(inverse, axis=0)

    def _carried_back(self, points: Array, normals: Array, row: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return points and normals (N, 3) as before their objects were moved: textures move with objects."""
        if not self._poses:
            return points, normals
        faced, labels = normals.copy(), self._labels[row + 1]
        for name, (R, place) in self._poses.items():
            mine = labels == self.label(name)
            points[mine] = (points[mine] - place) @ R + self._middle(name)
            faced[mine] = normals[mine] @ R
        return points, faced


def _by_chunks(work: Callable[[slice], None], count: int) -> None:
    """Call a function with the parts of a range, on several cores."""
    parts = [slice(start, start + _CHUNK) for start in range(0, count, _CHUNK)]
    if len(parts) < 2:
        for part in parts:
            work(part)
        return
    # Threads of this call alone: a pool kept between calls would hang in a forked process.
    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(work, parts))


def load_scene(name_or_path: str | Path) -> Scene:
    """Return a scene by its name, or from a YAML file.

    Raises:
        ValueError: no scene has that name, the file cannot be read, or a word or value in it is wrong.
    """
    path = _path(name_or_path)
    text = _text(path)
    try:
        description = yaml_text.parse(text)
    except ValueError as cause:
        raise ValueError(f"scene: {path}: {cause}") from cause
    return Scene(path.stem, description)


def summary(name_or_path: str | Path) -> str:
    """Return the comment that a scene's file begins with, in one line; empty without one.

    Raises:
        ValueError: as :func:`load_scene`.
    """
    lines = takewhile(lambda line: line.startswith("#"), _text(_path(name_or_path)).splitlines())
    return " ".join(line.strip("# ") for line in lines)


def _path(name_or_path: str | Path) -> Path:
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return path
    if str(name_or_path) not in scene_names():
        known = ", ".join(scene_names())
        raise ValueError(f"scene: expected one of {known}, or a YAML file; got {str(name_or_path)!r}")
    return SCENES / f"{name_or_path}.yaml"


def _text(path: Path) -> str:
    try:
        return yaml_text.read_text(path)
    except ValueError as cause:
        raise ValueError(f"scene: {path}: {cause}") from cause
