"""Analytic scenes, traced exactly: the reference for composed images.

World frame: right-handed, metres, X forward, Y left, Z up. Lengths in the YAML are metres, angles degrees.
"""

from __future__ import annotations

import copy
import hashlib
import itertools
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mock_server import scene_file, textures, yaml_text
from mock_server.kernel import BOX, COLUMNS, CYLINDER, RECTANGLE, SPHERE, nearest_hits
from mock_server.scene_file import Room

Array = NDArray[np.float64]

_SCENES = Path(__file__).parent / "scenes"
_CHUNK = 1 << 13
_THREADS = 2
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_CIRCLE = [(np.cos(t), np.sin(t)) for t in np.linspace(0, 2 * np.pi, 64, endpoint=False)]
_RIMS = np.array([(x, y, z) for z in (-1.0, 1.0) for x, y in _CIRCLE])
_GLOBE = np.array(
    [
        (np.cos(t) * x, np.cos(t) * y, np.sin(t))
        for t in np.linspace(-np.pi / 2, np.pi / 2, 9)
        for x, y in _CIRCLE
    ]
)
_MESHES = {RECTANGLE: _CORNERS, BOX: _CORNERS, CYLINDER: _RIMS, SPHERE: _GLOBE}
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
        sky: (3,) float64, 0..1, the colour of rays that hit nothing; None where a pattern gives it.
        room: the room; None without one, or once a wall of it was moved.

    Raises:
        ValueError: a word or value of the description is wrong; the message names it.
    """

    def __init__(self, name: str, description: Mapping[str, object]) -> None:
        parts = scene_file.read(description, name)
        self.name = name
        self.objects: tuple[str, ...] = tuple(sorted(set(parts.names)))
        self.solids = np.array(parts.rows).reshape(-1, COLUMNS)
        labels = {each: label for label, each in enumerate(self.objects, start=1)}
        self._labels = np.array([0] + [labels[each] for each in parts.names], dtype=np.uint16)
        textures_used = {each: index for index, each in enumerate(dict.fromkeys(parts.textures))}
        self._textures = list(textures_used)
        self._texture_of = np.array([textures_used[each] for each in parts.textures] + [-1], dtype=np.int64)
        self._owner = np.array(parts.names, dtype=object)
        self._sky, self._pattern = np.array(parts.sky), parts.pattern
        self.sky = None if self._pattern else self._sky
        self.room: Room | None = parts.room

    def label(self, name: str) -> int:
        """Return an object's label: 1 + its rank in ``objects``."""
        return 1 + self.objects.index(name)

    def digest(self) -> str:
        """Return a SHA-256 of all there is to see, hexadecimal; lengths count to the micrometre."""
        colors = self._sky if self._pattern is None else self._pattern(_SOME_DIRECTIONS)
        numbers = [(np.round(each, 6) + 0.0).tolist() for each in (self.solids, colors)]
        seen = (self.objects, numbers, self._labels.tolist(), self._textures, self._texture_of.tolist())
        return hashlib.sha256(repr(seen).encode()).hexdigest()

    def bounds(self, name: str) -> tuple[Array, Array]:
        """Return the least and the greatest corner of an object's box, (3,) metres each, world frame.

        Raises:
            ValueError: no object has that name.
        """
        return self._extent(self._rows(name), np.eye(3))

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
        low, high = self._extent(rows, axes)
        return (low + high) / 2 @ axes, axes, high - low

    def vertices(self, name: str) -> Array:
        """Return (N, 3) points of an object, metres, world frame, as of a mesh: the corners of its boxes and
        rectangles, 64 on each rim of its cylinders, and on circles of its spheres.

        Raises:
            ValueError: no object has that name.
        """
        points = []
        for row in self._rows(name):
            unit, (a, b, c) = _MESHES[int(row[0])], row[14:17]
            half = {SPHERE: (a, a, a), CYLINDER: (a, a, c)}.get(int(row[0]), (a, b, c))
            points.append(row[2:5] + (unit * half) @ row[5:14].reshape(3, 3))
        return np.concatenate(points)

    def _rows(self, name: str) -> Array:
        rows: Array = self.solids[self._owner == name]
        if not len(rows):
            raise ValueError(f"object: expected one of {', '.join(self.objects)}; got {name!r}")
        return rows

    @staticmethod
    def _extent(rows: Array, frame: Array) -> tuple[Array, Array]:
        """Return the least and the greatest coordinates of solids along the rows of ``frame``."""
        kind, axes, half = rows[:, 0], rows[:, 5:14].reshape(-1, 3, 3) @ frame.T, rows[:, 14:17]
        extent = np.abs(axes * half[:, :, None]).sum(axis=1)
        disc = half[:, :1] * np.hypot(axes[:, 0], axes[:, 1]) + np.abs(axes[:, 2]) * half[:, 2:]
        extent[kind == CYLINDER] = disc[kind == CYLINDER]
        extent[kind == SPHERE] = half[kind == SPHERE, :1]
        centers = rows[:, 2:5] @ frame.T
        return (centers - extent).min(axis=0), (centers + extent).max(axis=0)

    def moved(self, moves: Mapping[str, tuple[Array, Array, Array]]) -> Scene:
        """Return this scene with some objects elsewhere. Textures stay fixed to the world.

        Args:
            moves: by object, a rotation (3, 3), the point it turns about, and where that point goes
                (both (3,) metres, world frame).
        """
        result = copy.copy(self)
        result.solids = self.solids.copy()
        for name, (R, pivot, place) in moves.items():
            rows = self._owner == name
            result.solids[rows, 2:5] = (self.solids[rows, 2:5] - pivot) @ R.T + place
            result.solids[rows, 5:14] = (self.solids[rows, 5:14].reshape(-1, 3, 3) @ R.T).reshape(-1, 9)
        if self.room and {*self.room.walls, self.room.floor, self.room.ceiling} & moves.keys():
            result.room = None
        return result

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
        with np.errstate(invalid="ignore", divide="ignore"):
            d = d / np.linalg.norm(d, axis=-1, keepdims=True)
        shape = np.broadcast_shapes(o.shape, d.shape)
        o, d = (np.array(np.broadcast_to(each, shape), order="C").reshape(-1, 3) for each in (o, d))
        kept = np.flatnonzero(~np.isin(self._owner, list(hidden)))
        solids, count = np.ascontiguousarray(self.solids[kept]), len(d)
        distance, normal, row = np.full(count, np.inf), np.zeros((count, 3)), np.full(count, -1, np.int64)

        def chunk(part: slice) -> None:
            nearest_hits(o[part], d[part], solids, distance[part], row[part], normal[part])

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
        color = np.empty_like(d)
        missed = row < 0
        color[missed] = self._sky if self._pattern is None else self._pattern(d[missed])
        texture_of = self._texture_of[row]
        for index in np.flatnonzero(np.bincount(texture_of[~missed])):
            mine = np.flatnonzero(texture_of == index)
            points = o[mine] + distance[mine, None] * d[mine]
            color[mine] = textures.paint(self._textures[index], points, normal[mine])
        return color


def _by_chunks(work: Callable[[slice], None], count: int) -> None:
    """Call a function with the parts of a range, on several cores."""
    parts = [slice(start, start + _CHUNK) for start in range(0, count, _CHUNK)]
    if len(parts) == 1:
        work(parts[0])
        return
    # Threads of this call alone: a pool kept between calls would hang in a forked process.
    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(work, parts))


def load_scene(name_or_path: str | Path) -> Scene:
    """Return a scene by its name, or from a YAML file.

    Raises:
        ValueError: no scene has that name, the file cannot be read, or a word or value in it is wrong.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = _SCENES / f"{name_or_path}.yaml"
        if str(name_or_path) not in scene_names():
            known = ", ".join(scene_names())
            raise ValueError(f"scene: expected one of {known}, or a YAML file; got {str(name_or_path)!r}")
    try:
        description = yaml_text.parse(yaml_text.read_text(path))
    except ValueError as cause:
        raise ValueError(f"scene: {path}: {cause}") from cause
    return Scene(path.stem, description)


def scene_names() -> list[str]:
    """Return the names of the scenes in this package."""
    return sorted(path.stem for path in _SCENES.glob("*.yaml"))
