"""The camera driver of plugin 0.3.10: the player's camera, polled until it rests; masks from the window."""

import math
import re
from collections.abc import Hashable, Iterator
from dataclasses import replace
from itertools import groupby

import numpy as np

from omniscv.arguments import shown
from omniscv.geometry import Pose
from omniscv.sources.base import Capture, View
from omniscv.sources.codecs import picture_size
from omniscv.sources.unreal import protocol
from omniscv.sources.unreal.client import Client
from omniscv.sources.unreal.driver import CameraDriver, Requests
from omniscv.sources.unreal.protocol import LEGACY, LIT_VIEW_MODE, Reply

_POSE = "vget /camera/0/pose"
_FOV = f"vget /camera/0/{LEGACY.fov}"
_POLLS = 3
"""Consecutive replies after which a new pose is visible. Each comes at least a frame after the one before;
rotations take two frames (protocol reference, section 7.2). The last two show whether the camera rests."""
_MAX_POLLS = 20  # replies after which a pose that still changes counts as moving
_VERTICAL = float(np.sin(np.radians(89.9)))  # the plugin limits pitch to 89.9 degrees
_PRINTED = 6e-4  # poses and fields of view are printed with three decimals
_TRIED_DEG = 60.0  # a field of view in which the window shows less than in most
_STRAY_CM = 0.02  # of a pawn from where it was set: single precision, two kilometres from the origin


class LegacyDriver(CameraDriver):
    """Drives the player's camera, the only one.

    Its pictures have the size of the plugin's settings; object masks the window's, with the field of view of
    the settings, or the camera's where the level holds a CameraActor. Pitch and roll are limited to 89.9
    degrees: captures carry the view they were taken from. After a move the pose is polled until it rests, and
    read again after the pictures, which count only if nothing has moved. The window's keys and mouse stay
    switched off.
    """

    table = LEGACY

    def attach(self) -> None:
        self.forget()
        # A click in the window would send a message that belongs to no request.
        self.connection.texts(["vset /action/input/disable", LIT_VIEW_MODE])
        status = self.connection.text("vget /unrealcv/status")
        settings = re.search(r"^FOV: (\d{1,3}(?:\.\d*)?)$", status, re.MULTILINE | re.ASCII)
        if settings is None:
            raise self._refused(f"a status with a line such as 'FOV: 90.000000', got {shown(status)}")
        self.mask_fov_deg = protocol.fov(settings[1])
        for _ in range(_POLLS):
            pose = self.connection.text(_POSE)
        fov = self.connection.text(_FOV)
        player = protocol.numbers(pose, 6)
        fov_deg = protocol.fov(fov)
        if not self._restore:
            self._restore = [
                f"vset /camera/0/{LEGACY.fov} {fov_deg:.3f}",
                f"vset /camera/0/pose {' '.join(f'{number:.3f}' for number in player)}",
                LIT_VIEW_MODE,
            ]
        pictures: dict[str, bytes] = {}
        for mode in self.table.images:
            if picture := self._first_picture(mode):
                pictures[mode] = picture
        self.stale_frames.note((pose, fov), pictures)
        if "object_mask" in pictures and self._window_follows(fov_deg):
            self.mask_fov_deg = None
        self.connection.text(LIT_VIEW_MODE)
        if "lit" not in pictures:
            raise self._refused(f"a picture from {LEGACY.image(0, 'lit')!r}, got none")
        self._size = self._checked_size(pictures["lit"])
        self._window = self._checked_size(pictures.get("object_mask", pictures["lit"]))
        self.capabilities = replace(self.capabilities, modes=frozenset(pictures), image_size=self._size)
        self._prepare()  # last: a game that has started again in between shows other mask colours

    def cover(self, view: View) -> tuple[View, ...]:
        # Where the plugin limits pitch, the picture is tilted and misses a sliver on one side. The view that
        # is turned by half a turn about its axis is tilted to the other side.
        if abs(view.pose.R_w_c[2, 2]) < _VERTICAL:
            return (view,)
        turned = Pose(view.pose.position, view.pose.rotation @ np.diag([-1.0, -1.0, 1.0]))
        return (view, replace(view, pose=turned))

    def aim(self, before: View | None, view: View) -> list[str]:
        """Return the commands that set a ``view``, whatever ``before``, with fixed decimals."""
        location, rotation = view.pose.to_unreal()
        pose = "{:.6f} {:.6f} {:.6f} {:.8f} {:.8f} {:.8f}".format(*location, *rotation)
        return [f"vset /camera/0/{LEGACY.fov} {view.fov_deg:.8f}", f"vset /camera/0/pose {pose}"]

    def collect(self, client: Client, requests: Requests) -> Iterator[Capture]:
        """Yield captures of all ``requests``, those of a view together, over a ``client``."""
        for (view, _), group in groupby(requests, lambda request: (request.view, request.again)):
            requests_of_view = list(group)
            if self._aimed != view:
                self._aimed = None
                commands = self.aim(None, view)
                for command, reply in zip(commands, client.stream(commands), strict=True):
                    self._expect("ok", command, reply)
            fresh = False
            while not fresh:
                state, captures = self._pictures(client, view, requests_of_view)
                frames = {capture.mode: capture.payload or b"" for capture in captures}
                # Colour may be stale where depth is not (protocol reference, section 7.2).
                fresh = self.stale_frames.accepts(state, frames)
            self._aimed = view
            yield from captures

    def _window_follows(self, fov_deg: float) -> bool:
        """Return whether masks have the camera's field of view: they change with it, and back again."""
        other = _TRIED_DEG if abs(fov_deg - _TRIED_DEG) > 1 else _TRIED_DEG / 2
        masks = []
        for angle in (fov_deg, other, fov_deg):
            self.connection.set([f"vset /camera/0/{LEGACY.fov} {angle:.3f}"])
            masks.append(self._first_picture("object_mask"))
        return masks[0] == masks[2] != masks[1]

    def _first_picture(self, mode: str) -> bytes | None:
        """Return what the camera shows before it is moved; None for a mode that does not work."""
        command = LEGACY.image(0, mode)
        for _ in range(2):  # the very first may be garbage (protocol reference, section 7.2)
            (reply,) = self.connection.read([command], lambda _, reply: reply)
        return reply if isinstance(reply, bytes) else None

    def _resting_pose(self, client: Client) -> Reply:
        """Return the pose as it reads once it rests; BadReplyError if it does not."""
        before: Reply | None = None
        for count in range(1, _MAX_POLLS + 1):
            (reading,) = client.stream([_POSE])
            if count >= _POLLS and reading == before:
                return reading
            before = reading
        moving = f"it still moves: {_excerpt(before)}; use a flying pawn (UE4CVGameMode)"
        raise self._bad_reply(f"a camera that comes to rest, but {moving}")

    def _pictures(self, client: Client, view: View, requests: Requests) -> tuple[Hashable, list[Capture]]:
        """Return what the camera at rest reports, and captures. Masks, out of order, come alone."""
        reading = self._resting_pose(client)
        pose = self._actual_pose(view, reading)
        pictures: dict[str, Reply] = {}
        modes = list(dict.fromkeys(request.mode for request in requests))
        if "object_mask" in modes:
            modes.remove("object_mask")
            (pictures["object_mask"],) = client.stream([LEGACY.image(0, "object_mask")])
        commands = [LIT_VIEW_MODE, *(LEGACY.image(0, mode) for mode in modes), _FOV, _POSE]
        restored, *images, fov, afterwards = client.stream(commands)
        pictures.update(zip(modes, images, strict=True))
        self._expect("ok", LIT_VIEW_MODE, restored)
        if afterwards != reading:
            actual = f"{_excerpt(afterwards)}; is a player controlling the pawn?"
            raise self._bad_reply(
                f"a camera that stays at {_excerpt(reading)} while it captures, got {actual}"
            )
        window = View(pose, self.mask_fov_deg or view.fov_deg, *self._window)
        fov_deg = protocol.fov(fov)
        if abs(fov_deg - view.fov_deg) <= _PRINTED:
            fov_deg = view.fov_deg
        camera = View(pose, fov_deg, *self._size)
        captures = []
        for request in requests:
            captured = window if request.mode == "object_mask" else camera
            captures.append(self._capture(request, captured, pictures[request.mode]))
        return (reading, fov), captures

    def _checked_size(self, payload: bytes) -> tuple[int, int]:
        width, height = picture_size(payload)
        if width < height:
            advice = "set Width and Height in unrealcv.ini, and make the game's window as large"
            raise self._refused(f"pictures at least as wide as high, got {width} x {height}; {advice}")
        return width, height

    def _actual_pose(self, view: View, reading: Reply) -> Pose:
        """Return the pose that was set where it reads back, else the reading; refuse a pose far away."""
        location_cm, rotation_deg = view.pose.to_unreal()
        target = np.array([*location_cm, *rotation_deg])
        read = np.array(protocol.numbers(reading, 6))
        for index in (3, 4, 5):  # angles, as near to those that were set as turns allow
            read[index] = target[index] + math.remainder(read[index] - target[index], 360)
        off = np.abs(target - read)
        if off[:3].max() > _STRAY_CM:
            why = "a pawn that falls or collides cannot be used, nor a level with a CineCameraActor"
            raise self._refused(f"a camera at {location_cm} cm, got {_excerpt(reading)}; {why}")
        actual = np.where(off <= _PRINTED, target, read)
        return Pose.from_unreal(actual[:3], actual[3:])


def _excerpt(reply: Reply | None) -> str:
    return shown(reply[:100] if reply else reply)
