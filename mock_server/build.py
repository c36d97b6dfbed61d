"""From a scene's description to rows of solids: the words of the YAML files, checked.

::

    sky: [0.5, 0.7, 1.0]
    room: {floor: [[-3, -2.5], [3, -2.5], [3, 2.5], [-3, 2.5]], height: 2.8, walls: [TEXTURE]}
    objects:
      Table: {solids: [{box: [2, 1, 0.75], at: [1, 0, 0.4], turn_deg: 20}], texture: TEXTURE}

A TEXTURE is ``{kind: checker, colors: [[r, g, b], [r, g, b]], scale: 0.5, angle_deg: 0}``; see textures.py.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mock_server.kernel import BOX, COLUMNS, CYLINDER, RECTANGLE, SPHERE
from mock_server.textures import KINDS, Texture, Waves, direction_pattern

Array = NDArray[np.float64]

_BOUND = 1 + 1e-9  # what rounding may take from a bounding sphere


@dataclass
class Parts:
    """What a description becomes: rows for the kernel, and the object and texture of each row."""

    rows: list[Array]
    names: list[str]
    textures: list[Texture]

    def add(self, name: str, texture: Texture, kind: int, center: Any, axes: Any, half: Any) -> None:
        """Adds a solid."""
        row = np.zeros(COLUMNS)
        row[0] = kind
        row[2:5], row[5:14], row[14:17] = center, np.asarray(axes).ravel(), half
        row[17] = _BOUND * np.hypot(np.hypot(row[14], row[15] if kind != CYLINDER else 0.0), row[16])
        self.rows.append(row)
        self.names.append(name)
        self.textures.append(texture)


def build(data: dict[str, Any], where: str) -> Parts:
    """The solids of a description.

    Raises:
        ValueError: a word is unknown, missing, or its numbers are wrong; the message names it.
    """
    _only(data, {"sky", "room", "objects", "pattern"}, where)
    parts = Parts([], [], [])
    if "room" in data:
        _add_room(parts, data["room"], f"{where}: room")
    for name, description in (data.get("objects") or {}).items():
        here = f"{where}: {name}"
        _only(description, {"solids", "texture"}, here)
        texture = read_texture(description.get("texture", {}), here)
        for solid in description.get("solids") or []:
            _add_solid(parts, name, solid, texture, here)
    return parts


def read_texture(data: Any, where: str) -> Texture:
    """A texture of the YAML."""
    _only(data, {"kind", "colors", "scale", "angle_deg"}, f"{where}: texture")
    kind = data.get("kind", "plain")
    if kind not in KINDS:
        raise ValueError(f"{where}: texture kind: expected one of {', '.join(KINDS)}; got {kind!r}")
    colors = [numbers(c, 3, f"{where}: texture colors") for c in data.get("colors") or [[0.7, 0.7, 0.7]]]
    scale, angle = numbers([data.get("scale", 1.0), data.get("angle_deg", 0.0)], 2, f"{where}: texture")
    return Texture(KINDS.index(kind), colors[0], colors[-1], scale, float(np.radians(angle)))


def read_pattern(data: Any, where: str) -> Callable[[Array], Array] | None:
    """The sky as a function of direction: ``{kind: direction}``, ``{kind: waves, period_rad: 0.04}``."""
    if data is None:
        return None
    _only(data, {"kind", "period_rad"}, f"{where}: pattern")
    if data.get("kind") == "direction":
        return direction_pattern
    if data.get("kind") == "waves":
        return Waves(numbers([data.get("period_rad")], 1, f"{where}: period_rad")[0])
    raise ValueError(f"{where}: pattern kind: expected direction or waves, got {data.get('kind')!r}")


def numbers(value: Any, count: int, where: str) -> Any:
    """``count`` finite numbers as a tuple."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(f"{where}: expected {count} finite numbers, got {value!r}")
    return tuple(array.tolist())


def _only(data: Any, known: set[str], where: str) -> None:
    if not isinstance(data, dict):
        raise ValueError(f"{where}: expected a mapping, got {data!r}")
    if unknown := sorted(set(map(str, data)) - known):
        raise ValueError(f"{where}: expected words among {', '.join(sorted(known))}; got {unknown[0]!r}")


def _add_room(parts: Parts, data: Any, where: str) -> None:
    """Walls, floor and ceiling of a floor polygon with right angles, corners counter-clockwise from above."""
    _only(data, {"floor", "height", "walls", "floor_texture", "ceiling_texture"}, where)
    corners = np.array([numbers(c, 2, f"{where}: floor") for c in data.get("floor") or []])
    if len(corners) < 4:
        raise ValueError(f"{where}: floor: expected at least 4 corners, got {len(corners)}")
    height = numbers([data.get("height", 2.8)], 1, f"{where}: height")[0]
    walls = [read_texture(t, f"{where}: walls") for t in data.get("walls") or [{}]]
    for i, (a, b) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        along = np.append((b - a) / np.linalg.norm(b - a), 0.0)
        center = np.append((a + b) / 2, height / 2)
        half = (np.linalg.norm(b - a) / 2, height / 2, 0.0)
        axes = [along, [0, 0, 1], np.cross(along, [0, 0, 1])]
        parts.add(f"Layout_Wall_{i + 1}", walls[i % len(walls)], RECTANGLE, center, axes, half)
    for name, z, key in (
        ("Layout_Floor", 0.0, "floor_texture"),
        ("Layout_Ceiling", height, "ceiling_texture"),
    ):
        texture = read_texture(data.get(key, {}), f"{where}: {key}")
        for low, high in _rectangles(corners):
            center = np.append((low + high) / 2, z)
            parts.add(name, texture, RECTANGLE, center, np.eye(3), np.append((high - low) / 2, 0.0))


def _rectangles(corners: Array) -> list[tuple[Array, Array]]:
    """A right-angled polygon cut into rectangles between its x values."""
    xs = np.unique(corners[:, 0])
    result = []
    for x0, x1 in itertools.pairwise(xs):
        middle = (x0 + x1) / 2
        edges = zip(corners, np.roll(corners, -1, axis=0), strict=True)
        crossed = sorted(a[1] for a, b in edges if (a[0] - middle) * (b[0] - middle) < 0)
        for y0, y1 in zip(crossed[::2], crossed[1::2], strict=True):
            result.append((np.array([x0, y0]), np.array([x1, y1])))
    return result


def _add_solid(parts: Parts, name: str, data: Any, texture: Texture, where: str) -> None:
    _only(data, {"box", "sphere", "cylinder", "at", "turn_deg", "texture"}, where)
    kinds = [kind for kind in ("box", "sphere", "cylinder") if kind in data]
    if len(kinds) != 1:
        raise ValueError(f"{where}: expected one of box, sphere, cylinder; got {kinds}")
    if "texture" in data:
        texture = read_texture(data["texture"], where)
    center = numbers(data.get("at"), 3, f"{where}: at")
    turn = np.radians(numbers([data.get("turn_deg", 0.0)], 1, f"{where}: turn_deg")[0])
    axes = [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    if kinds[0] == "box":
        size = numbers(data["box"], 3, f"{where}: box")
        parts.add(name, texture, BOX, center, axes, np.array(size) / 2)
    elif kinds[0] == "sphere":
        parts.add(name, texture, SPHERE, center, axes, (*numbers([data["sphere"]], 1, where), 0.0, 0.0))
    else:
        radius, height = numbers(data["cylinder"], 2, f"{where}: cylinder")
        parts.add(name, texture, CYLINDER, center, axes, (radius, 0.0, height / 2))
