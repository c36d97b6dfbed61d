"""A client that needs the fewest exchanges for a view that the protocol allows."""

import contextlib
from collections.abc import Iterable, Iterator
from itertools import groupby

from omniscv.sources import Request
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.legacy import LegacyDriver
from omniscv.sources.unreal.modern import ModernDriver
from omniscv.sources.unreal.protocol import LEGACY, LIT_VIEW_MODE

POSE = "vget /camera/0/pose"
SETTLES = 3  # sequential exchanges that a move of plugin 0.3.10 needs (protocol reference, section 7.2)


def bare(address: str, dialect: str, stream: Iterable[Request]) -> Iterator[None]:
    """Yield once a capture, of a client that keeps the protocol's rules, and decodes and compares nothing.

    The first is the camera's start. Plugin 1.x may have any number of requests under way; 0.3.10 needs
    ``SETTLES`` exchanges after a move, and one for the mask, which is answered out of order.
    """
    host, _, port = address.removeprefix("unreal://").rpartition(":")
    with contextlib.closing(Connection((host, int(port)))) as connection:
        driver = (LegacyDriver if dialect == "L" else ModernDriver)(connection)
        driver.attach()
        client = connection.connected()
        yield
        if dialect == "L":
            for view, requests in groupby(stream, lambda request: request.view):
                images = [LEGACY.image(0, request.mode) for request in requests]
                masks = [image for image in images if "mask" in image]
                moves = driver.aim(None, view)
                others = [image for image in images if image not in masks]
                for commands in (moves, *[[POSE]] * SETTLES, masks, [LIT_VIEW_MODE, *others, POSE]):
                    list(client.stream(commands))
                yield from [None] * len(images)
        else:
            commands, before = [], None
            for request in stream:
                commands += driver.aim(before, request.view)
                commands.append(driver.table.image(driver.camera, request.mode))
                before = request.view
            for command, _ in zip(commands, client.stream(commands), strict=True):
                if command.startswith("vget"):
                    yield
        driver.release()
