"""The mask colours of objects: read, and set so that every object has a distinct one."""

import itertools
import math
import re
from collections.abc import Iterable

from omniscv.arguments import shown
from omniscv.errors import BadReplyError, ServerRefusedError
from omniscv.sources.base import Color, ObjectTable
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.commands import ANNOTATE, OBJECTS
from omniscv.sources.unreal.replies import names

_TOLERANCE = 3  # how far a channel of a mask may be off; the official client allows as much
_EXACT = (0, *(value for value in range(122, 256) if value != 145))
"""Channel values that every dialect shows as they are set (protocol reference, section 5.2)."""
_FAR_APART = (135, 151, 167, 183, 199, 215, 231)  # the values that are used first


def paint(connection: Connection, vertex_colors: bool) -> None:
    """Set the mask colour of every object, to its own or, where that is ambiguous, to an unused one.

    A colour is ambiguous if it is the background's or an earlier object's. Every server gives one object
    black (protocol reference, section 5.1). Objects that were spawned late are in no mask and no depth until
    their colour is set (section 2.5).

    Args:
        connection: to the server.
        vertex_colors: whether to replace colours, too, that plugin 0.3.10 would not show as they are set.

    Raises:
        ServerRefusedError: the server refuses a colour that must change, or does not keep a colour.
    """
    if connection.supports(ANNOTATE):  # Dev builds: its reply is not documented
        connection.texts([ANNOTATE.replace("[str]", name) for name in names(connection.text(OBJECTS))])
    used = {(0, 0, 0)}  # the background's
    free = itertools.chain(*(itertools.product(values, values, values) for values in (_FAR_APART, _EXACT)))
    painted: dict[str, Color] = {}
    changed = set()
    for name, color in colors(connection).items():
        if color in used or (vertex_colors and vertex_color_roundtrip(color) != color):
            color = next(unused for unused in free if unused not in used)
            changed.add(name)
        used.add(color)
        painted[name] = color
    commands = [paint_command(name, color) for name, color in painted.items()]
    for name, command, reply in zip(painted, commands, connection.texts(commands), strict=True):
        if reply != "ok" and name in changed:
            raise ServerRefusedError(f"{connection.address}: {shown(command)} was refused: {shown(reply)}")
    for (name, color), actual in zip(painted.items(), _read(connection, painted), strict=True):
        if actual != color:
            expected = f"mask colour {color} of {shown(name)}, which was set"
            raise ServerRefusedError(f"{connection.address}: expected {expected}, got {actual}")


def object_table(connection: Connection, vertex_colors: bool) -> ObjectTable:
    """Return the objects of the scene and the colours that masks show; arguments as for :func:`paint`."""
    table = colors(connection)
    if vertex_colors:
        table = {name: vertex_color_roundtrip(color) for name, color in table.items()}
    return ObjectTable(table, _TOLERANCE)


def paint_command(name: str, color: Color) -> str:
    """Return the command that sets an object's mask colour."""
    return "vset /object/{}/color {} {} {}".format(name, *color)


def colors(connection: Connection) -> dict[str, Color]:
    """Return every object's mask colour, as set."""
    objects = names(connection.text(OBJECTS))
    return dict(zip(objects, _read(connection, objects), strict=True))


def parse_color(reply: str) -> Color:
    """Return the three numbers of ``(R=127,G=63,B=255,A=255)``; BadReplyError for a reply of another form."""
    match = re.fullmatch(r"\(R=(\d{1,3}),G=(\d{1,3}),B=(\d{1,3}),A=\d{1,3}\)", reply, re.ASCII)
    r, g, b = (256, 256, 256) if match is None else (int(value) for value in match.groups())
    if max(r, g, b) > 255:
        raise BadReplyError(f"expected a colour such as (R=127,G=63,B=255,A=255), got {shown(reply)}")
    return r, g, b


def _read(connection: Connection, objects: Iterable[str]) -> list[Color]:
    """Return the mask colours of objects, as set."""
    return [parse_color(reply) for reply in connection.texts([f"vget /object/{o}/color" for o in objects])]


def vertex_color_roundtrip(color: Color) -> Color:
    """Return the colour that masks of plugin 0.3.10 show for an object's colour, RGB 0..255.

    It paints vertices with ``floor((c/255)^2.2 * 255.999)``, which masks show as ``round((v/255)^(1/2.2) *
    255)`` (protocol reference, section 5.2). Black stays black, and from 122 up only 145 changes.
    """
    r, g, b = (round((math.floor((c / 255) ** 2.2 * 255.999) / 255) ** (1 / 2.2) * 255) for c in color)
    return r, g, b
