"""The description of a scene, and of its motions, as in its YAML file; docs/scenes.md explains the keys."""

import functools
import itertools
import math
import numbers as abstract
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mock_server.solids import BOX, COLUMNS, CYLINDER, RECTANGLE, SPHERE
from mock_server.textures import KINDS, Noise, Picture, Texture, direction_pattern, read_picture, waves
from mock_server.yaml_text import shown

Array = NDArray[np.float64]
Triple = tuple[float, ...]


@dataclass(frozen=True)
class Steady:
    """A motion of constant velocity, metres a second, and constant turn, degrees a second."""

    velocity: Triple
    turn_deg: float

    def at(self, time_s: float) -> tuple[Array, float]:
        """Return the offset (3,) in metres, and the turn to the left in degrees, after so many seconds."""
        return np.multiply(time_s, self.velocity), time_s * self.turn_deg


@dataclass(frozen=True)
class Swing:
    """A sinusoid of time: its amplitudes, metres and degrees, and its period."""

    by: Triple
    turn_deg: float
    period_s: float

    def at(self, time_s: float) -> tuple[Array, float]:
        """As :meth:`Steady.at`: times the sine of ``2 pi time_s / period_s``."""
        share = math.sin(2 * math.pi * math.remainder(time_s / self.period_s, 1.0))
        return np.multiply(share, self.by), share * self.turn_deg


@dataclass(frozen=True)
class Waypoints:
    """Straight lines between points (time, x, y, z, turn in degrees), in the order of their times.

    The object rests at the first point before, and at the last one after; with ``repeat``, it starts again.
    """

    points: tuple[Triple, ...]
    repeat: bool

    def at(self, time_s: float) -> tuple[Array, float]:
        """As :meth:`Steady.at`: linear in the time between two points."""
        times, *columns = np.array(self.points).T
        if self.repeat:
            time_s = times[0] + (time_s - times[0]) % (times[-1] - times[0])
        values = [float(np.interp(time_s, times, column)) for column in columns]
        return np.array(values[:3]), values[3]


def turned(turn_deg: float) -> Array:
    """Return (3, 3) the rotation about the vertical by degrees to the left."""
    angle = math.radians(math.remainder(turn_deg, 360.0))
    c = math.cos(angle)
    s = math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


Pattern = Callable[[Array], Array]
Range = Literal["from -1e9 to 1e9", "from 1e-9 to 1e9", "from 0 to 1", "from 1 to 10000"]
Motion = Steady | Swing | Waypoints
Moving = tuple[Motion, tuple[float, ...] | None]
"""A motion, and X and Y of its vertical axis of rotation; None: through the centre of the box."""

_MOST_SOLIDS = 10_000
_MOST_CORNERS = 256
_MOST_POINTS = 10_000
_LONGEST_NAME = 100
_RANGES: Mapping[Range, tuple[float, float]] = {
    "from -1e9 to 1e9": (-1e9, 1e9),
    "from 1e-9 to 1e9": (1e-9, 1e9),
    "from 0 to 1": (0.0, 1.0),
    "from 1 to 10000": (1.0, float(_MOST_SOLIDS)),
}
_SHAPES: Mapping[str, tuple[int, int, Callable[..., tuple[float, ...]]]] = {
    "box": (BOX, 3, lambda x, y, z: (x / 2, y / 2, z / 2)),
    "sphere": (SPHERE, 1, lambda radius: (radius, 0.0, 0.0)),
    "cylinder": (CYLINDER, 2, lambda radius, height: (radius, 0.0, height / 2)),
}
"""Kind for the kernel, how many numbers are the size, and the half sizes for the kernel."""

_MOST_OCTAVES = 12
_GOLDEN = 1.1347241384015194  # the root of x^6 = x + 1
_STILL = (0.0, 0.0, 0.0)
_MARGIN = 1 + 1e-9  # of bounding spheres, against rounding


@dataclass(frozen=True, eq=False)
class Room:
    """The room of a scene: upright walls on the edges of a floor, which is at z = 0.

    Attributes:
        corners: (N, 2) float64, X and Y of the floor's corners, metres, counter-clockwise from above.
        height: of the ceiling, metres.
        walls: N names of objects: wall i is from corner i to corner i + 1.
        floor, ceiling: names of objects.
    """

    corners: Array
    height: float
    walls: tuple[str, ...]
    floor: str = "Layout_Floor"
    ceiling: str = "Layout_Ceiling"


@dataclass
class SceneFile:
    """A description, read: solids with their objects and textures, and a sky or a pattern."""

    sky: tuple[float, ...]  # the colour of rays that hit nothing, 0..1
    pattern: Pattern | None  # their colours as a function of unit directions (N, 3)
    room: Room | None = None
    rows: list[Array] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    textures: list[Texture] = field(default_factory=list)
    moving: dict[str, Moving] = field(default_factory=dict)
    static: set[str] = field(default_factory=set)  # objects that no command can move

    def add(self, name: str, texture: Texture, kind: int, *columns: ArrayLike) -> None:
        """Add a solid.

        Args:
            name: of its object.
            texture: of its surface.
            kind: one of those of ``solids``, such as ``BOX``.
            columns: its centre, axes as rows, and half sizes, in metres; see ``solids.COLUMNS``.
        """
        if len(self.rows) == _MOST_SOLIDS:
            raise ValueError(f"{shown(name)}: expected at most {_MOST_SOLIDS} solids in a scene, got more")
        row = np.zeros(COLUMNS)
        row[0] = kind
        row[2:17] = np.concatenate([np.ravel(column) for column in columns])
        row[17] = _MARGIN * np.hypot(np.hypot(row[14], row[15] if kind != CYLINDER else 0.0), row[16])
        self.rows.append(row)
        self.names.append(name)
        self.textures.append(texture)


def read(description: object, where: str) -> SceneFile:
    """Return the solids and the sky of a description.

    Args:
        description: of a scene's YAML file, as a mapping.
        where: what error messages begin with: the scene's name.

    Raises:
        ValueError: an unknown or missing key, or a wrong value; the message names it.
    """
    data = _mapping(description, where, "sky", "room", "objects", "pattern")
    sky = _numbers(data.get("sky", (0.0, 0.0, 0.0)), 3, f"{where}: sky", "from 0 to 1")
    scene = SceneFile(sky, _pattern(data.get("pattern"), where))
    if "room" in data:
        _add_room(scene, data["room"], f"{where}: room")
    for name, value in _mapping(data.get("objects") or {}, f"{where}: objects").items():
        if not isinstance(name, str) or name.split() != [name] or len(name) > _LONGEST_NAME:
            wanted = f"expected names without spaces, of at most {_LONGEST_NAME} characters"
            raise ValueError(f"{where}: objects: {wanted}, got {shown(name)}")
        inner = f"{where}: {name if name.isprintable() else ascii(name)}"
        item = _mapping(value, inner, "solids", "texture", "moving", "movable")
        texture = _texture(item.get("texture", {}), f"{inner}: texture")
        for solid in _list(item.get("solids"), 1, f"{inner}: solids"):
            _add_solid(scene, name, solid, texture, inner)
        if "moving" in item:
            scene.moving[name] = _moving(item["moving"], f"{inner}: moving")
        if not _truth(item, "movable", True, inner):
            if "moving" in item:
                raise ValueError(f"{inner}: movable: expected true with a motion, got False")
            scene.static.add(name)
    return scene


def _numbers(value: object, count: int, where: str, what: Range = "from -1e9 to 1e9") -> tuple[float, ...]:
    """Return a value that is so many numbers in a range; a single number may stand without a list."""
    values: list[object] = []
    if isinstance(value, (list, tuple, np.ndarray)):
        values = list(value)
    elif count == 1:
        values = [value]
    least, most = _RANGES[what]
    numbers = []
    for item in values:
        if isinstance(item, abstract.Real) and not isinstance(item, bool) and least <= float(item) <= most:
            numbers.append(float(item))
    if not len(numbers) == len(values) == count:
        expected = f"{count} number{'s' if count > 1 else ''} ({what})"
        raise ValueError(f"{where}: expected {expected}, got {shown(value)}")
    return tuple(numbers)


def _mapping(value: object, where: str, *words: str) -> Mapping[str, object]:
    """Return a value that must be a mapping; if keys are given, of these keys only."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{where}: expected a mapping, got {shown(value)}")
    for key in value:
        if words and key not in words:
            raise ValueError(f"{where}: unknown key {shown(key)}; known keys: {', '.join(sorted(words))}")
    return value


def _truth(data: Mapping[str, object], key: str, default: bool, where: str) -> bool:
    value = data.get(key, default)
    if not isinstance(value, bool):
        raise ValueError(f"{where}: {key}: expected true or false, got {shown(value)}")
    return value


def _list(value: object, least: int, where: str) -> list[object]:
    """Return a value that is a list of at least so many items."""
    if not isinstance(value, (list, tuple, np.ndarray)) or len(value) < least:
        raise ValueError(f"{where}: expected a list of at least {least}, got {shown(value)}")
    return list(value)


def _texture(value: object, where: str) -> Texture:
    kind = _mapping(value, where).get("kind", "plain")
    if kind not in KINDS:
        raise ValueError(f"{where}: kind: expected one of {', '.join(KINDS)}; got {shown(kind)}")
    own = {"noise": ("seed", "octaves"), "image": ("file",)}.get(str(kind), ())
    data = _mapping(value, where, "kind", "colors", "scale", "angle_deg", *own)
    listed = _list(data.get("colors", [[0.7] * 3]), 1, f"{where}: colors")
    if len(listed) > 2:
        raise ValueError(f"{where}: colors: expected one or two, got {len(listed)}")
    colors = [_numbers(color, 3, f"{where}: colors", "from 0 to 1") for color in listed]
    (scale,) = _numbers(data.get("scale", 1.0), 1, f"{where}: scale", "from 1e-9 to 1e9")
    (angle,) = _numbers(data.get("angle_deg", 0.0), 1, f"{where}: angle_deg")
    texture = str(kind), colors[0], colors[-1], scale, math.radians(angle)
    if kind == "noise":
        (seed,) = _numbers(data.get("seed", 1), 1, f"{where}: seed", "from 1 to 10000")
        (octaves,) = _numbers(data.get("octaves", 5), 1, f"{where}: octaves", "from 1 to 10000")
        return Noise(*texture, int(seed), min(int(octaves), _MOST_OCTAVES))
    if kind == "image":
        try:
            return Picture(*texture, *read_picture(str(data.get("file"))))
        except ValueError as cause:
            raise ValueError(f"{where}: file: {cause}") from cause
    return Texture(*texture)


def _moving(value: object, where: str) -> Moving:
    """Return the motion of an object; each kind has its own keys."""
    data = _mapping(value, where)
    kind = data.get("kind")
    motion: Motion
    (turn_deg,) = _numbers(data.get("turn_deg", 0.0), 1, f"{where}: turn_deg")
    if kind == "steady":
        _mapping(data, where, "kind", "about", "velocity", "turn_deg")
        motion = Steady(_numbers(data.get("velocity", _STILL), 3, f"{where}: velocity"), turn_deg)
    elif kind == "swing":
        _mapping(data, where, "kind", "about", "by", "turn_deg", "period_s")
        by = _numbers(data.get("by", _STILL), 3, f"{where}: by")
        period_s = _numbers(data.get("period_s"), 1, f"{where}: period_s", "from 1e-9 to 1e9")
        motion = Swing(by, turn_deg, *period_s)
    elif kind == "waypoints":
        _mapping(data, where, "kind", "about", "points", "repeat")
        motion = _waypoints(data, where)
    else:
        raise ValueError(f"{where}: kind: expected one of steady, swing, waypoints; got {shown(kind)}")
    if "about" not in data:
        return motion, None
    return motion, _numbers(data["about"], 2, f"{where}: about")


def _waypoints(data: Mapping[str, object], where: str) -> Motion:
    name = f"{where}: points"
    repeat = _truth(data, "repeat", False, where)
    listed = _list(data.get("points"), 2, name)
    if len(listed) > _MOST_POINTS:
        raise ValueError(f"{name}: expected at most {_MOST_POINTS}, got {len(listed)}")
    points = tuple(_numbers(point, 5, name) for point in listed)
    for before, after in itertools.pairwise(points):
        if before[0] >= after[0]:
            raise ValueError(f"{name}: expected [time, x, y, z, turn] with times that grow")
    return Waypoints(points, repeat)


def _pattern(value: object, where: str) -> Pattern | None:
    if value is None:
        return None
    data = _mapping(value, f"{where}: pattern", "kind", "period_rad")
    kind = data.get("kind")
    if kind == "direction":
        return direction_pattern
    if kind == "waves":
        (period,) = _numbers(data.get("period_rad"), 1, f"{where}: pattern: period_rad", "from 1e-9 to 1e9")
        return functools.partial(waves, period_rad=period)
    raise ValueError(f"{where}: pattern: kind: expected direction or waves, got {shown(kind)}")


def _add_room(scene: SceneFile, value: object, where: str) -> None:
    """Add walls, floor and ceiling of a floor polygon."""
    data = _mapping(value, where, "floor", "height", "walls", "floor_texture", "ceiling_texture")
    corners, rectangles = _floor(data.get("floor"), f"{where}: floor")
    (height,) = _numbers(data.get("height", 2.8), 1, f"{where}: height", "from 1e-9 to 1e9")
    textures = []
    for wall in _list(data.get("walls", [{}]), 1, f"{where}: walls"):
        textures.append(_texture(wall, f"{where}: walls"))
    room = Room(corners, height, tuple(f"Layout_Wall_{i + 1}" for i in range(len(corners))))
    scene.room = room
    scene.static |= {*room.walls, room.floor, room.ceiling}
    ends = np.roll(corners, -1, axis=0)
    for i, wall_name in enumerate(room.walls):
        step = ends[i] - corners[i]
        length = float(np.linalg.norm(step))
        x, y = step / length
        center = [*(corners[i] + step / 2), height / 2]
        axes = [[x, y, 0], [0, 0, 1], [y, -x, 0]]
        half = [length / 2, height / 2, 0.0]
        scene.add(wall_name, textures[i % len(textures)], RECTANGLE, center, axes, half)
    for key, name, z in (("floor", room.floor, 0.0), ("ceiling", room.ceiling, height)):
        texture = _texture(data.get(f"{key}_texture", {}), f"{where}: {key}_texture")
        for low, high in rectangles:
            center = [*((low + high) / 2), z]
            half = [*((high - low) / 2), 0.0]
            scene.add(name, texture, RECTANGLE, center, np.eye(3), half)


def _floor(value: object, where: str) -> tuple[Array, list[tuple[Array, Array]]]:
    """Return the corners (N, 2) of a room's floor, metres, and the rectangles that fill it."""
    listed = _list(value, 4, where)
    if len(listed) > _MOST_CORNERS:
        raise ValueError(f"{where}: expected at most {_MOST_CORNERS} corners, got {len(listed)}")
    corners = np.array([_numbers(corner, 2, where) for corner in listed])
    steps = np.roll(corners, -1, axis=0) - corners
    if ((steps == 0).sum(axis=1) != 1).any():
        raise ValueError(f"{where}: expected neighbouring corners that differ in either x or y")
    rectangles = _rectangles(corners)
    area = 0.0
    for low, high in rectangles:
        area += float(np.prod(high - low))
    # Twice the signed area of the polygon; the rectangles' differs if it is clockwise, or crosses itself.
    twice = (corners[:, 0] * steps[:, 1] - corners[:, 1] * steps[:, 0]).sum()
    if not math.isclose(twice, 2 * area):
        raise ValueError(f"{where}: expected corners counter-clockwise, of edges that do not cross")
    return corners, rectangles


def _rectangles(corners: Array) -> list[tuple[Array, Array]]:
    """Cut a right-angled polygon into rectangles between its x values."""
    xs = np.unique(corners[:, 0])
    ends = np.roll(corners, -1, axis=0)
    rectangles = []
    for x0, x1 in itertools.pairwise(xs):
        middle = (x0 + x1) / 2
        crossed = np.sort(corners[(corners[:, 0] - middle) * (ends[:, 0] - middle) < 0, 1])
        for y0, y1 in crossed.reshape(-1, 2):
            rectangles.append((np.array([x0, y0]), np.array([x1, y1])))
    return rectangles


def _add_solid(scene: SceneFile, name: str, value: object, texture: Texture, where: str) -> None:
    data = _mapping(value, where, *_SHAPES, "at", "turn_deg", "tilt_deg", "texture", "copies")
    shapes = [shape for shape in _SHAPES if shape in data]
    if len(shapes) != 1:
        raise ValueError(f"{where}: expected one of {', '.join(_SHAPES)}; got {', '.join(shapes) or 'none'}")
    if "texture" in data:
        texture = _texture(data["texture"], f"{where}: texture")
    kind, count, half_of = _SHAPES[shapes[0]]
    half = half_of(*_numbers(data[shapes[0]], count, f"{where}: {shapes[0]}", "from 1e-9 to 1e9"))
    center = _numbers(data.get("at"), 3, f"{where}: at")
    (first_turn,) = _numbers(data.get("turn_deg", 0.0), 1, f"{where}: turn_deg")
    (first_tilt,) = _numbers(data.get("tilt_deg", 0.0), 1, f"{where}: tilt_deg")
    first = np.array([*center, first_turn, first_tilt])
    for x, y, z, turn_deg, tilt_deg in _copies(data.get("copies"), first, where):
        turn = math.radians(turn_deg)
        tilt = math.radians(tilt_deg)
        c = math.cos(turn)
        s = math.sin(turn)
        ahead = math.cos(tilt)
        up = math.sin(tilt)
        axes = [[ahead * c, ahead * s, 0.0 - up], [-s, c, 0.0], [up * c, up * s, ahead]]
        scene.add(name, texture, kind, [x, y, z], axes, half)


def _copies(value: object, first: Array, where: str) -> Array:
    """Return centre, turn and tilt (N, 5) of a solid's copies: in a row, and spread about it.

    They spread by an additive recurrence, even in each number (M. Roberts, R sequences, 2018): no seed.
    """
    if value is None:
        return first[None]
    where = f"{where}: copies"
    data = _mapping(value, where, "count", "step", "spread")
    (count,) = _numbers(data.get("count"), 1, f"{where}: count", "from 1 to 10000")
    step = _numbers(data.get("step", (0.0,) * 5), 5, f"{where}: step")
    spread = _numbers(data.get("spread", (0.0,) * 5), 5, f"{where}: spread")
    index = np.arange(int(count))[:, None]
    even = (0.5 + index * _GOLDEN ** -np.arange(1.0, 6.0)) % 1.0
    return np.asarray(first + index * step + (2 * even - 1) * spread)
