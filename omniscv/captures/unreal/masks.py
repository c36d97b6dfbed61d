"""The mask colours of objects: asked, and set so that every object has one of its own."""

from __future__ import annotations

import itertools
import re

import numpy as np

from omniscv.captures.gamma import bent
from omniscv.captures.unreal.link import Link
from omniscv.errors import BadReply, ServerRefused

Color = tuple[int, int, int]

_BACKGROUND = (0, 0, 0)
_EXACT = (0, *(value for value in range(122, 256) if value != 145))
"""Channel values that every dialect shows as they are set (protocol reference, section 5.2)."""
_APART = (135, 151, 167, 183, 199, 215, 231)
"""Some that are far apart, to begin with."""


def paint(link: Link, *, exact: bool = False) -> None:
    """Sets every object's mask colour: its own, or another where that is the background's or taken.

    Every server gives one object black (protocol reference, section 5.1). Objects that were spawned late
    are in no mask and no depth until their colour is set (section 2.5).

    Args:
        link: the way to the server.
        exact: also sets another where plugin 0.3.10 would not show the colour as it is set.

    Raises:
        ServerRefused: a colour that must change cannot.
    """
    taken = {_BACKGROUND}
    free = itertools.chain(*(itertools.product(values, values, values) for values in (_APART, _EXACT)))
    wanted: dict[str, Color] = {}
    changed = set()
    for name, color in colors(link).items():
        if color in taken or (exact and shown(color) != color):
            color = next(spare for spare in free if spare not in taken)
            changed.add(name)
        taken.add(color)
        wanted[name] = color
    commands = ["vset /object/{}/color {} {} {}".format(name, *color) for name, color in wanted.items()]
    for name, command, reply in zip(wanted, commands, link.texts(commands), strict=True):
        if reply != "ok" and name in changed:
            raise ServerRefused(f"{link.address}: {command!r} was refused: {reply!r}")


def shown(color: Color) -> Color:
    """What plugin 0.3.10 shows for a colour."""
    r, g, b = bent(np.array(color)).tolist()
    return r, g, b


def colors(link: Link) -> dict[str, Color]:
    """Every object's mask colour, as set."""
    reply = link.text("vget /objects")
    names = [] if reply == "ok" else reply.split()  # ok is what an empty text becomes
    replies = link.texts([f"vget /object/{name}/color" for name in names])
    return {name: _color(reply) for name, reply in zip(names, replies, strict=True)}


def _color(reply: str) -> Color:
    """``(R=127,G=63,B=255,A=255)`` as three numbers."""
    found = re.fullmatch(r"\(R=(\d+),G=(\d+),B=(\d+),A=\d+\)", reply, re.ASCII)
    if found is None:
        raise BadReply(f"expected a colour such as (R=127,G=63,B=255,A=255), got {reply[:200]!r}")
    r, g, b = (int(value) for value in found.groups())
    return r, g, b
