"""The mask colours of objects: read, and set so that every object has a distinct one."""

import itertools
import math
import re
from collections.abc import Iterable

from omniscv.arguments import shown
from omniscv.errors import BadReplyError, ServerRefusedError
from omniscv.sources.base import Color, ObjectTable
from omniscv.sources.unreal.connection import Connection
from omniscv.sources.unreal.replies import names

_TOLERANCE = 3  # how far a channel of a mask may be off; the official client allows as much
_EXACT = (0, *(value for value in range(122, 256) if value != 145))
"""Channel values that every dialect shows as they are set (protocol reference, section 5.2)."""
_FAR_APART = (135, 151, 167, 183, 199, 215, 231)  # the values that are used first


def paint(connection: Connection, vertex_colors: bool) -> None:
    """Set every object's mask colour: its own, or another where that is the background's or another object's.

    Every server gives one object black (protocol reference, section 5.1). Objects that were spawned late
    are in no mask and no depth until their colour is set (section 2.5). With ``vertex_colors``, colours that
    plugin 0.3.10 would not show as they are set are replaced too. Raise ServerRefusedError if the server
    refuses a colour that must change, or if an object does not have the colour that was set.
    """
    used = {(0, 0, 0)}  # the background's
    free = itertools.chain(*(itertools.product(values, values, values) for values in (_FAR_APART, _EXACT)))
    wanted: dict[str, Color] = {}
    changed = set()
    for name, color in colors(connection).items():
        if color in used or (vertex_colors and vertex_color_roundtrip(color) != color):
            color = next(unused for unused in free if unused not in used)
            changed.add(name)
        used.add(color)
        wanted[name] = color
    commands = [paint_command(name, color) for name, color in wanted.items()]
    for name, command, reply in zip(wanted, commands, connection.texts(commands), strict=True):
        if reply != "ok" and name in changed:
            raise ServerRefusedError(f"{connection.address}: {shown(command)} was refused: {shown(reply)}")
    for (name, color), found in zip(wanted.items(), _read(connection, wanted), strict=True):
        if found != color:
            expected = f"mask colour {color} of {shown(name)}, which was set"
            raise ServerRefusedError(f"{connection.address}: expected {expected}, got {found}")


def object_table(connection: Connection, vertex_colors: bool) -> ObjectTable:
    """Return the objects of the scene and the colours that masks show; arguments as for :func:`paint`."""
    found = colors(connection)
    shown = {name: vertex_color_roundtrip(color) for name, color in found.items()} if vertex_colors else found
    return ObjectTable(shown, _TOLERANCE)


def paint_command(name: str, color: Color) -> str:
    """Return the command that sets an object's mask colour."""
    return "vset /object/{}/color {} {} {}".format(name, *color)


def colors(connection: Connection) -> dict[str, Color]:
    """Return every object's mask colour, as set."""
    found = names(connection.text("vget /objects"))
    return dict(zip(found, _read(connection, found), strict=True))


def parse_color(reply: str) -> Color:
    """Return the three numbers of ``(R=127,G=63,B=255,A=255)``; BadReplyError for a reply of another form."""
    found = re.fullmatch(r"\(R=(\d{1,3}),G=(\d{1,3}),B=(\d{1,3}),A=\d{1,3}\)", reply, re.ASCII)
    r, g, b = (256, 256, 256) if found is None else (int(value) for value in found.groups())
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
