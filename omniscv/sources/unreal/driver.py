"""The interface of camera drivers, which aim a game's camera and take pictures; detection of stale frames;
the exposure of one camera, and a bias that matches the game's own.

Nothing reads an exposure back (supplement to the protocol reference, section 2.1), so it is set on cameras
that were spawned, which leave with the source.
"""

import contextlib
import time
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, BadReplyError, ServerRefusedError, SourceError
from omniscv.geometry import Pose
from omniscv.sources.base import Capture, Request, SceneIdentity, View
from omniscv.sources.codecs import decode, decode_png, picture_size, show_light
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
from omniscv.sources.world import EXPOSURE_LIMITS, CameraExposure, SharedExposure

Requests = Sequence[Request]

SETTLED = 3  # after so many frames in one state of the camera, the next is taken to show it
_WAITS = (0, 1, SETTLED)  # more frames to skip at each attempt; the frame of the last attempt is accepted


class StaleFrames:
    """Detects stale frames: pictures that still show what a camera saw before it moved.

    A stale picture is not marked, but it equals, byte for byte, the frame before the move (protocol
    reference, section 7.2). So frames are compared with the ones before a move, and the number of stale
    frames is learned. Modes lag independently: a fresh depth says nothing of the mask.

    Attributes:
        states: by mode, the state of the camera at its last frame: a view, or the pose and field of view
            reported.
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

        Args:
            state: of the camera, as of :attr:`states`.
            payloads: by mode, the bytes of the frames.
        """
        unchanged: set[int] = set()
        has_changed = False
        for mode, payload in payloads.items():
            if self.states.get(mode, state) == state:
                continue
            if payload == self._payloads[mode]:
                unchanged.add(hash(payload))
            else:
                has_changed = True
        doubtful = unchanged - self._lookalikes
        if doubtful and self._rejected + 1 < len(_WAITS):
            self._rejected += 1
            return False
        self._lookalikes |= doubtful
        if has_changed:  # the frames that were skipped beyond the lag were stale
            self.lag = min(SETTLED, self.lag + _WAITS[self._rejected])
        self._rejected = 0
        self.note(state, payloads)
        return True

    def note(self, state: Hashable, payloads: Mapping[str, bytes]) -> None:
        """Remember frames without comparing them; arguments as of :meth:`accepts`.

        Args:
            state: of the camera.
            payloads: by mode, the bytes of the frames.
        """
        self.states.update(dict.fromkeys(payloads, state))
        self._payloads.update(payloads)


@dataclass(frozen=True)
class CameraOptions:
    """How a camera is exposed."""

    fix_exposure: bool = False  # switch off vignette and auto exposure of the whole game
    exposure: CameraExposure | None = None  # of the spawned camera; None: `auto` where the plugin can set it
    warmup: int = 0  # frames of colour to drop after each move, where temporal effects blend them


SPAWNED = CameraOptions()
"""A camera of its own, with manual exposure where the plugin can set it."""


class CameraDriver(ABC):
    """A camera of a running game.

    Args:
        connection: to the game.
        options: its exposure.

    Attributes:
        capabilities, scene_identity, camera: complete once the driver is attached; ``camera`` is its number.
        spawned: how many cameras were spawned; another one means that the game was restarted.
    """

    table: CameraTable

    def __init__(self, connection: Connection, options: CameraOptions = SPAWNED) -> None:
        self.connection = connection
        self._options = options
        known = self.table.capabilities(connection.plugin.dialect)
        self.capabilities = replace(known, can_set_exposure=connection.supports(EXPOSURE_METHOD))
        self.stale_frames = StaleFrames()
        self.camera = 0
        self.mask_fov_deg: float | None = None  # where it is not the view's own
        self._version = ""
        self.scene_identity = SceneIdentity()
        self.color_settings: dict[str, str] = {}  # which the provenance of colours has
        self.shared_exposure = SharedExposure()  # of the cameras that record together
        self._has_normals = False  # whether a picture of them was seen to be one
        self.spawned = 0
        self._prepared = False
        self._restore: list[str] = []  # the commands that leave the game as it was
        self.one_tick = False  # whether requests that are sent together are answered in one tick
        self._aimed: View | None = None

    @abstractmethod
    def attach(self) -> None:
        """Prepare the game at a new connection, and find or spawn the camera; SourceError if it refuses."""

    def verify(self) -> None:  # noqa: B027  (most drivers have nothing to verify)
        """Raise ServerRefusedError for a camera that does not keep what is set."""

    def expose(self, requests: Requests) -> None:  # noqa: B027  (most drivers cannot)
        """Set the camera's exposure before its first colours.

        Raises ServerRefusedError if the server refuses what the options ask for, BadReplyError if a game that
        has started again lacks the camera.
        """

    @abstractmethod
    def aim(self, before: View | None, view: View) -> list[str]:
        """Return the commands that turn the camera to a ``view``.

        ``before`` is the view that it has now; None if it is not known.
        """

    @abstractmethod
    def collect(self, client: Client, requests: Requests) -> Iterator[Capture]:
        """Yield captures of the first of some ``requests``; fewer if frames may be stale.

        They are sent over a ``client``; a fault of ``RETRIED`` ends it.
        """

    def cover(self, view: View) -> tuple[View, ...]:
        """Return the views that together show one, as :meth:`omniscv.sources.base.Source.cover`."""
        return (view,)

    def check(self, request: Request) -> None:
        """Raise ArgumentError for a view higher than wide, ServerRefusedError for a mode without pictures."""
        view = request.view
        modes = sorted(self.capabilities.modes)
        if request.stops is not None and not self.capabilities.can_set_exposure:
            raise self._refused(f"a plugin that sets exposure, N2 or later, for {request.stops:g} stops")
        if view.lens is not None:
            raise ArgumentError(f"lens: expected none of a game's camera, got {view.lens}")
        if view.height > view.width:
            why = "engines take the field of view of higher ones as vertical"
            actual = f"{view.width} x {view.height}: {why}"
            raise ArgumentError(f"size: expected a view at least as wide as high, got {actual}")
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
        """Return so many (``count``) numbers that the camera reports; ``what`` is such as ``rotation``."""
        return numbers(self.connection.text(f"vget /camera/{self.camera}/{what}"), count)

    def release(self) -> None:
        """Leave the game as it was, if the connection still works."""
        client = self.connection.client
        if client is not None and not client.broken:
            with contextlib.suppress(SourceError):  # the game may have ended, and the camera with it
                list(client.stream(self._restore))

    def _prepare(self) -> None:
        """Read the game's identity, fix its exposure if requested, and make mask colours distinct."""
        self._version = name(self.connection.text(VERSION))
        replies = {SCENE: name(self.connection.text(SCENE))}
        level = name(self.connection.text(LEVEL)) if self.connection.supports(LEVEL) else ""
        if self.connection.plugin.dialect == "0.3.10":
            # It names no level, and lists the objects that the level had when it began.
            replies[OBJECTS] = self.connection.text(OBJECTS)
        elif level:
            replies[LEVEL] = level
        if not self.connection.scene:
            self.connection.scene = replies
        self.scene_identity = SceneIdentity(replies[SCENE], level)
        if self._options.fix_exposure:
            switch_vignette_off, switch_auto_exposure_off = FIX_EXPOSURE
            commands = [switch_vignette_off]
            if self._options.exposure in (
                None,
                "game",
            ):  # otherwise the cameras have an exposure of their own
                commands.append(switch_auto_exposure_off)
            self.connection.texts(commands)
        paint(self.connection, self.table.vertex_colors)

    def _capture(self, request: Request, view: View, reply: Reply) -> Capture:
        """Return the capture in a reply; BadReplyError if it is no picture of the view."""
        command = self.table.image(self.camera, request.mode)
        _, encoding = self.table.images[request.mode]
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


_YAWS_DEG = (0, 90, 180, 270)
_EDGE_PX = 64  # of the pictures
_MOST = 8  # pictures in one direction, in which automatic exposure settles
# Differences of mean brightness, in grey levels:
_SETTLED = 0.5  # of two pictures in a row
_EQUAL = 1.0  # that cannot be seen
_NEAR = 8.0  # up to which a bias matches the game's own exposure
_PRECISION = 2  # decimals of a bias


def by_hand(camera: str | int, bias: float) -> list[str]:
    """Return the commands for manual exposure of a ``camera``, without a cine model.

    It is decided by the ``bias`` alone, in stops.
    """
    settings = ("exposure_method manual", "physical_exposure 0", f"exposure_bias {bias:.8f}")
    return [f"vset /camera/{camera}/{setting}" for setting in settings]


def lumen(camera: str | int) -> list[str]:
    """Return the commands that light a camera's pictures as the game's own view in Unreal 5."""
    return [f"vset /camera/{camera}/{what} lumen" for what in ("illumination", "reflection")]


def matching_bias(connection: Connection, camera: str | int, location_cm: Sequence[float]) -> float | None:
    """Return the bias, stops, at which manual exposure is as bright as the game's; None if none comes near.

    Brightness is the mean of four directions. It grows with the bias; the tone curve need not be known. Black
    or white pictures say nothing of the bias, so none matches them.

    Args:
        connection: to the game.
        camera: a spawned one, as the game exposes it; it is left changed.
        location_cm: of the camera, in Unreal's frame.

    Raises:
        ServerRefusedError: a command was refused.
    """
    looks = _Looks(connection, camera, location_cm)
    target = float(np.mean([looks.settled(yaw) for yaw in _YAWS_DEG]))
    if not _NEAR < target < 255 - _NEAR:
        return None
    tried: dict[float, float] = {}

    def excess(bias: float) -> float:
        """Return how much brighter than the target a bias is; 0 if the difference is invisible."""
        bias = round(bias, _PRECISION)
        if bias not in tried:
            looks.read(by_hand(camera, bias))  # the next picture may still have the exposure from before
            tried[bias] = float(np.mean([looks.after_turn(yaw) for yaw in _YAWS_DEG])) - target
        return tried[bias] if abs(tried[bias]) > _EQUAL else 0.0

    near = 0.0
    far = float(-np.sign(excess(0.0)))
    while excess(near) * excess(far) > 0 and abs(far) < EXPOSURE_LIMITS[1]:
        near = far
        far = 2 * far
    if excess(near) * excess(far) < 0:
        from scipy.optimize import brentq

        brentq(excess, near, far, xtol=10**-_PRECISION)
    best = min(tried, key=lambda bias: abs(tried[bias]))
    return best if abs(tried[best]) <= _NEAR else None


class _Looks:
    """Small pictures from one place. After a turn, one that equals the last one to the byte is stale."""

    def __init__(self, connection: Connection, camera: str | int, location_cm: Sequence[float]) -> None:
        self._connection = connection
        self._at = f"/camera/{camera}"
        self._last = b""
        location = "{:.6f} {:.6f} {:.6f}".format(*location_cm)
        settings = (f"size {_EDGE_PX} {_EDGE_PX}", "fov 90.0", f"location {location}")
        connection.set([f"vset {self._at}/{setting}" for setting in settings])
        connection.set(lumen(camera))
        for _ in range(SETTLED):  # the first pictures of a camera may be garbage
            self.read([])

    def settled(self, yaw_deg: int) -> float:
        """Return the brightness in a direction once two pictures agree."""
        before = self.after_turn(yaw_deg)
        for _ in range(_MOST - 1):
            mean = self.read([])
            if abs(mean - before) < _SETTLED:
                break
            before = mean
        return mean

    def after_turn(self, yaw_deg: int) -> float:
        """Return the brightness in a direction, of the first picture that shows it."""
        before = self._last
        mean = self.read([f"vset {self._at}/rotation 0.0 {yaw_deg}.0 0.0"])
        for _ in range(SETTLED):
            if self._last != before:
                break
            mean = self.read([])
        return mean

    def read(self, settings: Sequence[str]) -> float:
        """Set something, and return the mean of the next picture, 0 to 255."""
        self._connection.set(settings)
        (self._last,) = self._connection.read([f"vget {self._at}/lit png"], _picture)
        return _mean(self._last)


def _picture(command: str, reply: Reply) -> bytes:
    """Return a reply that is a picture; BadReplyError for another one, which is then requested again."""
    if isinstance(reply, str):
        raise BadReplyError(f"expected a picture from {shown(command)}, got {shown(reply[:100])}")
    _mean(reply)
    return reply


def _mean(picture: bytes) -> float:
    """Return the mean of a PNG, which may have the size from before."""
    view = View(Pose(np.zeros(3), np.eye(3)), 90.0, *picture_size(picture))
    return float(decode_png(picture, view).mean())
