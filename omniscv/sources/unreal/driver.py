"""The interface of camera drivers, which aim a game's camera and take pictures; detection of stale frames."""

import contextlib
import time
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, BadReplyError, ServerRefusedError, SourceError
from omniscv.sources.base import Capture, Request, SceneIdentity, View
from omniscv.sources.codecs import decode, decode_png, show_light
from omniscv.sources.unreal.client import Client, Connection
from omniscv.sources.unreal.objects import paint
from omniscv.sources.unreal.protocol import (
    EXPOSURE_METHOD,
    FIX_EXPOSURE,
    LEVEL,
    OBJECTS,
    SCENE,
    VERSION,
    CameraTable,
    Reply,
    name,
    numbers,
)
from omniscv.sources.world import CameraExposure, SharedExposure

Requests = Sequence[Request]

SETTLED = 3  # after so many frames in one state of the camera, the next is taken to show it
_WAITS = (0, 1, SETTLED)  # more frames to skip at each attempt; the frame of the last attempt is accepted


class StaleFrames:
    """Detects stale frames: pictures that still show what a camera saw before it moved.

    Some cameras lag (protocol reference, section 7.2). A stale picture is not marked, but it equals, byte for
    byte, the frame before the move. So frames are compared with the ones before a move, and the number of
    stale frames is learned. Modes lag independently: a fresh depth says nothing of the mask.

    Attributes:
        states: by mode, the state of the camera at its last frame: a view, or the pose and field of view that
            the camera reports.
        lag: frames after a move that are known to be stale; kept over new connections.
    """

    def __init__(self) -> None:
        self.lag = 0
        self._lookalikes: set[int] = set()  # hashes of frames that two states share
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the connection is new, and the camera may be anywhere."""
        self.states: dict[str, Hashable] = {}
        self._payloads: dict[str, bytes] = {}
        self._rejected = 0

    @property
    def in_doubt(self) -> bool:
        """Whether the last frame that was compared was rejected."""
        return self._rejected > 0

    def skips(self) -> int:
        """Return how many frames to drop after the next move, or, if in doubt, now."""
        # The first frames of a connection may be garbage, and there is none to compare them with.
        return max(self.lag + _WAITS[self._rejected], 0 if self.states else SETTLED)

    def accepts(self, state: Hashable, payloads: Mapping[str, bytes]) -> bool:
        """Return whether frames are fresh; if one may be stale, request them again, and skip more.

        Two states may show the same. Then waiting changes nothing, and the frames are accepted in the end.
        They are remembered, so that the next time they are accepted at once.
        """
        moved = [mode for mode in payloads if self.states.get(mode, state) != state]
        equal = [hash(payloads[mode]) for mode in moved if payloads[mode] == self._payloads[mode]]
        doubtful = {*equal} - self._lookalikes
        if doubtful and self._rejected + 1 < len(_WAITS):
            self._rejected += 1
            return False
        self._lookalikes |= doubtful
        if len(equal) < len(moved):  # the frames that were skipped beyond the lag were stale
            self.lag = min(SETTLED, self.lag + _WAITS[self._rejected])
        self._rejected = 0
        self.note(state, payloads)
        return True

    def note(self, state: Hashable, payloads: Mapping[str, bytes]) -> None:
        """Remember frames without comparing them."""
        self.states.update(dict.fromkeys(payloads, state))
        self._payloads.update(payloads)


@dataclass(frozen=True)
class CameraOptions:
    """How a camera is exposed.

    Attributes:
        fix_exposure: whether to switch off vignette and auto exposure of the whole game.
        exposure: of the spawned camera: manual with a bias in stops, or with one that matches the game's, or
            the game's own. None: the matching one where the plugin can set it.
        warmup: frames of colour to drop after each move, where temporal effects blend them.
    """

    fix_exposure: bool = False
    exposure: CameraExposure | None = None
    warmup: int = 0


SPAWNED = CameraOptions()
"""A camera of its own, with manual exposure where the plugin can set it."""


class CameraDriver(ABC):
    """A camera of a running game.

    Args:
        connection: to the game.
        options: its exposure.

    Attributes:
        capabilities, scene_identity, camera: complete once the driver is attached; ``camera`` is its number.
        mask_fov_deg: field of view of object masks, where they do not have the view's own.
        spawned: how many cameras were spawned; another one means that the game was restarted.
        color_settings: of the camera, that the provenance of colours has.
        shared_exposure: of the cameras that record together.
        one_tick: whether requests that are sent together are answered in one tick of the game.
    """

    table: CameraTable

    def __init__(self, connection: Connection, options: CameraOptions = SPAWNED) -> None:
        self.connection, self._options = connection, options
        known = self.table.capabilities(connection.plugin.dialect)
        self.capabilities = replace(known, can_set_exposure=connection.supports(EXPOSURE_METHOD))
        self.stale_frames = StaleFrames()
        self.camera = 0
        self.mask_fov_deg: float | None = None
        self._version = ""
        self.scene_identity = SceneIdentity()
        self.color_settings: dict[str, str] = {}
        self.shared_exposure = SharedExposure()
        self._has_normals = False  # whether a picture of them was seen to be one
        self.spawned, self._prepared = 0, False
        self._restore: list[str] = []  # the commands that leave the game as it was
        self.one_tick = False
        self._aimed: View | None = None

    @abstractmethod
    def attach(self) -> None:
        """Prepare the game at a new connection, and find or spawn the camera; SourceError if it refuses."""

    def verify(self) -> None:  # noqa: B027  (most drivers have nothing to verify)
        """Raise ServerRefusedError for a camera that does not keep what is set."""

    def expose(self, requests: Requests) -> None:  # noqa: B027  (most drivers cannot)
        """Set the camera's exposure before its first colours.

        Raises:
            ServerRefusedError: the server refuses the exposure that the options ask for.
            BadReplyError: the game has started again, and lacks the camera.
        """

    @abstractmethod
    def aim(self, before: View | None, view: View) -> list[str]:
        """Return the commands that turn the camera from one view, None if unknown, to another."""

    @abstractmethod
    def collect(self, client: Client, requests: Requests) -> Iterator[Capture]:
        """Yield captures of the first requests, in order; fewer where frames may be stale.

        An error of ``RETRIED`` means that the connection cannot be used any more.
        """

    def cover(self, view: View) -> tuple[View, ...]:
        """Return the views that together show one, as :meth:`omniscv.sources.base.Source.cover`."""
        return (view,)

    def check(self, request: Request) -> None:
        """Raise ArgumentError for a view higher than wide, ServerRefusedError for a mode without pictures."""
        view, modes = request.view, sorted(self.capabilities.modes)
        if request.stops is not None and not self.capabilities.can_set_exposure:
            raise self._refused(f"a plugin that sets exposure, N2 or later, for {request.stops:g} stops")
        if view.lens is not None:
            raise ArgumentError(f"lens: expected none of a game's camera, got {view.lens}")
        if view.height > view.width:
            raise ArgumentError(
                f"size: expected a view at least as wide as high, got {view.width} x {view.height}: engines "
                "take the field of view of higher ones as vertical"
            )
        if request.mode not in modes:
            known = f"{', '.join(modes[:-1])} or {modes[-1]}"
            raise self._refused(f"a request for {known}, got {request.mode}, which has no picture")

    def check_scene(self) -> None:
        """Raise SceneChangedError if the game showed another scene than before when it captured."""
        self.connection.check_scene()

    def forget(self) -> None:
        """Forget where the camera is, so that it is aimed anew."""
        self._aimed = None

    def settle(self) -> None:
        """Wait until captures show what was changed in the world; frames from before are stale."""
        self.stale_frames.reset()
        self.forget()
        for _ in range(SETTLED):
            self.connection.text(VERSION)  # each reply comes at least one frame later

    def read(self, what: str, count: int) -> list[float]:
        """Return numbers that the camera reports, such as its ``rotation``."""
        return numbers(self.connection.text(f"vget /camera/{self.camera}/{what}"), count)

    def release(self) -> None:
        """Leave the game as it was, if the connection still works."""
        client = self.connection.client
        if client is not None and not client.broken:
            with contextlib.suppress(SourceError):  # the game may have ended, and the camera with it
                list(client.stream(self._restore))

    def _prepare(self) -> None:
        """Read the game's identity, fix its exposure if requested, and make mask colours distinct."""
        self._version, scene = (name(self.connection.text(command)) for command in (VERSION, SCENE))
        level = name(self.connection.text(LEVEL)) if self.connection.supports(LEVEL) else ""
        # Plugin 0.3.10 names no level, and lists the objects that the level had when it began.
        told = {LEVEL: level} if level else {}
        if self.connection.plugin.dialect == "0.3.10":
            told = {OBJECTS: self.connection.text(OBJECTS)}
        self.connection.scene = self.connection.scene or {SCENE: scene, **told}
        self.scene_identity = SceneIdentity(scene, level)
        if self._options.fix_exposure:
            # Of the whole game: the vignette, and auto exposure where no camera has its own.
            own = self._options.exposure not in (None, "game")
            self.connection.texts(FIX_EXPOSURE[:1] if own else FIX_EXPOSURE)
        paint(self.connection, self.table.vertex_colors)

    def _capture(self, request: Request, view: View, reply: Reply) -> Capture:
        """Return the capture in a reply; BadReplyError if it is no picture of the view."""
        command, (_, encoding) = self.table.image(self.camera, request.mode), self.table.images[request.mode]
        if isinstance(reply, str):
            raise self._bad_reply(f"a picture from {command!r}, got {shown(reply[:100])}")
        provenance = {
            "server": self.connection.address,
            "scene": self.scene_identity.name,
            "version": self._version,
            "dialect": self.capabilities.dialect,
            "command": command,
            "time": time.time(),
            **(self.color_settings if request.mode == "lit" else {}),
        }
        pixels = decode(reply, encoding, request.mode, view)
        if request.mode == "normals" and not self._has_normals:
            if show_light(decode_png(reply, view)):
                raise self._refused("pictures of normals, got the lit image; update the plugin to 1.1.0")
            self._has_normals = True
        return Capture(request, view, pixels, provenance, reply, encoding)

    def _expect(self, expected: str, command: str, reply: Reply) -> None:
        if reply != expected:
            raise self._bad_reply(f"{expected} from {command!r}, got {shown(reply[:100])}")

    def _bad_reply(self, expected: str) -> BadReplyError:
        return BadReplyError(f"{self.connection.address}: expected {expected}")

    def _refused(self, expected: str) -> ServerRefusedError:
        return ServerRefusedError(f"{self.connection.address}: expected {expected}")
