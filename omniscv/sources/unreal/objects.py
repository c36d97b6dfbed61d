"""The objects of a scene: mask colours, set so that each has a distinct one, and boxes."""

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import BadReplyError, ServerRefusedError
from omniscv.geometry import Array
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.geometry.unreal_frame import position_from_unreal, rotation_from_unreal
from omniscv.sources.base import Color, ObjectTable
from omniscv.sources.unreal import protocol
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.protocol import BOUNDS, OBJECTS, VERTICES, Reply, names

_TOLERANCE = 3  # how far a channel of a mask may be off; the official client allows as much
_EXACT = (0, *range(122, 145), *range(146, 256))
"""Channel values that every dialect shows as they are set (protocol reference, section 5.2)."""
_FAR_APART = (135, 151, 167, 183, 199, 215, 231)  # the values that are used first

_QUERIES = {"vertex_location": VERTICES, "bounds": BOUNDS}
_BATCH = 8  # objects that are queried together
MOST_VERTICES = 2_000_000
"""Of all objects, about 80 MB; of one object, five times as many are read."""
_MAX_CM = 1e9
_TIGHTER = 0.99
"""A box that is turned in the object's own frame replaces one along its axes if its volume is below this
share."""
_SAME_AREA = 1 + 1e-6
"""Boxes of one shape differ by so much as the object moves, because vertices are rounded."""


def paint(connection: Connection, vertex_colors: bool) -> None:
    """Set the mask colour of every object, to its own or, where that is ambiguous, to an unused one.

    A colour is ambiguous if it is the background's, an earlier object's, or with ``vertex_colors`` one that
    plugin 0.3.10 would not show as it is set. Every server gives one object black (protocol reference,
    section 5.1), and objects that were spawned late are in no mask and no depth until their colour is set
    (section 2.5).

    Args:
        connection: to the game.
        vertex_colors: whether masks change dark colours, as those of plugin 0.3.10.

    Raises:
        ServerRefusedError: a colour that must change is refused, or one is not kept.
    """
    used = {(0, 0, 0)}  # the background's
    candidates = itertools.chain(
        itertools.product(_FAR_APART, _FAR_APART, _FAR_APART), itertools.product(_EXACT, _EXACT, _EXACT)
    )
    painted: dict[str, Color] = {}
    changed = set()
    for name, color in colors(connection).items():
        if color in used or (vertex_colors and vertex_color_roundtrip(color) != color):
            color = next(candidate for candidate in candidates if candidate not in used)
            changed.add(name)
        used.add(color)
        painted[name] = color
    commands = [paint_command(name, color) for name, color in painted.items()]
    for name, command, reply in zip(painted, commands, connection.texts(commands), strict=True):
        if reply != "ok" and name in changed:
            raise ServerRefusedError(f"{connection.address}: {shown(command)} was refused: {shown(reply)}")
    for name, actual in zip(painted, _read(connection, painted), strict=True):
        if actual != painted[name]:
            expected = f"mask colour {painted[name]} of {shown(name)}, which was set"
            raise ServerRefusedError(f"{connection.address}: expected {expected}, got {actual}")


def object_table(connection: Connection, vertex_colors: bool) -> ObjectTable:
    """Return the objects of the scene and the colours that masks show.

    They are read over a ``connection``; with ``vertex_colors``, masks change dark ones.
    """
    table = colors(connection)
    if vertex_colors:
        for name in table:
            table[name] = vertex_color_roundtrip(table[name])
    return ObjectTable(table, _TOLERANCE)


def paint_command(name: str, color: Color) -> str:
    """Return the command that sets the mask ``color`` of the object ``name``."""
    return "vset /object/{}/color {} {} {}".format(name, *color)


def colors(connection: Connection) -> dict[str, Color]:
    """Return every object's mask colour, as set."""
    objects = names(connection.text(OBJECTS))
    return dict(zip(objects, _read(connection, objects), strict=True))


def parse_color(reply: str) -> Color:
    """Return the three numbers of ``(R=127,G=63,B=255,A=255)``; BadReplyError for a reply of another form."""
    match = re.fullmatch(r"\(R=(\d{1,3}),G=(\d{1,3}),B=(\d{1,3}),A=\d{1,3}\)", reply, re.ASCII)
    if match is not None:
        color = (int(match[1]), int(match[2]), int(match[3]))
        if max(color) <= 255:
            return color
    raise BadReplyError(f"expected a colour such as (R=127,G=63,B=255,A=255), got {shown(reply)}")


def _read(connection: Connection, objects: Iterable[str]) -> list[Color]:
    """Return the mask colours of objects, as set."""
    commands = [f"vget /object/{name}/color" for name in objects]
    return list(map(parse_color, connection.texts(commands)))


def vertex_color_roundtrip(color: Color) -> Color:
    """Return the colour that masks of plugin 0.3.10 show for an object's colour, RGB 0..255.

    It paints vertices with ``floor((c/255)^2.2 * 255.999)``, which masks show as ``round((v/255)^(1/2.2) *
    255)`` (protocol reference, section 5.2). Black stays black, and from 122 up only 145 changes.
    """
    red, green, blue = color
    return _vertex_level(red), _vertex_level(green), _vertex_level(blue)


def _vertex_level(level: int) -> int:
    """Return the level, 0..255, that masks of plugin 0.3.10 show for that of an object's colour."""
    vertex = math.floor((level / 255) ** 2.2 * 255.999)
    return round(float((vertex / 255) ** (1 / 2.2)) * 255)


def boxes(
    connection: Connection, names: Sequence[str], most_vertices: int = MOST_VERTICES
) -> dict[str, ObjectBox]:
    """Return the boxes of objects by name; objects without a shape have none.

    Vertices give a box along the object's own axes, or along turned ones where it is tighter; bounds give one
    along the world's axes.

    Args:
        connection: to the game.
        names: of the objects.
        most_vertices: of all objects; after so many, the remaining ones get a box of their bounds.

    Raises:
        BadReplyError: a reply that is neither numbers nor an error.
    """
    known = [what for what in _QUERIES if connection.supports(_QUERIES[what])]
    if not known:
        return {}
    known.append("rotation")
    by_name: dict[str, ObjectBox] = {}
    vertices = 0
    for start in range(0, len(names), _BATCH):
        if vertices > most_vertices and "bounds" in known:
            known = ["bounds"]
        for name, row in _rows(connection, names[start : start + _BATCH], known):
            points = row.get("vertex_location")
            if points is not None:
                vertices += len(points)
            box = _box_of(row)
            if box is not None:
                by_name[name] = box
    return by_name


_Row = dict[str, Array | None]
"""By query, the numbers that an object has: (N, 3) vertices, (2, 3) bounds, (3,) rotation; None without."""


def _rows(connection: Connection, names: Sequence[str], queries: Sequence[str]) -> Iterator[tuple[str, _Row]]:
    """Yield what is known of each of some objects, which are queried together."""
    commands = []
    for name in names:
        for what in queries:
            commands.append(f"vget /object/{name}/{what}")
    answers = iter(connection.read(commands, _numbers))
    for name in names:
        yield name, {what: next(answers) for what in queries}


def _box_of(row: _Row) -> ObjectBox | None:
    """Return the box of an object; None if it has no shape."""
    points = row.get("vertex_location")
    rotation = row.get("rotation")
    bounds = row.get("bounds")
    if points is not None:
        return _around(points, np.zeros(3) if rotation is None else rotation)
    return None if bounds is None else upright_box(bounds)


def upright_box(bounds_cm: Array) -> ObjectBox | None:
    """Return the box of bounds (2, 3) along the world's axes; None if all are 0, without a shape."""
    if not bounds_cm.any():
        return None
    low, high = np.sort(position_from_unreal(bounds_cm.T).T, axis=0)
    return ObjectBox((low + high) / 2, np.eye(3), high - low, "bounds")


def _numbers(command: str, reply: Reply) -> Array | None:
    """Return the numbers of a reply: (N, 3) vertices, (2, 3) bounds or a rotation (3,); None for an error."""
    if isinstance(reply, str) and (reply == "ok" or reply.startswith("error")):
        return None
    if command.endswith("/vertex_location"):
        return _vertices(command, reply)
    count = 6 if command.endswith("/bounds") else 3
    values = np.array(protocol.numbers(reply, count))
    return values.reshape(2, 3) if count == 6 else values


def _vertices(command: str, reply: Reply) -> Array:
    words = reply.split(maxsplit=15 * MOST_VERTICES)
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError:
        values = np.array([math.nan])
    if len(values) % 3 or not (np.abs(values) <= _MAX_CM).all():  # False for NaN, too
        expected = f"expected three numbers of at most {_MAX_CM:g} for each vertex from {shown(command)}"
        raise BadReplyError(f"{expected}, got {shown(reply[:100])}")
    return values.reshape(-1, 3)


def _around(vertices_cm: Array, rotator_deg: Array) -> ObjectBox:
    """Return the box of vertices along the axes of their object, or along turned ones if it is tighter."""
    points = position_from_unreal(vertices_cm.T).T
    own = rotation_from_unreal(rotator_deg).T
    aligned = _box(points, own)
    turned = _box(points, _upright_axes(points @ own.T) @ own)
    return turned if np.prod(turned.size) < _TIGHTER * np.prod(aligned.size) else aligned


def _box(points: Array, axes: Array) -> ObjectBox:
    along = points @ axes.T
    low = along.min(axis=0)
    high = along.max(axis=0)
    return ObjectBox.of((low + high) / 2 @ axes, axes, high - low, "vertices")


def _upright_axes(points: Array) -> Array:
    """Return the axes, as rows, of the smallest upright box around points (N, 3), turned by 45 degrees at
    most.

    One of its sides is parallel to a side of the convex hull seen from above (Freeman and Shapira 1975).
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to load

    try:
        hull = points[ConvexHull(points[:, :2]).vertices, :2]
    except (QhullError, ValueError):  # fewer than three points, or all in an upright plane
        hull = points[:2, :2]
    x, y = (np.roll(hull, -1, axis=0) - hull).T
    angles = (np.arctan2(y, x) + np.pi / 4) % (np.pi / 2) - np.pi / 4
    areas = _widths(hull, angles) * _widths(hull, angles + np.pi / 2)
    smallest = angles[areas <= areas.min() * _SAME_AREA]
    angle = smallest[np.abs(smallest).argmin()]
    c = np.cos(angle)
    s = np.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _widths(points: Array, angles: Array) -> Array:
    """Return (A,) how far points (N, 2) reach along each of the directions at angles (A,), radians."""
    along = np.outer(points[:, 0], np.cos(angles)) + np.outer(points[:, 1], np.sin(angles))
    return np.asarray(np.ptp(along, axis=0))
