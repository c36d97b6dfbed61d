"""The base of all dialects: command templates, help, status, and the commands that all have."""

import contextlib
import dataclasses
import functools
import itertools
import logging
import os
import re
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from mock_server import pixels
from mock_server.objects import SceneObject, axes
from mock_server.protocol import to_int32
from mock_server.scene import NotShownError, load_scene
from mock_server.settings import Settings
from mock_server.world import Camera, World


@dataclass(frozen=True)
class Later:
    """A reply that is sent so many frames later, after the replies of those frames."""

    frames: int
    make: Callable[[], str | bytes]


Reply = str | bytes | Later | None
"""None is sent as ``ok``, as empty text is."""
Row = tuple[str, str, Callable[..., Reply]]
"""A template, its description, and its handler."""

LOGGER = logging.getLogger("mock_server")

_SHOTS = {"shot": "ScreenShot", "screenshot": "ScreenShot", "highresshot": "HighresScreenshot"}
"""Console commands that write the window into a file, and how its name begins."""

_KEYS = {"W": (1.0, 0), "S": (-1.0, 0), "D": (1.0, 1), "A": (-1.0, 1), "UP": (1.0, 0), "DOWN": (-1.0, 0)}
"""By key, the sign and the axis, forward or right, along which the pawn goes."""
_TURNS = {"LEFT": -45.0, "RIGHT": 45.0}  # degrees a second, of the same pawn
_SPEED = 1200.0  # cm a second, of the engine's flying pawn

_LIMIT = 1e9
"""cm, or degrees: larger numbers are clipped to it, so that no arithmetic overflows."""

THREE = "[float] [float] [float]"

_VIEWMODES = ("lit", "unlit", "depth", "normal", "object_mask",
              "base_color", "debug", "wireframe", "vertex_color", "no_transparency")  # fmt: skip


def _whole(digits: str) -> int:
    """Return a whole number: 0 for no digits, and 2^31 - 1 for ten and more."""
    if len(digits) >= 10:
        return (1 << 31) - 1
    return int(digits or 0)


def _number(text: str) -> float:
    return min(max(float(text), -_LIMIT), _LIMIT)


_PLACEHOLDERS: dict[str, tuple[str, Callable[[str], Any]]] = {
    "[str]": (r"(\S*)", str),
    "[uint]": (r"(\d*)", _whole),
    "[float]": (r"([-+]?(?:\d*\.)?\d+)", _number),
}
"""By placeholder of a template, the pattern of a value, and its conversion."""

_LONG = 200  # characters of a command that is first searched for a template's fixed texts


class Command:
    """A template such as ``vset /camera/[uint]/fov [float]`` and its handler.

    Matching is case-sensitive, unanchored at the start, and anchored at the end but for spaces. Its time is
    proportional to the text's length: no two neighbours in a pattern accept the same characters.
    """

    def __init__(self, template: str, description: str, handler: Callable[..., Any]) -> None:
        self.template = template
        self.description = description
        self.handler = handler
        self.verb = template.partition(" ")[0]
        self._converters: list[Callable[[str], Any]] = []
        self._literals: list[str] = []
        pattern = ""
        for part in re.split(r"(\[(?:str|uint|float)\])", template):
            if part in _PLACEHOLDERS:
                value, converter = _PLACEHOLDERS[part]
                pattern += value
                self._converters.append(converter)
            elif part:
                pattern += re.escape(part)
                self._literals.append(part)
        self._pattern = re.compile(pattern + r" *\Z", re.ASCII)

    def match(self, text: str) -> tuple[Any, ...] | None:
        """Return the arguments in ``text``; None if it does not match."""
        if len(text) > _LONG and not all(literal in text for literal in self._literals):
            return None  # much faster than the pattern
        match = self._pattern.search(text)
        if match is None:
            return None
        arguments = []
        for convert, value in zip(self._converters, match.groups(), strict=True):
            arguments.append(convert(value))
        return tuple(arguments)


class OutputFolder:
    """The folder that file commands write to.

    Args:
        folder: None for a temporary folder, which ``close`` removes.
        anywhere: whether names may lead out of the folder.
    """

    def __init__(self, folder: Path | None = None, anywhere: bool = False) -> None:
        self._folder = folder
        self._anywhere = anywhere
        self._numbers = itertools.count(1)
        self._opened = contextlib.ExitStack()
        self.close = self._opened.close

    @functools.cached_property
    def path(self) -> Path:
        """The folder; made on first use."""
        if self._folder is not None:
            return self._folder
        return Path(self._opened.enter_context(tempfile.TemporaryDirectory(prefix="mock-unrealcv-")))

    def next_name(self) -> str:
        """Return a new name, for an image without one."""
        return f"{next(self._numbers):08d}.png"

    def named(self, name: str) -> str:
        """Return the path that a reply names."""
        return os.path.join(self.path, name)

    def write(self, name: str, data: bytes) -> None:
        """Write ``data`` to the file ``name`` of the folder, and make the folders that it needs.

        A file that cannot be written is missing, as with an engine.
        """
        folder = self.path.resolve()
        with contextlib.suppress(OSError, ValueError):  # ValueError: a name with a null byte
            target = (folder / name).resolve()
            if not self._anywhere and not target.is_relative_to(folder):
                LOGGER.warning("not written, as it is outside the folder: %r; see --files anywhere", name)
                return
            target.parent.mkdir(parents=True, exist_ok=True)
            if not target.is_fifo():  # which nobody may read
                target.write_bytes(data)


class Dialect(ABC):
    """A command set over a world, of a server at ``port``; file commands write into ``files``."""

    version: ClassVar[str] = "0.3.10"
    unknown: ClassVar[str] = "error Can not find a handler for URI '{}'"
    no_object: ClassVar[str] = "error Can not find object {}"
    no_camera: ClassVar[str] = "error Camera {} can not be found."
    request: ClassVar[re.Pattern[bytes]] = re.compile(rb"(\d{1,8}):(.*)")
    """The id and the command; searched, so that the last 8 digits of a longer id count."""
    encoding: ClassVar[str] = "latin-1"
    strict_verb: ClassVar[bool] = False
    """Whether the first word of a command must be the template's."""
    requests_per_frame: ClassVar[int | None] = None
    has_unix: ClassVar[bool] = False
    """Whether the plugin on Linux continues on a Unix socket after its first client."""
    status_on_unix: ClassVar[str] = "No Client Connected"
    """The second line of the status on that socket: the plugin checks the TCP listener only."""
    lag: ClassVar[tuple[int, int]] = (1, 1)
    """Frames by which the player's camera follows the pawn: its location, and its rotation."""

    follows_while_paused: ClassVar[bool] = False
    """Whether the player's camera follows the pawn while the game is paused."""

    def __init__(self, world: World, settings: Settings, port: int, files: OutputFolder) -> None:
        self.settings = settings
        self.port = port
        self.files = files
        self.project = world.scene.name
        self.on_unix = False
        self.held = 0
        """How many requests the next frames hold until all of them have come."""
        self._next_world: World | None = None
        self.begin(world)

    def begin(self, world: World) -> None:
        """Serve a world from now on."""
        self.world = world
        self.commands = [Command(*row) for row in self.rows()]

    @abstractmethod
    def rows(self) -> list[Row]:
        """Return the commands in the order of the help."""

    def tick(self) -> None:
        """End a frame of the engine; the next one may be of another level."""
        if self._next_world is not None:
            self.begin(self._next_world)
            self._next_world = None
        if self.world.tick() or self.follows_while_paused:
            self.world.player.publish()
            camera = self.world.cameras[0]
            camera.location, camera.rotation = self.world.player.delayed(*self.lag)

    def parse(self, payload: bytes) -> tuple[int, str] | None:
        """Return id and command of a request; None if it has no id."""
        match = self.request.search(payload.partition(b"\0")[0])
        if match is None:
            return None
        return to_int32(match[1].decode()), match[2].decode(self.encoding, "replace")

    def malformed(self, payload: bytes) -> bytes | None:
        """Return the reply to a request without an id; None for no reply."""
        return None

    def answer(self, text: str) -> Reply:
        """Return the reply to a command; an empty one is sent as ``ok``."""
        if self.world.faults.strike("authentication"):
            return "error Authentication required, use: vset /unrealcv/auth <token>"
        for command in reversed(self.commands):  # templates registered later win
            if self.strict_verb and not text.startswith(f"{command.verb} "):
                continue
            arguments = command.match(text)
            if arguments is None:
                continue
            try:
                reply: Reply = command.handler(*arguments)
            except NotShownError as cause:
                return f"error {cause}"
            return reply
        return self.unknown.format(text)

    def with_camera(self, act: Callable[..., Reply], missing: str | None = None) -> Callable[..., Reply]:
        """Return a handler that looks up a camera by its number, and calls ``act`` with it.

        Its reply is ``missing`` if there is no such camera; None for the dialect's own error.
        """
        return with_target(lambda: dict(enumerate(self.world.cameras)), act, missing or self.no_camera)

    def with_object(self, act: Callable[..., Reply], missing: str | None = None) -> Callable[..., Reply]:
        """Return a handler that looks up an object by its name, and calls ``act`` with it.

        Its reply is ``missing`` if there is no such object; None for the dialect's own error.
        """
        return with_target(lambda: self.world.objects, act, missing or self.no_object)

    def plugin_rows(self, echo: Callable[[str], Reply] = str) -> list[Row]:
        """Return the commands about the plugin itself."""
        return [
            ("vget /unrealcv/status", "State of the server and its configuration", self.status),
            ("vget /unrealcv/help", "All commands", self.help),
            ("vget /unrealcv/echo [str]", "The word itself", echo),
            ("vget /unrealcv/version", "Version of the plugin", lambda: self.version),
            ("vget /scene/name", "Name of the project", lambda: self.project),
        ]

    def help(self) -> str:
        """Return the templates of all commands, each with its description behind it, a line each."""
        return "".join(f"{command.template}\n{command.description}\n" for command in self.commands)

    def viewmode_rows(self) -> list[Row]:
        """Return the commands about the window's view mode."""
        return [
            ("vset /viewmode [str]", "Sets the view mode", self._set_viewmode),
            ("vget /viewmode", "The view mode", lambda: self.world.viewmode),
        ]

    def console_rows(self, verb: str, least: int, most: int, act: Callable[..., Reply]) -> list[Row]:
        """Return a command of several words, one template for each number of words.

        Args:
            verb: the first word of the command.
            least: of the words behind it.
            most: of the words behind it.
            act: the handler; it is called with the words behind the verb.
        """
        rows: list[Row] = []
        for count in range(least, most + 1):
            template = " ".join([verb, *(["[str]"] * count)])
            rows.append((template, f"{verb} with {count} words", act))
        return rows

    def console(self, command: str, *words: str) -> None:
        """Run a console command: here those that write the window into a file; others act on the world."""
        if stem := _SHOTS.get(command.lower()):
            times = next((int(word) for word in words if re.fullmatch("[1-9]", word)), 1)
            name = f"Saved/Screenshots/{stem}{self.files.next_name()[3:]}"
            self.files.write(name, self.window_png(times))

    def window(self, times: int = 1) -> Camera:
        """Return the window's camera, for pictures of so many times its size."""
        width, height = self.world.window
        return dataclasses.replace(self.world.cameras[0], size=(times * width, times * height))

    def window_png(self, times: int = 1) -> bytes:
        """Return what the window shows, as PNG; empty if it is too large."""
        camera = self.window(times)
        mode = self.world.viewmode
        if not camera.has_pixels():
            return b""
        return pixels.png(self.world.image(self.world.capture(camera), mode, camera))

    def open_level(self, name: str) -> None:
        """Open a scene of this package in the next frame; an engine, too, replies ok for a level it lacks."""
        scene = name.rpartition("/")[2].partition(".")[0]  # without an ending: no file is read
        try:
            self._next_world = World(load_scene(scene), self.settings, self.world.faults)
            self._next_world.window = self.world.window
        except ValueError as cause:  # also where the scene lacks the object of a fault
            LOGGER.warning("level not opened: %s", cause)

    def press(self, key: str, seconds: float) -> None:
        """Move or turn the pawn at once as a ``key`` does that is held for so many ``seconds``.

        W, A, S, D and the arrows move it; other keys do nothing.
        """
        player = self.world.player
        pitch, yaw, roll = player.rotation
        player.rotation = pitch, yaw + _TURNS.get(key.upper(), 0.0) * max(0.0, seconds), roll
        if key.upper() in _KEYS:
            sign, axis = _KEYS[key.upper()]
            step = sign * _SPEED * max(0.0, seconds) * axes(player.rotation)[:, axis]
            x, y, z = (player.location + step).tolist()
            player.location = self.world.swept((x, y, z))

    def run_function(self, actor: str, function: str, *words: str) -> Reply:
        """Return the reply to the call of an actor's function; the mock's actors have no functions."""
        if actor in self.world.objects:
            return f"error Fail to execute the function '{' '.join((function, *words))}' of {actor}"
        return f"error Can not find actor with id '{actor}'"

    def status(self) -> str:
        """Return the status. Clients look for captured files beside the config file that it names."""
        state = self.status_on_unix if self.on_unix else "Client Connected"
        width, height = self.settings.size
        eye = str(self.settings.right_eye).lower()
        return (
            f"Is Listening\n{state}\n{self.port}\nConfiguration\n"
            f"Config file: {self.files.path.absolute()}/unrealcv.ini\nPort: {self.port}\nWidth: {width}\n"
            f"Height: {height}\nFOV: {self.settings.fov_deg:f}\nEnableInput: true\nEnableRightEye: {eye}\n"
        )

    def _set_viewmode(self, mode: str) -> Reply:
        if mode.lower() not in _VIEWMODES:
            return f"error Can not set ViewMode to {mode.lower()}"
        self.world.viewmode = mode.lower()
        return None


def with_target(
    table: Callable[[], Mapping[Any, object]], act: Callable[..., Reply], missing: str
) -> Callable[..., Reply]:
    """Return a handler that looks its first argument up in a ``table``, and calls ``act`` with the target.

    Its reply is ``missing``, formatted with the argument, if the table lacks it.
    """

    def handler(key: str | int, *arguments: Any) -> Reply:
        target = table().get(key)
        return missing.format(key) if target is None else act(target, *arguments)

    return handler


def ok(*_: Any) -> None:
    """Reply to a command that changes nothing a capture shows."""


def sets(attribute: str, value: object = None) -> Callable[..., None]:
    """Return a handler that sets an ``attribute`` of its first argument to the others, or to ``value``."""

    def handler(target: object, *values: float) -> None:
        if not values:
            setattr(target, attribute, value)
        elif len(values) == 1:
            setattr(target, attribute, values[0])
        else:
            setattr(target, attribute, values)

    return handler


def reads(attribute: str, form: str = "{:.3f}") -> Callable[..., str]:
    """Return a handler that replies the numbers of an ``attribute`` of its argument, each by ``form``."""

    def handler(target: object) -> str:
        return numbers(getattr(target, attribute), form)

    return handler


def moves(attribute: str, refusal: str = "ok") -> Callable[..., Reply]:
    """Return a handler that moves or turns an object, by its ``attribute`` location or rotation.

    A static object stays where it is, and the reply is ``refusal``, formatted with its name.
    """

    def handler(actor: SceneObject, *values: float) -> Reply:
        if actor.mobility == "Static":
            return refusal.format(actor.name)
        setattr(actor, attribute, values)
        return None

    return handler


def color(actor: SceneObject) -> str:
    """Return an object's colour as set, not as masks show it."""
    return "(R={},G={},B={},A=255)".format(*actor.color)


def paint(actor: SceneObject, red: int, green: int, blue: int) -> None:
    """Set an object's colour, which also annotates it.

    Args:
        actor: the object.
        red: any whole number; the engine keeps its last 8 bits.
        green: likewise.
        blue: likewise.
    """
    actor.color = (red % 256, green % 256, blue % 256)
    actor.annotated = True


def numbers(values: Iterable[float], form: str = "{:.3f}") -> str:
    """Return ``values``, each formatted by ``form``, separated by spaces."""
    return " ".join(map(form.format, values))
