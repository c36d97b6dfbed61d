"""Plugin 0.3.10 (columns L of the protocol reference)."""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import numpy as np

from mock_server import pixels
from mock_server.dialects.common import (
    THREE,
    Dialect,
    Later,
    Reply,
    Row,
    color,
    moves,
    numbers,
    ok,
    paint,
    reads,
    sets,
)
from mock_server.objects import Triple, axes
from mock_server.world import Camera, World

_Form = Literal["png", "npy", "exr"]
_CAPTURED = ("lit", "depth", "normal")
_UNMOVED = "error Failed to move object {}"
_LATE = 1
"""Frames by which objects in images are late: the next frame is being rendered."""

_FILE_FRAMES = 2
"""Frames that a file command waits for the pose."""


class Plugin0310(Dialect):
    """One pawn, whose view is captured every frame; requests read the last finished capture."""

    lag = (1, 2)  # one frame is being rendered, and rotations take another
    follows_while_paused = True
    _eyes_cm = 40.0

    def begin(self, world: World) -> None:
        if self.settings.right_eye:
            world.cameras.append(Camera("RightEye", world.player.location, size=self.settings.size))
        super().begin(world)

    def rows(self) -> list[Row]:
        obj = self.with_object
        at = "/object/[str]"
        unpainted = "error Object {} not exist"
        camera = self.with_camera
        cam = "/camera/[uint]"
        player = self.world.player
        image = f"vget {cam}"
        npy = partial(self._data, "npy")
        sets_eyes = partial(setattr, self, "_eyes_cm")
        return [
            ("vrun [str]", "Runs an alias", ok),
            ("vget /objects", "Names of the objects", lambda: " ".join(self.world.objects)),
            (f"vget {at}/color", "Colour in the mask", obj(color, unpainted)),
            (f"vset {at}/color [uint] [uint] [uint]", "Sets it", obj(paint, unpainted)),
            (f"vget {at}/name", "Its name", obj(lambda actor: actor.name)),
            (f"vget {at}/location", "Location, cm", obj(reads("location", "{:.2f}"))),
            (f"vget {at}/rotation", "Pitch, yaw, roll", obj(reads("rotation", "{:.2f}"))),
            (f"vset {at}/location {THREE}", "Moves it", obj(moves("location", _UNMOVED))),
            (f"vset {at}/rotation {THREE}", "Turns it", obj(moves("rotation"))),
            (f"vget {at}/mobility", "Whether it may move", obj(lambda actor: actor.mobility)),
            (f"vset {at}/show", "Shows it", obj(sets("hidden", False))),
            (f"vset {at}/hide", "Hides it from every mode", obj(sets("hidden", True))),
            (f"{image}/[str]", "An image of a mode, in a file", self._to_file),
            (f"{image}/[str] [str]", "An image of a mode, in a file of that name", self._to_file),
            (f"{image}/lit", "A lit image, in a file", lambda i: self._to_file(i, "lit")),
            (f"{image}/lit [str]", "The same, of that name", lambda i, n: self._to_file(i, "lit", n)),
            (f"{image}/object_mask", "The mask in the window, in a file", self._window_mask),
            (f"{image}/object_mask [str]", "The mask, as png or in a file", self._window_mask),
            (f"{image}/screenshot", "The window, in a file", lambda _: self._saved(self.window_png)),
            (f"vget {cam}/location", "Location, cm", camera(lambda c: numbers(self._location(c)))),
            (f"vget {cam}/rotation", "Pitch, yaw, roll", lambda _: numbers(player.rotation)),
            (f"vget {cam}/pose", "Both", lambda _: f"{numbers(player.location)} {numbers(player.rotation)}"),
            (f"vset {cam}/location {THREE}", "Moves the pawn", lambda _, *xyz: self._pose(xyz)),
            (f"vset {cam}/rotation {THREE}", "Turns it", lambda _, *turn: self._pose((), turn)),
            (f"vset {cam}/pose {THREE} {THREE}", "Both", lambda _, *p: self._pose(p[:3], p[3:])),
            (f"vget {cam}/horizontal_fieldofview", "Degrees", camera(lambda c: f"{c.fov:.3f}")),
            (f"vset {cam}/horizontal_fieldofview [float]", "Sets it", self._set_fov),
            (f"vset {cam}/moveto {THREE}", "Sweeps it", lambda _, *xyz: self._pose(self.world.swept(xyz))),
            (f"vget {cam}/proj_matrix", "Projection", lambda _: "error Argument Invalid"),
            *self.viewmode_rows(),
            ("vget /actor/location", "Location of the pawn, cm", lambda: numbers(player.location)),
            ("vget /actor/rotation", "Its rotation", lambda: numbers(player.rotation)),
            *(self._png_row(mode) for mode in _CAPTURED),
            (f"{image}/lit npy", "lit as NPY", npy("lit")),
            (f"{image}/depth npy", "Distance along the ray, metres", npy("depth")),
            # Registered, but the plugin has no such modes: no data, which becomes ok.
            (f"{image}/plane_depth npy", "Planar depth", ok),
            (f"{image}/vis_depth npy", "Depth as a picture", ok),
            (f"{image}/normal npy", "normal as NPY", npy("normal")),
            (f"{image}/lit_depth_normal npy", "All three in one reply", npy(*_CAPTURED)),
            *self.plugin_rows(echo=lambda word: Later(1, lambda: word)),
            ("vset /action/game/pause", "Pauses, or goes on", self._pause),
            ("vset /action/game/level [str]", "Opens a level", self.open_level),
            ("vset /action/input/enable", "Lets the window's keys act", ok),
            ("vset /action/input/disable", "Stops the window's keys", ok),
            ("vset /action/eyes_distance [float]", "Of two eyes, cm", sets_eyes),
            ("vset /action/keyboard [str] [float]", "Presses a key", self.press),
            *self.console_rows("vrun", 1, 3, self.console),
            *self.console_rows("vexec", 2, 5, self.run_function),
        ]

    def _png_row(self, mode: str) -> Row:
        return (f"vget /camera/[uint]/{mode} png", f"{mode} as PNG", self._data("png", mode))

    def malformed(self, payload: bytes) -> bytes:
        return b"error: Malformat raw message '%b'" % payload.partition(b"\0")[0]

    def _location(self, camera: Camera) -> Triple:
        return self.world.player.location if camera is self.world.cameras[0] else camera.location

    def _pause(self) -> None:
        self.world.paused = not self.world.paused

    def _pose(self, location: Any, rotation: Any = ()) -> None:
        """Set the pawn's location (cm) and rotation (degrees); empty ones stay as they are."""
        player = self.world.player
        if self.world.faults.strike("ignore-pose"):
            return
        if location:
            player.location = location
        if rotation:
            player.rotation = rotation

    def tick(self) -> None:
        super().tick()
        if self.settings.right_eye:
            left, right = self.world.cameras
            x, y, z = (left.location + int(self._eyes_cm) * axes(left.rotation)[:, 1]).tolist()
            right.location = (x, y, z)
            right.rotation = left.rotation
            right.fov = left.fov

    def _set_fov(self, index: int, fov: float) -> Reply:
        if index > 0:
            return "error Setting field of view is only supported for camera 0"
        self.world.cameras[0].fov = fov
        return None

    def _data(self, form: _Form, *modes: str) -> Callable[..., Reply]:
        """Return a handler that replies images of modes; no data, as of a missing camera, becomes ok."""
        missing = "error Invalid camera id {}" if form == "png" else "ok"

        def data(camera: Camera) -> bytes:
            return b"".join(self._encoded(camera, mode, form) for mode in modes)

        return self.with_camera(data, missing)

    def _encoded(self, camera: Camera, mode: str, form: _Form) -> bytes:
        """Return an image's bytes; empty if the camera has no pixels."""
        if not camera.has_pixels():
            return b""
        view = self.world.capture(camera, _LATE, mode)
        if mode == "depth":
            distance = self.world.depth(view, along_ray=True)
            if form == "png":
                return pixels.png(pixels.rescaled(distance))
            depth = pixels.stored(distance, form == "exr" or self.settings.depth == "half")
            return pixels.npy(depth) if form == "npy" else pixels.exr(depth[..., None])
        rgb = self.world.image(view, mode)
        if form == "png":
            return pixels.png(rgb)
        if form == "exr":
            return pixels.exr(rgb.astype(np.float32) / np.float32(255))
        if mode == "lit":
            alpha = np.full_like(rgb[..., :1], 255)
            return pixels.npy(np.dstack([rgb, alpha]))
        return pixels.npy(rgb)

    def _to_file(self, index: int, mode: str, name: str = "") -> Reply:
        """Capture into a file, two frames from now."""
        if mode not in _CAPTURED:
            return f"error Unrecognized capture mode {mode}"
        if index >= len(self.world.cameras):
            return f"error Invalid camera id {index}"
        if mode == "lit":
            self.world.viewmode = "lit"
        ending = name.lower()[-4:]
        camera = self.world.cameras[index]
        if name and ending not in (".png", ".exr"):
            return self._saved(bytes, name)
        form: _Form = "exr" if ending == ".exr" else "png"
        return self._saved(lambda: self._encoded(camera, mode, form), name)

    def _window_mask(self, _: int, name: str = "") -> Reply:
        """Capture the mask from the window, as PNG; the window stays in that view mode."""
        if self.world.faults.strike("refuse-mask"):
            return "error Fail to capture screen"
        self.world.viewmode = "object_mask"
        return Later(_FILE_FRAMES, self.window_png) if name == "png" else self._saved(self.window_png, name)

    def window(self, times: int = 1) -> Camera:
        """Return the window's camera; its field of view is the first, or a CameraActor's."""
        pose = self.world.player.delayed(0, 0)
        size = super().window(times).size
        fov = self.world.cameras[0].fov if self.settings.camera_actor else self.settings.fov_deg
        return Camera("viewport", *pose, fov, size)

    def _saved(self, make: Callable[[], bytes], name: str = "") -> Later:
        """Write a file later, and reply its path, whether it was written or not."""
        if not name:
            name = self.files.next_name()

        def save() -> str:
            if data := make():
                self.files.write(name, data)
            return self.files.named(name)

        return Later(_FILE_FRAMES, save)
