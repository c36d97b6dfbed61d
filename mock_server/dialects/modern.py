"""What the 1.x dialects M, N1 and N2 share: cameras, images and objects of the newer command set."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from mock_server import encode, pictures
from mock_server.dialects import objects
from mock_server.dialects.common import Dialect, Reply, Row, numbers, ok
from mock_server.render import ViewHits
from mock_server.rotator import through_quaternion
from mock_server.world import Camera, SceneObject

BAD_ARGUMENT = "error Argument Invalid"
NO_DATA = "error Captured data is empty"

_ENCODERS: dict[str, Callable[..., bytes]] = {"png": encode.png, "bmp": encode.bmp, "npy": encode.npy}


class Modern(Dialect):
    """The 1.x command set, as N1 has it; M and N2 say what they do otherwise."""

    no_object = "error Can not find object"
    no_camera = "error Invalid sensor id"

    def rows(self) -> list[Row]:
        return [
            ("vrun [str]", "Runs an alias", ok),
            *self.object_rows(),
            *self.plugin_rows(),
            *self.action_rows(),
            *self.run_rows(),
            ("vget /screenshot [str]", "What the window shows", self._screenshot),
            *self.camera_rows(),
        ]

    def object_rows(self) -> list[Row]:
        """Objects by name."""
        obj, at = self.with_object, "/object/[str]"
        return [
            ("vget /objects", "Names of the objects", lambda: _listed(self.world.objects)),
            ("vset /objects/spawn [str]", "Adds an object of a class", _no_class),
            ("vset /objects/spawn [str] [str]", "The same, with a name", _no_class),
            (f"vget {at}/location", "Location, cm", obj(lambda o: numbers(o.location))),
            (f"vset {at}/location [float] [float] [float]", "Moves it", obj(objects.move)),
            (f"vget {at}/rotation", "Pitch, yaw, roll", obj(lambda o: numbers(o.rotation))),
            (f"vset {at}/rotation [float] [float] [float]", "Turns it", obj(objects.turn)),
            (f"vget {at}/vertex_location", "Corners of its box, cm", obj(self._vertices)),
            (f"vget {at}/color", "Colour in the mask", obj(objects.color)),
            (f"vset {at}/color [uint] [uint] [uint]", "Sets it", obj(objects.paint)),
            (f"vget {at}/mobility", "Whether it may move", obj(lambda o: "Movable")),
            (f"vset {at}/show", "Shows it", obj(objects.show)),
            (f"vset {at}/hide", "Hides it from every mode", obj(objects.hide)),
            (f"vset {at}/destroy", "Takes it out of the world", self._destroy),
            (f"vget {at}/uclass_name", "Its class", obj(self.class_name)),
            (f"vset {at}/name [str]", "Renames it", obj(self._rename)),
            (f"vget {at}/scale", "Its scale", obj(lambda o: "1.000 1.000 1.000")),
            (f"vget {at}/bounds", "Its box, cm", obj(self._bounds)),
        ]  # fmt: skip

    def action_rows(self) -> list[Row]:
        """The game and its input."""
        return [
            ("vget /level/name", "Name of the map", lambda: self.world.scene.name),
            ("vset /action/game/pause", "Pauses", lambda: self._pause(True)),
            ("vset /action/game/resume", "Goes on", lambda: self._pause(False)),
            ("vget /action/game/is_paused", "Whether paused", lambda: str(self.world.paused).lower()),
            ("vset /action/game/level [str]", "Opens a level", ok),
            ("vset /action/input/enable", "Lets the window's keys act", ok),
            ("vset /action/input/disable", "Stops the window's keys", ok),
            ("vset /action/eyes_distance [float]", "Distance of two eyes", lambda _: "error Not Implemented"),
            ("vset /action/keyboard [str] [float]", "Presses a key", ok),
        ]

    def run_rows(self) -> list[Row]:
        """Console, actors' functions and batches."""
        return [
            *self.console_rows("vrun", 1, 6, ok),
            *self.console_rows("vexec", 2, 7, self._no_actor),
            *self.console_rows("vbp", 2, 11, self._no_actor),
            ("vbatch [uint]", "Announces requests that belong together", ok),
        ]

    def camera_rows(self) -> list[Row]:
        """Cameras, their poses and images."""
        camera, at = self.with_camera, "/camera/[uint]"
        return [
            ("vget /cameras", "Names of the cameras", lambda: _listed(c.name for c in self.world.cameras)),
            ("vset /cameras/spawn", "Adds a camera", self.world.spawn),
            (f"vget {at}/location", "Location, cm", camera(lambda c: numbers(c.location))),
            (f"vset {at}/location [float] [float] [float]", "Moves it", camera(self._move)),
            (f"vset {at}/moveto [float] [float] [float]", "Moves the player", camera(self._move_to)),
            (f"vget {at}/rotation", "Pitch, yaw, roll", camera(self._rotation)),
            (f"vset {at}/rotation [float] [float] [float]", "Turns it", camera(self._turn)),
            *(
                (f"vget {at}/{mode} [str]", f"An image: {mode}", camera(self._image_of(mode)))
                for mode in self.modes()
            ),
            *self.viewmode_rows(),
            (f"vget {at}/fov", "Field of view, degrees", camera(lambda c: f"{c.fov:f}", BAD_ARGUMENT)),
            (f"vset {at}/fov [float]", "Sets it", camera(_set_fov, BAD_ARGUMENT)),
            (f"vset {at}/size [uint] [uint]", "Sets width and height, px", camera(_set_size, BAD_ARGUMENT)),
            (f"vget {at}/size", "Width and height, px", camera(self.size, BAD_ARGUMENT)),
        ]

    def tick(self) -> None:
        """The player's camera follows the pawn in a tick of its own, one frame later; paused, it does not."""
        if not self.world.paused:
            self.world.player.tick()
            camera = self.world.cameras[0]
            camera.location, camera.rotation = self.world.player.seen(1, 1)

    def modes(self) -> tuple[str, ...]:
        """The modes of images."""
        return ("lit", "depth", "normal", "object_mask", "seg")

    def size(self, camera: Camera) -> str:
        """A camera's size."""
        return "{} {}".format(*camera.size)

    def class_name(self, o: SceneObject) -> str:
        """An object's class."""
        return "Actor"

    def _is_player(self, camera: Camera) -> bool:
        return camera is self.world.cameras[0]

    def _move(self, camera: Camera, x: float, y: float, z: float) -> str:
        if self._is_player(camera):
            self.world.player.location = (x, y, z)
        else:
            camera.location = (x, y, z)
        return "ok"

    def _move_to(self, camera: Camera, x: float, y: float, z: float) -> str:
        if not self._is_player(camera):
            return "error MoveTo only supports the player camera with id 0"
        return self._move(camera, x, y, z)

    def _turn(self, camera: Camera, pitch: float, yaw: float, roll: float) -> str:
        if self._is_player(camera):
            self.world.player.rotation = (pitch, yaw, roll)
        else:
            camera.rotation = (pitch, yaw, roll)
        return "ok"

    def _rotation(self, camera: Camera) -> str:
        if self._is_player(camera):
            return numbers(camera.rotation)
        return numbers(through_quaternion(camera.rotation))

    def _image_of(self, mode: str) -> Callable[[Camera, str], Reply]:
        mode = "object_mask" if mode == "seg" else mode
        return lambda camera, form: self._image(camera, mode, form)

    def _image(self, camera: Camera, mode: str, form: str) -> Reply:
        """An image as bytes (a format word), or in a file (a name that ends in the format)."""
        kind = _kind(form, ("npy",) if mode == "depth" else ("png", "bmp"))
        if kind is None:
            return f"error Invalid filename type, filename {form}"
        if not camera.can_see():
            return NO_DATA
        return self._sent(_ENCODERS[kind](self._pixels(self.world.look(camera), mode)), form, kind)

    def _screenshot(self, form: str) -> Reply:
        kind = _kind(form, ("png", "bmp"))
        if kind is None:
            return f"error Invalid filename type, filename {form}"
        if not self.world.cameras[0].can_see():
            return NO_DATA
        view = self.world.look(self.world.cameras[0])
        return self._sent(_ENCODERS[kind](self.viewport(view)), form, kind)

    def _sent(self, data: bytes, form: str, kind: str) -> Reply:
        if form.lower() == kind:
            return data
        self.settings.files.write(form, data)  # the plugin does not report a file that it cannot write
        return form

    def _pixels(self, view: ViewHits, mode: str) -> Any:
        if mode == "object_mask":
            return self.world.mask(view)
        if mode == "depth":
            return pictures.stored(100 * view.depth, self.settings.half_depth)
        if mode == "normal":
            return pictures.normals(view)
        # The depth and normal view modes work through post-processing, which captures show too.
        return self.viewport(view) if self.world.viewmode in ("depth", "normal") else self.world.lit(view)

    def _pause(self, paused: bool) -> str:
        self.world.paused = paused
        return "ok"

    def _no_actor(self, actor: str, *_: str) -> str:
        return f"error Can not find actor with id '{actor}'"

    def _destroy(self, name: str) -> str:
        if self.world.destroy_camera(name):
            return "ok"
        if name not in self.world.objects:
            return self.no_object.format(name)
        self.world.destroy(self.world.objects[name])
        return "ok"

    def _rename(self, o: SceneObject, name: str) -> str:
        self.world.rename(o, name)
        return "ok"

    def _bounds(self, o: SceneObject) -> str:
        return " ".join(f"{value:.2f}" for value in self.world.bounds(o).ravel())

    def _vertices(self, o: SceneObject) -> str:
        corners = itertools.product(*self.world.bounds(o).T)
        return "".join("     ".join(f"{value:.5f}" for value in corner) + "\n" for corner in corners)


def _no_class(name: str, *_: str) -> str:
    """There are no classes here to make objects of."""
    return f"error Can not find a class with name '{name}'"


def _listed(names: Any) -> str:
    return "".join(f"{name} " for name in names)


def _kind(form: str, kinds: tuple[str, ...]) -> str | None:
    """The format a word or file name asks for."""
    if form.lower() in kinds:
        return form.lower()
    return next((kind for kind in kinds if form.endswith(f".{kind}")), None)


def _set_fov(camera: Camera, fov: float) -> str:
    camera.fov = fov
    return "ok"


def _set_size(camera: Camera, width: int, height: int) -> str:
    camera.size = (width, height)
    return "ok"
