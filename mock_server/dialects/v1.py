"""The 1.x commands: plugin 1.0.1 (dialect N1), the branches before (M), branch 5.2 (N2), plugin 1.1.0 (N3).

Plugin 1.1.0 lists its commands, and has cine cameras; on Windows it also shares memory.
"""

import re
from collections.abc import Callable
from functools import partial
from typing import Any

from mock_server import cine as cine_model
from mock_server import pixels
from mock_server.dialects.common import (
    THREE,
    Dialect,
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
from mock_server.objects import SceneObject, Triple, through_quaternion
from mock_server.world import Camera

BAD_ARGUMENT = "error Argument Invalid"
MODES = ("lit", "depth", "normal", "object_mask", "seg")
_ENCODERS = {"png": pixels.png, "bmp": pixels.bmp}

_LIT_SOURCES = ("ftc_hdr", "fc_hdr", "sc_hdr", "scna_hdr", "ldr",
                "base", "color_depth", "scene_depth", "device_depth", "normal")  # fmt: skip
_CHOICES = {
    "lit_source": ("lit source", _LIT_SOURCES),
    "reflection": ("reflection method", ("none", "lumen", "screen_space")),
    "illumination": ("global illumination method", ("none", "lumen", "screen_space", "plugin")),
}
_PROJECTIONS = ("perspective", "orthographic")
_NUMBERS = {
    "auto_speed": "[float] [float]",
    "auto_brightness": "[float] [float]",
    "physical_exposure": "[uint]",
    "motion_blur": "[float] [float] [float] [uint]",
    "focal": "[float] [float]",
}
_NO_WINDOWS = "error Windows shared memory transport is only available on Windows"
_BONES = ("", " [str]", " [str] [str]")
"""What may follow the command for bones: nothing, names, names and a space."""


class Plugin1(Dialect):
    """Plugin 1.0.1 of branch 4.27-stable, dialect N1."""

    version = "1.0.1"
    no_object = "error Can not find object"
    no_camera = "error Invalid sensor id"
    request = re.compile(rb"(?<!\d)(\d+):(.*)")
    has_unix = True
    taken = "object exsit"

    def rows(self) -> list[Row]:
        obj = self.with_object
        at = "/object/[str]"
        camera = self.with_camera
        cam = "/camera/[uint]"
        script = "vget /persistent_level/level_script_actor/id"
        strict = partial(camera, missing=BAD_ARGUMENT)
        return [
            ("vrun [str]", "Runs an alias", ok),
            ("vget /objects", "Names of the objects", self._object_names),
            ("vset /objects/spawn_cube", "Adds a cube of one metre", self._spawn_cube),
            ("vset /objects/spawn_cube [str]", "The same, with a name", self._spawn_cube),
            ("vset /objects/spawn [str]", "Adds an object of a class", self._spawn),
            ("vset /objects/spawn [str] [str]", "The same, with a name", self._spawn),
            (f"vget {at}/location", "Location, cm", obj(reads("location"))),
            (f"vset {at}/location {THREE}", "Moves it", obj(moves("location"))),
            (f"vget {at}/rotation", "Pitch, yaw, roll", obj(reads("rotation"))),
            (f"vset {at}/rotation {THREE}", "Turns it", obj(moves("rotation"))),
            (f"vget {at}/vertex_location", "Points of its mesh, cm", obj(self._vertices)),
            (f"vget {at}/color", "Colour in the mask", obj(color)),
            (f"vset {at}/color [uint] [uint] [uint]", "Sets it", obj(paint)),
            (f"vget {at}/mobility", "Whether it may move", obj(lambda actor: actor.mobility)),
            (f"vset {at}/show", "Shows it", obj(sets("hidden", False))),
            (f"vset {at}/hide", "Hides it from every mode", obj(sets("hidden", True))),
            (f"vset {at}/destroy", "Takes it out of the world", self._destroy),
            (f"vget {at}/uclass_name", "Its class", obj(self._class_of)),
            (f"vset {at}/name [str]", "Renames it", obj(self._rename)),
            (f"vget {at}/scale", "Its scale", obj(reads("scale"))),
            (f"vset {at}/scale {THREE}", "Sets it", obj(self.world.placed_objects.set_scale)),
            (f"vget {at}/bounds", "Its box, cm", obj(self._bounds)),
            *self.plugin_rows(),
            ("vget /level/name", "Name of the map", lambda: self.world.scene.name),
            ("vset /action/game/pause", "Pauses", lambda: sets("paused", True)(self.world)),
            ("vset /action/game/resume", "Goes on", lambda: sets("paused", False)(self.world)),
            ("vget /action/game/is_paused", "Whether paused", lambda: str(self.world.paused).lower()),
            ("vset /action/game/level [str]", "Opens a level", self.open_level),
            ("vset /action/input/enable", "Lets the window's keys act", ok),
            ("vset /action/input/disable", "Stops the window's keys", ok),
            ("vset /action/eyes_distance [float]", "Distance of two eyes", lambda _: "error Not Implemented"),
            ("vset /action/keyboard [str] [float]", "Presses a key", self.press),
            *self.console_rows("vrun", 1, 6, self.console),
            *self.console_rows("vexec", 2, 7, self.run_function),
            *self.console_rows("vbp", 2, 11, self._run_blueprint),
            ("vget /persistent_level/id", "Name of the level", lambda: "PersistentLevel"),
            (script, "Its script", lambda: f"{self.world.scene.name}_C_0"),
            ("vget /screenshot [str]", "The window", self._screenshot),
            ("vget /cameras", "Their names", self._camera_names),
            ("vset /cameras/spawn", "Adds a camera", self.world.spawn),
            (f"vget {cam}/location", "Location, cm", camera(reads("location"))),
            (f"vset {cam}/location {THREE}", "Moves it", camera(partial(self._set_pose, "location"))),
            (f"vset {cam}/moveto {THREE}", "Moves the player", camera(self._move_to)),
            (f"vget {cam}/rotation", "Pitch, yaw, roll", camera(self._rotation)),
            (f"vset {cam}/rotation {THREE}", "Turns it", camera(partial(self._set_pose, "rotation"))),
            *(self._image_row(mode) for mode in MODES),
            *self.viewmode_rows(),
            (f"vget {cam}/fov", "Field of view, degrees", strict(lambda c: f"{c.fov:f}")),
            (f"vset {cam}/fov [float]", "Sets it", strict(sets("fov"))),
            (f"vset {cam}/ortho_width [float]", "Sets the width of parallel rays, cm", camera(ok)),
            (f"vset {cam}/projection_type [str]", "Sets it", camera(_choose("camera mode", _PROJECTIONS))),
            (f"vset {cam}/size [uint] [uint]", "Sets width and height, px", strict(sets("size"))),
            (f"vget {cam}/size", "Width and height, px", strict(lambda c: "{} {}".format(*c.size))),
        ]

    def _image_row(self, mode: str) -> Row:
        """Return the command that gets a camera's image of a mode."""
        handler = self.with_camera(partial(self._image, mode))
        return (f"vget /camera/[uint]/{mode} [str]", f"An image: {mode}", handler)

    def _object_names(self) -> str:
        return "".join(f"{name} " for name in self.world.objects)

    def _camera_names(self) -> str:
        return "".join(f"{camera.name} " for camera in self.world.cameras)

    def _bounds(self, actor: SceneObject) -> str:
        return numbers(self.world.bounds(actor).flat, "{:.2f}")

    def _screenshot(self, form: str) -> Reply:
        return self._image("screenshot", self.window(), form)

    def answer(self, text: str) -> Reply:
        """As in every dialect; the plugin takes ``vbatch`` out before commands are matched."""
        return self.batch(text) if text.startswith("vbatch") else super().answer(text)

    def batch(self, text: str) -> Reply:
        """Reply to ``vbatch N``, which has no effect here."""
        return None

    def _set_pose(self, attribute: str, camera: Camera, *values: float) -> None:
        """Set a camera's location or rotation; camera 0 follows the player."""
        if not self.world.faults.strike("ignore-pose"):
            is_player = camera is self.world.cameras[0]
            setattr(self.world.player if is_player else camera, attribute, values)

    def _move_to(self, camera: Camera, *location: Any) -> Reply:
        if camera is not self.world.cameras[0]:
            return "error MoveTo only supports the player camera with id 0"
        self._set_pose("location", camera, *self.world.swept(location))
        return None

    def _rotation(self, camera: Camera) -> str:
        is_player = camera is self.world.cameras[0]
        return numbers(camera.rotation if is_player else through_quaternion(camera.rotation))

    def _image(self, mode: str, camera: Camera, form: str) -> Reply:
        """Return an image as bytes (``form`` is a format), or write it to a file (a name with an ending)."""
        format_ = form.lower().rpartition(".")[2]
        if format_ not in (("npy",) if mode == "depth" else ("png", "bmp")):
            return f"error Invalid filename type, filename {form}"
        if mode == "seg":
            mode = "object_mask"
        refused = mode == "object_mask" and self.world.faults.strike("refuse-mask")
        if refused or not camera.has_pixels():
            return "error Captured data is empty"
        data = self._encoded(mode, camera, format_)
        if form.lower() == format_:
            return data
        self.files.write(form, data)  # the plugin does not report a file that it cannot write
        return form

    def _encoded(self, mode: str, camera: Camera, format_: str) -> bytes:
        """Return the bytes of a camera's image; depth is planar, in centimetres."""
        view = self.world.capture(camera, mode=mode)
        viewmode = self.world.viewmode
        if mode == "depth":
            depth = 100 * self.world.depth(view, along_ray=False)
            return pixels.npy(pixels.stored(depth, self.settings.depth == "half"))
        # The depth and normal view modes work through post-processing, which captures show too.
        if mode == "screenshot" or (mode == "lit" and viewmode in ("depth", "normal")):
            mode = viewmode
        return _ENCODERS[format_](self.world.image(view, mode, camera))

    def _spawn_cube(self, *_: str) -> Reply:
        reply = str(self._spawn("CubeActor"))  # whatever the name
        return reply if reply.startswith("error") else None

    def _spawn(self, class_name: str, name: str = "", location: Triple = (0.0, 0.0, 0.0)) -> Reply:
        if name in self.world.objects:
            return f"error Failed to spawn {name}, {self.taken}."
        if class_name != "CubeActor":
            return f"error Can not find a class with name '{class_name}'"
        cube = self.world.placed_objects.spawn_cube(name, location)
        return "error Failed to spawn actor" if cube is None else cube.name

    def _class_of(self, actor: SceneObject) -> str:
        return "Actor"  # for all: the plugin reads the wrong class

    def _rename(self, actor: SceneObject, name: str) -> Reply:
        if name == actor.name:
            return "The name has already been set"
        if name in self.world.objects:
            return f"error Renaming an object to overwrite an existing object is not allowed, {name}"
        self.world.placed_objects.rename(actor, name)
        return None

    def _run_blueprint(self, actor: str, function: str, *words: str) -> Reply:
        """Reply to ``vbp``, which takes a missing function for a wrong argument."""
        return BAD_ARGUMENT if actor in self.world.objects else self.run_function(actor, function, *words)

    def _destroy(self, name: str) -> Reply:
        return None if self.world.destroy(name) else self.no_object.format(name)

    def _vertices(self, actor: SceneObject) -> str:
        """Reply the points of an object's mesh, cm, a line each."""
        lines = []
        for point in self.world.vertices(actor).tolist():
            lines.append("     ".join(map("{:.5f}".format, point)) + "\n")
        return "".join(lines)


class Branch422(Plugin1):
    """The branches 4.22, 4.25 and 4.27, dialect M: they call themselves 0.3.10, but have the 1.x commands."""

    version = Dialect.version
    request = Dialect.request
    has_unix = False

    def rows(self) -> list[Row]:
        # The plugin bound the getter of the size, which is last, to the setter: its arguments are missing.
        size = "vget /camera/[uint]/size"
        return [*super().rows()[:-1], (size, "Width and height, px", lambda _: BAD_ARGUMENT)]


class Branch52(Plugin1):
    """UTF-8, at most 32 requests a frame, batches, other error texts, capture controls."""

    unknown = "error No handler found for URI '{}'"
    no_object = "error Cannot find object"
    encoding = "utf-8"
    requests_per_frame = 32
    taken = "object exists"
    status_on_unix = "Client Connected"
    strict_verb = True

    def parse(self, payload: bytes) -> tuple[int, str] | None:
        parsed = super().parse(payload)
        return parsed and (max(0, parsed[0]), parsed[1])

    def status(self) -> str:
        return re.sub(r"FOV: .*", f"FOV: {self.settings.fov_deg:.1f}", super().status()).rstrip("\n")

    def rows(self) -> list[Row]:
        rows = super().rows()
        alias = 0
        one_word = [row[0] for row in rows].index("vrun [str]", 1)
        rows[alias] = ("vrun [str]", "Runs an alias", "error Unrecognised alias '{}'".format)
        rows[one_word] = ("vcmd [str]", "Runs a console command of one word", self.console)
        strict = partial(self.with_camera, missing=BAD_ARGUMENT)
        at = "vset /camera/[uint]"
        rows.append(self._image_row("optical_flow"))
        for key, (what, words) in _CHOICES.items():
            rows.append((f"{at}/{key} [str]", f"Sets the {what}", strict(_choose(what, words))))
        rows.append((f"{at}/exposure_method [str]", "Sets the exposure method", strict(_set_method)))
        rows.append((f"{at}/exposure_bias [float]", "Sets it, stops", strict(partial(_expose, "bias"))))
        for key, form in _NUMBERS.items():
            rows.append((f"{at}/{key} {form}", f"Sets {key}", strict(ok)))
        return rows

    def _spawn_cube(self, *name: str) -> Reply:
        return self._spawn("CubeActor", "".join(name))

    def _class_of(self, actor: SceneObject) -> str:
        return actor.class_name

    def batch(self, text: str) -> Reply:
        """Hold so many requests, and answer them in one frame."""
        count = re.match(r"vbatch (\d{1,9})", text, re.ASCII)
        self.held = int(count[1]) if count else 0
        return None


_METHODS = ("histogram", "basic", "manual")


def _set_method(camera: Camera, word: str) -> Reply:
    _expose("manual", camera, word.lower() == "manual")
    return _choose("exposure method", _METHODS)(camera, word)


def _expose(attribute: str, camera: Camera, value: float) -> None:
    """Set a camera's exposure, which a cine model that is on ignores."""
    if not camera.cine.enabled:
        setattr(camera, attribute, value)


def _choose(what: str, words: tuple[str, ...]) -> Callable[..., Reply]:
    """Return a handler that accepts one of some words, and changes nothing that a capture shows."""

    def handler(_: Camera, word: str) -> Reply:
        """Reply to a ``word``, for any camera ``_``."""
        if word.lower() in words:
            return None
        options = ", ".join(words[:-1]) + f" and {words[-1]}"
        return f"error Can not support {what} {word}, available options are {options}"

    return handler


class Plugin11(Branch52):
    """Plugin 1.1.0: the commands of branch 5.2, and those that the reference calls new since N2."""

    version = "1.1.0"

    def rows(self) -> list[Row]:
        camera = self.with_camera
        cam = "/camera/[uint]"
        strict = partial(camera, missing=BAD_ARGUMENT)
        bones = self.with_object(_bones)
        cine = f"{cam}/cine"
        spawn = "vset /objects/spawn"
        cube = partial(self._spawn, "CubeActor")
        rows: list[Row] = [
            *super().rows()[1:],
            ("vrun [str]", "Runs a console command", self.console),
            ("vget /unrealcv/commands", "Templates of all commands, one a line", self._list),
            (f"vset {cam}/fov [float]", "Sets it, within 1 to 179", strict(_set_fov)),
            (f"{spawn} [str] {THREE}", "Adds an object at a place", self._spawn_at),
            (f"{spawn} [str] [str] {THREE}", "With a name", self._spawn_named_at),
            (f"{spawn}_cube {THREE}", "Adds a cube at a place", lambda *at: cube("", at)),
            (f"{spawn}_cube [str] {THREE}", "With a name", lambda name, *at: cube(name, at)),
            *((f"vget /object/[str]/bones{words}", "Poses of bones", bones) for words in _BONES),
            *self.console_rows("vreflect", 2, 12, self.run_function),
            (f"vget {cine}", "The cine camera", strict(lambda c: c.cine.model(*c.size))),
            (f"vget {cine}/enabled", "Whether it is on", strict(lambda c: str(int(c.cine.enabled)))),
            (f"vget {cine}/intrinsics", "Its projection", strict(lambda c: c.cine.intrinsics(*c.size))),
            (f"vset {cine}/enabled [uint]", "On", strict(lambda c, on: setattr(c.cine, "enabled", on > 0))),
        ]
        for name, form in cine_model.TEMPLATES.items():
            rows.append((f"vset {cine}/{form}", "Switches it on", strict(partial(_set_cine, name))))
        if self.settings.shared_memory != "unlisted":
            refuse = camera(_refuse_sharing)
            for mode in MODES:
                rows.append((f"vget {cam}/{mode}_shared", f"{mode} in shared memory", refuse))
        return rows

    def _spawn_at(self, class_name: str, *location: Any) -> Reply:
        return self._spawn(class_name, "", location)

    def _spawn_named_at(self, class_name: str, name: str, *location: Any) -> Reply:
        return self._spawn(class_name, name, location)

    def _list(self) -> str:
        return "\n".join(sorted({command.template for command in self.commands}))


def _set_cine(command: str, camera: Camera, *values: Any) -> Reply:
    """Change the cine model of a camera by a command of its templates."""
    return camera.cine.set(command, *values)


def _refuse_sharing(_: Camera) -> str:
    return _NO_WINDOWS


def _bones(_: SceneObject, names: str = "", space: str = "component") -> Reply:
    if space not in ("component", "world"):
        return "error Bone space must be component or world"
    return "error No skeletal or poseable mesh component found"


def _set_fov(camera: Camera, fov: float) -> None:
    camera.fov = min(max(fov, 1.0), 179.0)
