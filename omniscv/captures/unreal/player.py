"""The live source of plugin 0.3.10: the player's camera, waited for; masks from the game's window."""

from __future__ import annotations

import math
import re
import struct
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

from omniscv.captures.decode import decode
from omniscv.captures.source import Capabilities, ObjectTable
from omniscv.captures.unreal.link import Link
from omniscv.captures.unreal.live import CURES, VERSION, UnrealSource
from omniscv.captures.unreal.masks import colors, paint, shown
from omniscv.captures.unreal.session import Reply, Session
from omniscv.captures.view import Capture, Request, View
from omniscv.errors import BadReply, ServerRefused
from omniscv.geometry import Pose

_IMAGE = {
    "lit": ("vget /camera/0/lit png", "png"),
    "object_mask": ("vget /camera/0/object_mask png", "png"),
    "depth": ("vget /camera/0/depth npy", "npy ray m"),
    "normal": ("vget /camera/0/normal png", "png normal"),
}
"""By mode: the command, and the encoding of what it answers."""
_POSE = "vget /camera/0/pose"
_FOV = "vget /camera/0/horizontal_fieldofview"
_LIT = "vset /viewmode lit"
_QUIET = ("vset /action/input/disable", _LIT)
"""A click in the window would send a message that nobody asked for."""

_SETTLED = 4
"""Replies, one after the other, behind which a new pose shows: each is at least a frame later than the one
before, and rotations take two (protocol reference, section 7.2)."""
_RESTLESS = 20
"""Replies after which a pose that still changes is no pose."""
_ATTEMPTS = 3
"""How often to ask for pictures that equal the ones before the move; then the places look alike."""

_PRINTED = 6e-4
"""Poses and fields of view are printed with three decimals."""
_STRAY_CM = 0.02
"""How far a pawn may be from where it was set: what single precision leaves two kilometres out."""

_PNG_SIZE = re.compile(rb"\x89PNG\r\n\x1a\n....IHDR(.{8})", re.DOTALL)


Place = tuple[Reply, Reply]
"""Pose and field of view, as a camera reads."""


class PlayerSource(UnrealSource):
    """Captures from a UE4 editor or packaged game with plugin 0.3.10.

    There is one camera, the player's. Its pictures have the size of the plugin's settings; object masks come
    from the game's window, with its size, and the field of view of the settings. Pitch and roll end at 89.9
    degrees: captures carry the view they were taken from. After a move the pose is asked for until it rests;
    it is asked again behind the pictures, which count if nothing has moved meanwhile. The window's keys and
    mouse stay switched off.
    """

    def __init__(self, link: Link, capabilities: Capabilities, fix_exposure: bool) -> None:
        self._before: dict[str, tuple[Place, bytes]] = {}
        """By mode, the last picture, and where it was taken."""
        self._alike: set[int] = set()
        super().__init__(link, capabilities, fix_exposure)

    def objects(self) -> ObjectTable:
        return ObjectTable({name: shown(color) for name, color in colors(self._link).items()})

    def _find_camera(self) -> None:
        """Makes whatever game is there now ready, and finds out its sizes."""
        self._version, self._scene = self._link.text(VERSION), self._link.text("vget /scene/name")
        self._link.texts([*_QUIET, *(CURES if self._fix_exposure else ())])
        paint(self._link, exact=True)
        self._window_fov_deg = _fov_of_settings(self._link.text("vget /unrealcv/status"))
        *_, pose = [self._link.text(_POSE) for _ in range(_SETTLED)]
        here = pose, self._link.text(_FOV)
        self._before = {
            mode: (here, picture) for mode in _IMAGE if (picture := self._first_picture(mode)) is not None
        }
        self._link.text(_LIT)
        if "lit" not in self._before:
            raise ServerRefused(
                f"{self._link.address}: expected a picture from {_IMAGE['lit'][0]!r}, got none"
            )
        size = self._png_size(self._before["lit"][1])
        self._window = self._png_size(self._before.get("object_mask", self._before["lit"])[1])
        self._capabilities = replace(self._capabilities, modes=frozenset(self._before), image_size=size)

    def _first_picture(self, mode: str) -> bytes | None:
        """What the camera shows before it is sent anywhere; None for a mode that does not work.

        The very first picture may be garbage (protocol reference, section 7.2), so the next counts.
        """
        replies = [self._link.ask(_IMAGE[mode][0], lambda reply: reply) for _ in range(2)]
        return replies[-1] if isinstance(replies[-1], bytes) else None

    def _collect(self, session: Session, waiting: deque[Request], done: list[Capture]) -> None:
        """Moves requests from ``waiting`` to captures in ``done``, those of one view together."""
        while waiting:
            view, here = next(groupby(list(waiting), lambda request: request.view))
            place, captures = self._captured(session, view, list(here))
            for capture in captures:
                self._before[capture.mode] = (place, capture.payload)
                done.append(capture)
                waiting.popleft()

    def _captured(
        self, session: Session, view: View, requests: Sequence[Request]
    ) -> tuple[Place, list[Capture]]:
        """All modes of a view, and where the camera was."""
        modes = sorted(self._capabilities.modes)
        for request in requests:
            if request.mode not in modes:
                raise ServerRefused(
                    f"{session.address}: expected a request for {', '.join(modes[:-1])} or {modes[-1]}, "
                    f"got {request.mode}: its command is not answered by a picture"
                )
        if self._posed != view:
            self._posed = None
            self._send(session, view)
        for _ in range(_ATTEMPTS):
            place, captures = self._pictures(session, view, requests)
            late = [capture for capture in captures if self._seems_late(capture, place)]
            if not late:
                break
        self._alike.update(hash(capture.payload) for capture in late)
        self._posed = view
        return place, captures

    def _seems_late(self, capture: Capture, place: Place) -> bool:
        """Whether a picture equals, byte for byte, the one before the move, and is not known to be right so.

        Colour may be late where depth is not (protocol reference, section 7.2), so each mode is compared.
        """
        before, payload = self._before[capture.mode]
        return before != place and payload == capture.payload and hash(payload) not in self._alike

    def _send(self, session: Session, view: View) -> None:
        """Sends the camera to a view; numbers with fixed decimals, as servers parse them."""
        location, rotation = view.pose.to_unreal()
        commands = [
            f"vset /camera/0/horizontal_fieldofview {view.fov_deg:.8f}",
            "vset /camera/0/pose {:.6f} {:.6f} {:.6f} {:.8f} {:.8f} {:.8f}".format(*location, *rotation),
        ]
        for command, reply in zip(commands, session.stream(commands), strict=True):
            if reply != "ok":
                raise BadReply(f"{session.address}: expected ok from {command!r}, got {reply[:200]!r}")

    def _rest(self, session: Session) -> Reply:
        """The pose as it reads once it rests.

        Raises:
            BadReply: it does not rest.
        """
        before: Reply | None = None
        for count in range(1, _RESTLESS + 1):
            (reading,) = session.stream([_POSE])
            if count >= _SETTLED and reading == before:
                return reading
            before = reading
        raise BadReply(
            f"{session.address}: expected a camera that comes to rest, but it moves on: {before!r}; "
            "use a flying pawn, such as game mode UE4CVGameMode has"
        )

    def _pictures(
        self, session: Session, view: View, requests: Sequence[Request]
    ) -> tuple[Place, list[Capture]]:
        """Where the camera is, and pictures of a view; it rests before, meanwhile and afterwards.

        The mask is answered out of turn, so it is asked for alone; it leaves the window in its view mode.
        """
        reading = self._rest(session)
        pose = _pose_read(session, view, reading)
        replies: dict[str, Reply] = {}
        others = list(dict.fromkeys(request.mode for request in requests if request.mode != "object_mask"))
        if any(request.mode == "object_mask" for request in requests):
            (replies["object_mask"],) = session.stream([_IMAGE["object_mask"][0]])
        commands = [_LIT, *(_IMAGE[mode][0] for mode in others), _FOV, _POSE]
        restored, *pictures, fov, afterwards = session.stream(commands)
        replies.update(zip(others, pictures, strict=True))
        if restored != "ok":
            raise BadReply(f"{session.address}: expected ok from {_LIT!r}, got {restored[:200]!r}")
        if afterwards != reading:
            raise BadReply(
                f"{session.address}: expected a camera that stays at {reading!r} while it is captured, "
                f"got {afterwards!r}; does anybody play?"
            )
        window = View(pose, self._window_fov_deg, *self._window)
        actual = View(pose, _as_read(view.fov_deg, _numbers(fov, 1)[0]), *self._size)
        return (reading, fov), [
            self._capture_of(
                session, request, window if request.mode == "object_mask" else actual, replies[request.mode]
            )
            for request in requests
        ]

    def _png_size(self, payload: bytes) -> tuple[int, int]:
        """Width and height of a PNG, px."""
        found = _PNG_SIZE.match(payload)
        if found is None:
            raise BadReply(f"{self._link.address}: expected a PNG, got {payload[:80]!r}")
        width, height = struct.unpack(">II", found[1])
        if width < height:
            raise ServerRefused(
                f"{self._link.address}: expected pictures at least as wide as high, got {width} x {height}; "
                "set Width and Height in unrealcv.ini, and make the game's window as large"
            )
        return width, height

    @property
    def _size(self) -> tuple[int, int]:
        assert self._capabilities.image_size is not None
        return self._capabilities.image_size

    def _capture_of(self, session: Session, request: Request, actual: View, reply: Reply) -> Capture:
        command, encoding = _IMAGE[request.mode]
        if isinstance(reply, str):
            raise BadReply(f"{session.address}: expected a picture from {command!r}, got {reply[:200]!r}")
        pixels = decode(reply, encoding, request.mode, actual)
        return Capture(request, actual, pixels, reply, encoding, self._provenance(command))


def _pose_read(session: Session, view: View, reading: Reply) -> Pose:
    """The pose that a camera has: what it was given where that reads back, else what it reads.

    Raises:
        ServerRefused: it is somewhere else.
    """
    given = view.pose.to_unreal()
    read = _numbers(reading, 6)
    if any(abs(a - b) > _STRAY_CM for a, b in zip(given.location_cm, read[:3], strict=True)):
        raise ServerRefused(
            f"{session.address}: expected a camera at {given.location_cm} cm, but it reads {reading!r}; "
            "a pawn that falls or collides cannot be used, nor a level with a CineCameraActor"
        )
    location = [_as_read(a, b) for a, b in zip(given.location_cm, read[:3], strict=True)]
    rotation = [
        _as_read(a, a + math.remainder(b - a, 360)) for a, b in zip(given.rotation_deg, read[3:], strict=True)
    ]
    return Pose.from_unreal(location, rotation)


def _as_read(given: float, read: float) -> float:
    """A number as it was given, if that may be what is read, to three decimals."""
    return given if abs(given - read) <= _PRINTED else read


def _numbers(reply: Reply, count: int) -> list[float]:
    """Numbers, separated by spaces."""
    try:
        numbers = [float(word) for word in reply.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise BadReply(f"expected {count} numbers, got {reply[:200]!r}")
    return numbers


def _fov_of_settings(status: str) -> float:
    found = re.search(r"^FOV: (\d+(?:\.\d*)?)$", status, re.MULTILINE | re.ASCII)
    if found is None:
        raise ServerRefused(f"expected a status with a line such as 'FOV: 90.000000', got {status[:400]!r}")
    return float(found[1])
