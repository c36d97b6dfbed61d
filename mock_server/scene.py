"""Analytic scenes, traced exactly: the judge of everything else.

World frame: right-handed, metres, X forward, Y left, Z up. Lengths in the YAML are metres, angles degrees.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mock_server import build, textures
from mock_server.kernel import COLUMNS, CYLINDER, SPHERE, nearest_hits

Array = NDArray[np.float64]

_SCENES = Path(__file__).parent / "scenes"
_CHUNK = 1 << 13
_THREADS = ThreadPoolExecutor(max_workers=2, thread_name_prefix="trace")


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays meet first.

    Attributes:
        color: (..., 3) float64, 0..1; the sky's where nothing is hit.
        label: (...) uint16, 1 + rank of the object's name in sorted order; 0 for the sky.
        distance: (...) float64, metres along the unit direction; +inf for the sky.
        normal: (..., 3) float64, unit, towards the ray's side of the surface; 0 for the sky.
    """

    color: Array
    label: NDArray[np.uint16]
    distance: Array
    normal: Array


class Scene:
    """Solids with names and textures, or a pattern painted on the sphere of directions.

    Args:
        name: what the scene is called.
        data: the description; the words are explained in ``build.py``.

    Raises:
        ValueError: a word or number of the description is wrong.
    """

    def __init__(self, name: str, data: dict[str, Any]) -> None:
        self.name = name
        parts = build.build(data, name)
        self.objects: tuple[str, ...] = tuple(sorted(set(parts.names)))
        self._solids = np.array(parts.rows).reshape(-1, COLUMNS)
        self._labels = np.array([0] + [1 + self.objects.index(n) for n in parts.names], dtype=np.uint16)
        self._textures = list(dict.fromkeys(parts.textures))
        self._texture_of = np.array([self._textures.index(t) for t in parts.textures] + [-1], dtype=np.int64)
        self._owner = np.array(parts.names, dtype=object)
        self._sky = np.array(build.numbers(data.get("sky", (0.0, 0.0, 0.0)), 3, f"{name}: sky"))
        self._pattern = build.read_pattern(data.get("pattern"), name)

    def label(self, name: str) -> int:
        """An object's label: 1 + its rank in ``objects``."""
        return 1 + self.objects.index(name)

    def bounds(self, name: str) -> tuple[Array, Array]:
        """The least and the greatest corner of an object's box, (3,) metres, world frame.

        Raises:
            ValueError: no object has that name.
        """
        rows = self._solids[self._owner == name]
        if not len(rows):
            raise ValueError(f"object: expected one of {', '.join(self.objects)}; got {name!r}")
        kind, axes, half = rows[:, 0], rows[:, 5:14].reshape(-1, 3, 3), rows[:, 14:17]
        reach = np.abs(axes * half[:, :, None]).sum(axis=1)
        # Round things reach less far than the boxes around them.
        disc = half[:, :1] * np.hypot(axes[:, 0], axes[:, 1]) + np.abs(axes[:, 2]) * half[:, 2:]
        reach[kind == CYLINDER] = disc[kind == CYLINDER]
        reach[kind == SPHERE] = half[kind == SPHERE, :1]
        return (rows[:, 2:5] - reach).min(axis=0), (rows[:, 2:5] + reach).max(axis=0)

    def moved(self, moves: Mapping[str, tuple[Array, Array, Array]]) -> Scene:
        """This scene with some objects elsewhere. Textures stay fixed to the world, not to the objects.

        Args:
            moves: by object, a rotation (3, 3), the point it turns about, and where that point goes
                (both (3,) metres, world frame).
        """
        result = copy.copy(self)
        result._solids = self._solids.copy()
        for name, (R, pivot, place) in moves.items():
            rows = self._owner == name
            turned = (result._solids[rows, 2:5] - pivot) @ R.T
            result._solids[rows, 2:5] = turned + place
            axes = result._solids[rows, 5:14].reshape(-1, 3, 3) @ R.T
            result._solids[rows, 5:14] = axes.reshape(-1, 9)
        return result

    def trace(self, origins: ArrayLike, directions: ArrayLike, hidden: Iterable[str] = frozenset()) -> Hits:
        """What rays meet first, exact to float64 rounding.

        Args:
            origins: (..., 3) metres, world frame; broadcast against the directions.
            directions: (..., 3), any length but zero; distances are along the unit direction. A ray
                with NaN in it meets nothing.
            hidden: names of objects to leave out.

        Returns:
            Hits of shape (...). A ray that starts inside a solid meets its wall from inside.
        """
        d = np.asarray(directions, dtype=np.float64)
        shape = np.broadcast_shapes(np.shape(origins), d.shape)
        o = np.ascontiguousarray(np.broadcast_to(np.asarray(origins, dtype=np.float64), shape).reshape(-1, 3))
        with np.errstate(invalid="ignore", divide="ignore"):
            d = np.broadcast_to(d / np.linalg.norm(d, axis=-1, keepdims=True), shape).reshape(-1, 3)
        d = np.ascontiguousarray(d)
        kept = np.flatnonzero(~np.isin(self._owner, list(hidden)))
        solids, count = np.ascontiguousarray(self._solids[kept]), len(d)
        color, normal = np.empty((count, 3)), np.zeros((count, 3))
        distance, label = np.full(count, np.inf), np.zeros(count, dtype=np.uint16)

        def chunk(start: int) -> None:
            part = slice(start, start + _CHUNK)
            row = np.full(len(d[part]), -1, dtype=np.int64)
            nearest_hits(o[part], d[part], solids, distance[part], row, normal[part])
            row = np.where(row < 0, -1, kept[row] if kept.size else -1)
            label[part] = self._labels[row + 1]
            color[part] = self._color(o[part], d[part], distance[part], row, normal[part])

        list(_THREADS.map(chunk, range(0, count, _CHUNK)))
        outer = shape[:-1]
        return Hits(
            color.reshape(shape), label.reshape(outer), distance.reshape(outer), normal.reshape(shape)
        )

    def _color(self, o: Array, d: Array, distance: Array, row: NDArray[np.int64], normal: Array) -> Array:
        color = np.empty_like(d)
        missed = row < 0
        color[missed] = self._sky if self._pattern is None else self._pattern(d[missed])
        texture_of = self._texture_of[row]
        for index in np.unique(texture_of[~missed]):
            mine = np.flatnonzero(texture_of == index)
            n = normal[mine]
            points = o[mine] + distance[mine, None] * d[mine]
            color[mine] = textures.paint(self._textures[index], points, n)
        return color


def load_scene(name_or_path: str | Path) -> Scene:
    """A scene by its name, or from a YAML file.

    Raises:
        ValueError: no scene has that name, the file cannot be read, or a word in it is wrong.
    """
    import yaml

    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = _SCENES / f"{name_or_path}.yaml"
        if str(name_or_path) not in scene_names():
            known = ", ".join(scene_names())
            raise ValueError(f"scene: expected one of {known}, or a YAML file; got {str(name_or_path)!r}")
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as cause:
        raise ValueError(f"scene: expected a YAML file at {path}, got {cause}") from cause
    if not isinstance(data, dict):
        raise ValueError(f"scene: expected a mapping in {path}, got {data!r}")
    return Scene(path.stem, data)


def scene_names() -> list[str]:
    """The scenes that come with the server."""
    return sorted(path.stem for path in _SCENES.glob("*.yaml"))
