"""The live source: a server's own camera, posed for every view, asked for every mode."""

from __future__ import annotations

import itertools
import re
import time
from collections.abc import Iterable, Iterator
from typing import Any

from omniscv.captures.decode import decode
from omniscv.captures.source import Capabilities, ObjectTable, Source
from omniscv.captures.unreal.session import Reply, Session
from omniscv.captures.view import Capture, Request, View
from omniscv.errors import BadReply, ConnectionFailed, DeadlineExceeded, ServerRefused, SourceError

_IMAGE = {
    "lit": ("lit png", "png"),
    "object_mask": ("object_mask png", "png"),
    "depth": ("depth npy", "npy planar cm"),
    "normal": ("normal png", "png normal"),
}
_BACKGROUND = (0, 0, 0)
_EXACT = (135, 151, 167, 183, 199, 215, 231)

_BATCH = 24
"""Requests under way at once: enough to hide latency, few enough that a fault repeats little."""


class UnrealSource(Source):
    """Captures from a UE4/UE5 editor or packaged game with plugin 1.x.

    It spawns a camera of its own, so that straight up and down are exact and no pose lags, and sets its
    size and field of view. A broken connection is dropped, made anew, and the captures under way repeated.

    Args:
        endpoint: (host, port), or the path of a Unix socket.
        timeout_s: deadline of every request.
        retries: how often a capture is repeated before it fails.

    Raises:
        ConnectionFailed: nobody answers, or not as an UnrealCV server does.
    """

    def __init__(self, endpoint: tuple[str, int] | str, *, timeout_s: float = 30.0, retries: int = 3) -> None:
        self._endpoint, self._timeout_s, self._retries = endpoint, timeout_s, retries
        self._session = Session(endpoint, timeout_s)
        try:
            self._start()
        except BaseException:
            self._session.close()
            raise
        self._capabilities = Capabilities(pipelines=True, dialect="1.x")

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        group: list[Request] = []
        for request in requests:
            group.append(request)
            if len(group) == _BATCH:
                yield from self._repeated(group)
                group = []
        if group:
            yield from self._repeated(group)

    def objects(self) -> ObjectTable:
        return ObjectTable(self._colors())

    def close(self) -> None:
        self._session.close()

    def _separate_colors(self) -> None:
        """Repaints objects whose mask colour is black, the background's, or another object's.

        Every server gives one object black (protocol reference, section 5.1).
        """
        taken = {_BACKGROUND}
        free = iter(_spare_colors())
        for name, color in self._colors().items():
            if color in taken:
                color = next(spare for spare in free if spare not in taken)
                self._session.text("vset /object/{}/color {} {} {}".format(name, *color))
            taken.add(color)

    def _colors(self) -> dict[str, tuple[int, int, int]]:
        reply = self._session.text("vget /objects")
        names = [] if reply == "ok" else reply.split()  # ok is what an empty text becomes
        replies = self._session.ask_all([f"vget /object/{name}/color" for name in names]) if names else []
        return {name: _color(reply) for name, reply in zip(names, replies, strict=True)}

    def _start(self) -> None:
        """Finds out who answers, and spawns the camera."""
        self._version = self._session.text("vget /unrealcv/version")
        self._scene = self._session.text("vget /scene/name")
        try:
            before = len(self._session.text("vget /cameras").split())
        except ServerRefused as refused:
            raise ConnectionFailed(
                f"{self._session.address}: expected plugin 1.x with 'vget /cameras', got: {refused}"
            ) from refused
        self._session.text("vset /cameras/spawn")
        self._camera = before
        self._posed: View | None = None
        self._separate_colors()

    def _repeated(self, group: list[Request]) -> list[Capture]:
        for attempt in range(self._retries + 1):
            try:
                if self._session.broken:
                    self._session = Session(self._endpoint, self._timeout_s)
                    self._start()
                return self._captured(group)
            except (ConnectionFailed, DeadlineExceeded, BadReply) as fault:
                last: SourceError = fault
                self._session.close()
                time.sleep(min(2.0, 0.1 * 2**attempt))
        raise last

    def _captured(self, group: list[Request]) -> list[Capture]:
        """All captures of a group, asked for together."""
        commands: list[str] = []
        places: list[int] = []
        posed = self._posed
        for request in group:
            commands += self._pose_commands(posed, request.view)
            posed = request.view
            places.append(len(commands))
            commands.append(f"vget /camera/{self._camera}/{_IMAGE[request.mode][0]}")
        replies = self._session.ask_all(commands)
        for command, reply in zip(commands, replies, strict=True):
            if command.startswith("vset") and reply != "ok":
                raise BadReply(f"{self._session.address}: expected ok from {command!r}, got {reply!r}")
        self._posed = posed
        return [
            self._checked(request, commands[i], replies[i]) for request, i in zip(group, places, strict=True)
        ]

    def _pose_commands(self, before: View | None, view: View) -> list[str]:
        """What changes from one view to the next; numbers with fixed decimals, as the server parses them."""
        camera, commands = f"vset /camera/{self._camera}", []
        location, rotation = view.pose.to_unreal()
        if before is None or (before.width, before.height) != (view.width, view.height):
            commands.append(f"{camera}/size {view.width} {view.height}")
        if before is None or before.fov_deg != view.fov_deg:
            commands.append(f"{camera}/fov {view.fov_deg:.8f}")
        if before is None or before.pose.to_unreal().location_cm != location:
            commands.append("{}/location {:.6f} {:.6f} {:.6f}".format(camera, *location))
        if before is None or before.pose.to_unreal().rotation_deg != rotation:
            commands.append("{}/rotation {:.8f} {:.8f} {:.8f}".format(camera, *rotation))
        return commands

    def _checked(self, request: Request, command: str, reply: Reply) -> Capture:
        """A capture, if the reply is what was asked for."""
        if isinstance(reply, str):
            raise BadReply(
                f"{self._session.address}: expected a picture from {command!r}, got {reply[:200]!r}"
            )
        encoding = _IMAGE[request.mode][1]
        pixels = decode(reply, encoding, request.mode, request.view)
        provenance: dict[str, Any] = {
            "server": self._session.address,
            "scene": self._scene,
            "version": self._version,
            "dialect": self._capabilities.dialect,
            "command": command,
            "time": time.time(),
        }
        return Capture(request, request.view, pixels, reply, encoding, provenance)


def _spare_colors() -> Iterator[tuple[int, int, int]]:
    """Colours far from each other, of channel values that every dialect shows exactly."""
    yield from itertools.product(_EXACT, _EXACT, _EXACT)


def _color(reply: Reply) -> tuple[int, int, int]:
    """``(R=127,G=63,B=255,A=255)`` as three numbers."""
    found = re.fullmatch(r"\(R=(\d+),G=(\d+),B=(\d+),A=\d+\)", reply) if isinstance(reply, str) else None
    if found is None:
        raise BadReply(f"expected a colour such as (R=127,G=63,B=255,A=255), got {reply!r}")
    r, g, b = (int(value) for value in found.groups())
    return r, g, b
