"""The interface of camera drivers: what a live source and the doctor do with a camera of a game."""

import contextlib
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import ClassVar

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, BadReplyError, ServerRefusedError, SourceError
from omniscv.sources.base import Capture, Request, SceneIdentity, View
from omniscv.sources.codecs import decode
from omniscv.sources.unreal.client import Client, Reply
from omniscv.sources.unreal.commands import FIX_EXPOSURE, LEVEL, SCENE, VERSION, CommandTable
from omniscv.sources.unreal.connection import Connection
from omniscv.sources.unreal.mask_colors import paint
from omniscv.sources.unreal.replies import name, numbers
from omniscv.sources.unreal.stale_frames import StaleFrames

Requests = Sequence[Request]


class CameraDriver(ABC):
    """A camera of a running game, whose vignette and auto exposure it may switch off when attached.

    Its ``camera`` number, its ``capabilities`` and its ``scene_identity`` are complete once it is attached;
    ``mask_fov_deg`` is the field of view of object masks, where they do not have the view's own.
    """

    table: ClassVar[CommandTable]
    each_mode_lags: ClassVar[bool] = False  # whether modes lag independently after a move

    def __init__(self, connection: Connection, dialect: str, fix_exposure: bool = False) -> None:
        self._connection, self._fix_exposure = connection, fix_exposure
        self.capabilities = self.table.capabilities(dialect)
        self.camera = 0
        self.mask_fov_deg: float | None = None
        self._version = ""
        self.scene_identity = SceneIdentity()
        self.spawned = 0  # how many cameras: another one means that the game was started anew
        self._restore: list[str] = []  # the commands that leave the game as it was
        self.one_tick = False  # whether requests that come together are answered in one tick of the game
        self._aimed: View | None = None

    @abstractmethod
    def attach(self, stale_frames: StaleFrames) -> None:
        """Prepare the game at a new connection, and find or spawn the camera; SourceError if it refuses."""

    @abstractmethod
    def aim(self, before: View | None, view: View) -> list[str]:
        """Return the commands that take the camera from one view, None if unknown, to another."""

    @abstractmethod
    def collect(self, client: Client, requests: Requests, stale_frames: StaleFrames) -> Iterator[Capture]:
        """Yield captures of the first requests, in order; fewer where frames may be stale.

        Of the errors, one of ``RETRIED`` means that the connection cannot be used any more.
        """

    def cover(self, view: View) -> tuple[View, ...]:
        """Return the views that together show one, as :meth:`omniscv.sources.base.Source.cover`."""
        return (view,)

    def check(self, request: Request) -> None:
        """Raise ArgumentError for a view higher than wide, ServerRefusedError for a mode without pictures."""
        view, modes = request.view, sorted(self.capabilities.modes)
        if view.height > view.width:
            raise ArgumentError(
                f"size: expected a view at least as wide as high, got {view.width} x {view.height}: engines "
                "take the field of view of higher ones as vertical"
            )
        if request.mode not in modes:
            known = f"{', '.join(modes[:-1])} or {modes[-1]}"
            raise self._refused(f"a request for {known}, got {request.mode}, which has no picture")

    def forget(self) -> None:
        """Take the camera to be anywhere, and its last frames to show another world."""
        self._aimed = None

    def renew(self) -> None:
        """Give the camera up, where it was spawned: attaching spawns another."""
        self.release()
        self._restore = []
        self.forget()

    def read(self, what: str, count: int) -> list[float]:
        """Return numbers that the camera reports, such as its ``rotation``."""
        return numbers(self._connection.text(f"vget /camera/{self.camera}/{what}"), count)

    def release(self) -> None:
        """Leave the game as it was, where the connection still serves."""
        client = self._connection.client
        if client is not None and not client.broken:
            with contextlib.suppress(SourceError):  # the game may have ended, and the camera with it
                list(client.stream(self._restore))

    def _prepare(self) -> None:
        """Read what the game is, fix its exposure if that was requested, and make mask colours distinct."""
        self._version, scene = (name(self._connection.text(command)) for command in (VERSION, SCENE))
        (level,) = self._connection.texts([LEVEL])  # which some dialects do not know
        self.scene_identity = SceneIdentity(scene, "" if level.startswith("error") else name(level))
        if self._fix_exposure:
            self._connection.texts(FIX_EXPOSURE)
        paint(self._connection, self.table.vertex_colors)

    def _capture(self, request: Request, view: View, reply: Reply) -> Capture:
        """Return the capture that a reply is; BadReplyError if it is no picture of the view."""
        command, (_, encoding) = self.table.image(self.camera, request.mode), self.table.images[request.mode]
        if isinstance(reply, str):
            raise self._bad_reply(f"a picture from {command!r}, got {shown(reply[:100])}")
        provenance = {
            "server": self._connection.address,
            "scene": self.scene_identity.name,
            "version": self._version,
            "dialect": self.capabilities.dialect,
            "command": command,
            "time": time.time(),
        }
        pixels = decode(reply, encoding, request.mode, view)
        return Capture(request, view, pixels, provenance, reply, encoding)

    def _expect(self, expected: str, command: str, reply: Reply) -> None:
        if reply != expected:
            raise self._bad_reply(f"{expected} from {command!r}, got {shown(reply[:100])}")

    def _bad_reply(self, expected: str) -> BadReplyError:
        return BadReplyError(f"{self._connection.address}: expected {expected}")

    def _refused(self, expected: str) -> ServerRefusedError:
        return ServerRefusedError(f"{self._connection.address}: expected {expected}")
