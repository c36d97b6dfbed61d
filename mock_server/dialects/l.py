"""Dialect L: plugin 0.3.10 (columns L of the protocol reference)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mock_server import encode, pictures
from mock_server.dialects import objects
from mock_server.dialects.common import Dialect, Later, Reply, Row, Settings, numbers, ok
from mock_server.rotator import MIRROR
from mock_server.world import Camera, World

_CAPTURED = ("lit", "depth", "normal")
_FILE_FRAMES = 2
"""Frames that a file command waits, so that the pose has arrived."""
_LOCATION_LAG, _ROTATION_LAG = 1, 2
"""Frames by which captures are behind: one is being rendered, and rotations take another."""


class L(Dialect):
    """One pawn; its view is captured every frame, and read as it was last finished."""

    def __init__(self, world: World, settings: Settings) -> None:
        super().__init__(world, settings)
        self._camera = Camera("viewport", world.player.location, fov=settings.fov_deg, size=settings.window)

    def rows(self) -> list[Row]:
        return [
            ("vrun [str]", "Runs an alias", ok),
            *self._object_rows(),
            *self._file_rows(),
            *self._pose_rows(),
            *self.viewmode_rows(),
            ("vget /actor/location", "Location of the pawn, cm", lambda: numbers(self.world.player.location)),
            ("vget /actor/rotation", "Its rotation", lambda: numbers(self.world.player.rotation)),
            *self._binary_rows(),
            *self.plugin_rows(),
            *self._action_rows(),
            *self.console_rows("vrun", 1, 3, ok),
            *self.console_rows("vexec", 2, 5, lambda who, *_: f"error Can not find actor with id '{who}'"),
        ]

    def tick(self) -> None:
        self.world.player.tick()
        camera = self.world.cameras[0]
        camera.location, camera.rotation = self.world.player.seen(_LOCATION_LAG, _ROTATION_LAG)

    def malformed(self, payload: bytes) -> bytes:
        return b"error: Malformat raw message '%b'" % payload.partition(b"\0")[0]

    def echo(self, word: str) -> Reply:
        return Later(1, lambda: word)

    def _object_rows(self) -> list[Row]:
        obj, at = self.with_object, "/object/[str]"
        unpainted = "error Object {} not exist"
        return [
            ("vget /objects", "Names of the objects", lambda: " ".join(self.world.objects)),
            (f"vget {at}/color", "Colour in the mask", obj(objects.color, unpainted)),
            (f"vset {at}/color [uint] [uint] [uint]", "Sets it", obj(objects.paint, unpainted)),
            (f"vget {at}/name", "Its name", obj(lambda o: o.name)),
            (f"vget {at}/location", "Location, cm", obj(lambda o: numbers(o.location, "{:.2f}"))),
            (f"vget {at}/rotation", "Pitch, yaw, roll", obj(lambda o: numbers(o.rotation, "{:.2f}"))),
            (f"vset {at}/location [float] [float] [float]", "Moves it", obj(objects.move)),
            (f"vset {at}/rotation [float] [float] [float]", "Turns it", obj(objects.turn)),
            (f"vget {at}/mobility", "Whether it may move", obj(lambda o: "Movable")),
            (f"vset {at}/show", "Shows it", obj(objects.show)),
            (f"vset {at}/hide", "Hides it from every mode", obj(objects.hide)),
        ]

    def _file_rows(self) -> list[Row]:
        at = "vget /camera/[uint]"
        return [
            (f"{at}/[str]", "An image of a mode, in a file", lambda i, mode: self._to_file(i, mode, "")),
            (f"{at}/[str] [str]", "An image of a mode, in a file of that name", self._to_file),
            (f"{at}/lit", "A lit image, in a file", lambda i: self._to_file(i, "lit", "")),
            (f"{at}/lit [str]", "The same, of that name", lambda i, n: self._to_file(i, "lit", n)),
            (f"{at}/object_mask", "The mask in the window, in a file", lambda _: self._window_mask("")),
            (f"{at}/object_mask [str]", "The mask, as png or in a file", lambda _, n: self._window_mask(n)),
            (f"{at}/screenshot", "The window, in a file", lambda _: self._window_file("")),
        ]  # fmt: skip

    def _pose_rows(self) -> list[Row]:
        camera, player, at = self.with_camera, self.world.player, "/camera/[uint]"
        three = "[float] [float] [float]"
        return [
            (f"vget {at}/location", "Location, cm", camera(lambda _: numbers(player.location))),
            (f"vget {at}/rotation", "Pitch, yaw, roll", lambda _: numbers(player.rotation)),
            (f"vget {at}/pose", "Both", lambda _: f"{numbers(player.location)} {numbers(player.rotation)}"),
            (f"vset {at}/location {three}", "Moves the pawn", lambda _, *xyz: self._pose(xyz)),
            (f"vset {at}/rotation {three}", "Turns it", lambda _, *turn: self._pose((), turn)),
            (f"vset {at}/pose {three} {three}", "Both", lambda _, *p: self._pose(p[:3], p[3:])),
            (f"vget {at}/horizontal_fieldofview", "Degrees", camera(lambda c: f"{c.fov:.3f}")),
            (f"vset {at}/horizontal_fieldofview [float]", "Sets it", self._set_fov),
            (f"vset {at}/moveto {three}", "Moves the pawn up to what is in the way", self._move_to),
            (f"vget {at}/proj_matrix", "Projection", lambda _: "error Argument Invalid"),
        ]

    def _binary_rows(self) -> list[Row]:
        at = "vget /camera/[uint]"
        return [
            *((f"{at}/{mode} png", f"{mode} as PNG", self._png_of(mode)) for mode in _CAPTURED),
            (f"{at}/lit npy", "lit as NPY", self._npy_of("lit")),
            (f"{at}/depth npy", "Distance along the ray, metres", self._npy_of("depth")),
            # Registered, but the plugin has no such modes: no data, which becomes ok.
            (f"{at}/plane_depth npy", "Planar depth", ok),
            (f"{at}/vis_depth npy", "Depth as a picture", ok),
            (f"{at}/normal npy", "normal as NPY", self._npy_of("normal")),
            (f"{at}/lit_depth_normal npy", "All three in one reply", self._npy_of("lit", "depth", "normal")),
        ]

    def _action_rows(self) -> list[Row]:
        return [
            ("vset /action/game/pause", "Pauses, or goes on", self._toggle_pause),
            ("vset /action/game/level [str]", "Opens a level", ok),
            ("vset /action/input/enable", "Lets the window's keys act", ok),
            ("vset /action/input/disable", "Stops the window's keys", ok),
            ("vset /action/keyboard [str] [float]", "Presses a key", ok),
        ]

    def _pose(self, location: Any, rotation: Any = ()) -> str:
        if location:
            self.world.player.location = location
        if rotation:
            self.world.player.rotation = rotation
        return "ok"

    def _move_to(self, _: int, x: float, y: float, z: float) -> str:
        """A straight way, ended by the first surface on it."""
        start, goal = np.array(self.world.player.location), np.array([x, y, z])
        length = float(np.linalg.norm(goal - start))
        if length > 0:
            free = 100 * float(
                self.world.placed().trace(MIRROR @ start / 100, MIRROR @ (goal - start)).distance
            )
            x, y, z = (start + min(1.0, free / length) * (goal - start)).tolist()
        return self._pose((x, y, z))

    def _set_fov(self, index: int, fov: float) -> str:
        if index > 0:
            return "error Setting field of view is only supported for camera 0"
        self.world.cameras[0].fov = fov
        return "ok"

    def _toggle_pause(self) -> str:
        self.world.paused = not self.world.paused
        return "ok"

    def _png_of(self, mode: str) -> Callable[[int], Reply]:
        return self.with_camera(lambda _: self._png(mode), "error Invalid camera id {}")

    def _npy_of(self, *modes: str) -> Callable[[int], Reply]:
        # A camera that is not there gives no data, which becomes the text ok.
        return self.with_camera(lambda _: b"".join(map(self._npy, modes)), "ok")

    def _png(self, mode: str) -> bytes:
        camera = self.world.cameras[0]
        if not camera.can_see():
            return b""
        view = self.world.look(camera)
        if mode == "lit":
            return encode.png(self.world.lit(view))
        if mode == "normal":
            return encode.png(pictures.normals(view))
        return encode.png(pictures.rescaled(view.distance))

    def _npy(self, mode: str) -> bytes:
        camera = self.world.cameras[0]
        if not camera.can_see():
            return b""
        view = self.world.look(camera)
        if mode == "lit":
            lit = self.world.lit(view)
            return encode.npy(np.dstack([lit, np.full_like(lit[..., :1], 255)]))
        if mode == "normal":
            return encode.npy(pictures.normals(view))
        return encode.npy(pictures.stored(view.distance, self.settings.half_depth))

    def _to_file(self, index: int, mode: str, name: str) -> Reply:
        """A capture in a file, two frames from now."""
        if mode not in _CAPTURED:
            return f"error Unrecognized capture mode {mode}"
        if index > 0:
            return f"error Invalid camera id {index}"
        if mode == "lit":
            self.world.viewmode = "lit"
        return self._saved(name, lambda: self._exr(mode) if name.endswith(".exr") else self._png(mode))

    def _exr(self, mode: str) -> bytes:
        camera = self.world.cameras[0]
        if not camera.can_see():
            return b""
        view = self.world.look(camera)
        if mode == "depth":
            return encode.exr(pictures.stored(view.distance, half=True)[..., None])
        picture = self.world.lit(view) if mode == "lit" else pictures.normals(view)
        return encode.exr(picture.astype(np.float32) / np.float32(255))

    def _window_mask(self, name: str) -> Reply:
        """The mask comes from the window, which stays in that view mode."""
        self.world.viewmode = "object_mask"
        return Later(_FILE_FRAMES, self._window) if name == "png" else self._window_file(name)

    def _window_file(self, name: str) -> Reply:
        # Whatever the name's ending, the window is written as PNG.
        return self._saved(name, self._window, endings=("",))

    def _window(self) -> bytes:
        """PNG of the window: at its own size, and with the field of view it started with."""
        self._camera.location, self._camera.rotation = self.world.player.seen(0, 0)
        shown = self.viewport(self.world.look(self._camera))
        if self.world.viewmode == "object_mask":
            shown = pictures.through_vertex_colors(shown)
        return encode.png(shown)

    def _saved(
        self, name: str, make: Callable[[], bytes], endings: tuple[str, ...] = (".png", ".exr")
    ) -> Later:
        """Writes a file later, and replies the path, whether or not there is such a file."""
        name = name or self.settings.files.next_name()

        def save() -> str:
            data = make() if name.endswith(endings) else b""
            if data:
                self.settings.files.write(name, data)
            return f"{self.settings.files.path}/{name}"

        return Later(_FILE_FRAMES, save)
