"""What all dialects share: matching, help, status, and the commands that answer alike everywhere."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from mock_server import pictures
from mock_server.files import OutputFolder
from mock_server.protocol import Command, command, to_int32
from mock_server.render import ViewHits
from mock_server.rotator import Triple
from mock_server.world import World


@dataclass(frozen=True)
class Later:
    """A reply that comes only after this many more frames, behind the replies of those frames."""

    frames: int
    make: Callable[[], str | bytes]


Reply = str | bytes | Later
Row = tuple[str, str, Callable[..., Reply]]
"""A template, its description, and what answers it."""

_VIEWMODES = ("lit", "unlit", "depth", "normal", "object_mask",
              "base_color", "debug", "wireframe", "vertex_color", "no_transparency")  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What the plugin's configuration and the mock's options fix.

    Attributes:
        port: where the server listens; told by the status.
        width, height, fov_deg: of new cameras, px and degrees.
        window: width and height of the game's window, px.
        half_depth: whether depth goes through half floats, as in the engine.
        files: where file commands write.
    """

    port: int
    width: int
    height: int
    fov_deg: float
    window: tuple[int, int]
    half_depth: bool
    files: OutputFolder


class Dialect(ABC):
    """A command set over a world."""

    version: ClassVar[str] = "0.3.10"
    unknown: ClassVar[str] = "error Can not find a handler for URI '{}'"
    no_object: ClassVar[str] = "error Can not find object {}"
    no_camera: ClassVar[str] = "error Camera {} can not be found."
    request: ClassVar[re.Pattern[bytes]] = re.compile(rb"(\d{1,8}):(.*)")
    """Where the id and the command are: searched, so of a longer id the last 8 digits count."""
    encoding: ClassVar[str] = "latin-1"
    requests_per_frame: ClassVar[int | None] = None
    has_unix: ClassVar[bool] = False
    """Whether the plugin on Linux goes on with a Unix socket after its first client."""

    def __init__(self, world: World, settings: Settings) -> None:
        self.world, self.settings = world, settings
        self.on_unix = False
        self.held = 0
        """How many requests the next frames hold back until all of them have come."""
        self.commands = [command(template, text, handler) for template, text, handler in self.rows()]

    @abstractmethod
    def rows(self) -> list[Row]:
        """The commands in the order of the help."""

    @abstractmethod
    def tick(self) -> None:
        """A frame of the engine ends."""

    def parse(self, payload: bytes) -> tuple[int, str] | None:
        """Id and command of a request; None if it has no id."""
        found = self.request.search(payload.partition(b"\0")[0])
        if found is None:
            return None
        return to_int32(found[1].decode()), found[2].decode(self.encoding, "replace")

    def malformed(self, payload: bytes) -> bytes | None:
        """What a request without an id is answered; None for silence."""
        return None

    def answer(self, text: str) -> Reply:
        """The reply to a command's text; an empty one is sent as ``ok``."""
        for each in reversed(self.commands):  # templates registered later win
            arguments = self.match(each, text)
            if arguments is not None:
                reply: Reply = each.handler(*arguments)
                return reply
        return self.unknown.format(text)

    def match(self, each: Command, text: str) -> tuple[Any, ...] | None:
        """The arguments of a command, or None if it does not fit."""
        return each.match(text)

    def with_camera(self, act: Callable[..., Reply], missing: str | None = None) -> Callable[..., Reply]:
        """A handler that gets the camera of a number, or answers that it is missing."""

        def handler(index: int, *arguments: Any) -> Reply:
            if index >= len(self.world.cameras):
                return (missing or self.no_camera).format(index)
            return act(self.world.cameras[index], *arguments)

        return handler

    def with_object(self, act: Callable[..., Reply], missing: str | None = None) -> Callable[..., Reply]:
        """A handler that gets the object of a name, or answers that it is missing."""

        def handler(name: str, *arguments: Any) -> Reply:
            if name not in self.world.objects:
                return (missing or self.no_object).format(name)
            return act(self.world.objects[name], *arguments)

        return handler

    def plugin_rows(self) -> list[Row]:
        """The commands about the plugin itself."""
        return [
            ("vget /unrealcv/status", "State of the server and its configuration", self.status),
            ("vget /unrealcv/help", "All commands", self._help),
            ("vget /unrealcv/echo [str]", "The word itself", self.echo),
            ("vget /unrealcv/version", "Version of the plugin", lambda: self.version),
            ("vget /scene/name", "Name of the project", lambda: self.world.scene.name),
        ]

    def viewmode_rows(self) -> list[Row]:
        """The view mode of the viewport."""
        return [
            ("vset /viewmode [str]", "Sets the view mode", self._set_viewmode),
            ("vget /viewmode", "The view mode", lambda: self.world.viewmode),
        ]

    def console_rows(self, verb: str, least: int, most: int, handler: Callable[..., Reply]) -> list[Row]:
        """A command of several words, one template for each number of words."""
        return [
            (f"{verb} {' '.join(['[str]'] * n)}", f"{verb} with {n} words", handler)
            for n in range(least, most + 1)
        ]

    def echo(self, word: str) -> Reply:
        """The word."""
        return word

    def status(self) -> str:
        """The status text."""
        s = self.settings
        return (
            f"Is Listening\n{self.client_state()}\n{s.port}\nConfiguration\nConfig file: /unrealcv.ini\n"
            f"Port: {s.port}\nWidth: {s.width}\nHeight: {s.height}\nFOV: {s.fov_deg:f}\nEnableInput: true\n"
            "EnableRightEye: false\n"
        )

    def client_state(self) -> str:
        """The second line of the status."""
        return "Client Connected"

    def viewport(self, view: ViewHits) -> pictures.Bytes:
        """What the window shows of a view, in the present view mode."""
        if self.world.viewmode == "object_mask":
            return self.world.mask(view)
        if self.world.viewmode == "normal":
            return pictures.normals(view)
        if self.world.viewmode == "depth":
            return pictures.gray_depth(view)
        return self.world.lit(view)

    def _help(self) -> str:
        return "".join(f"{c.template}\n{c.description}\n" for c in self.commands)

    def _set_viewmode(self, mode: str) -> str:
        if mode.lower() not in _VIEWMODES:
            return f"error Can not set ViewMode to {mode.lower()}"
        self.world.viewmode = mode.lower()
        return "ok"


def ok(*_: Any) -> str:
    """What commands answer that change nothing a capture shows."""
    return "ok"


def numbers(values: Triple, form: str = "{:.3f}") -> str:
    """Three numbers, separated by spaces."""
    return " ".join(form.format(value) for value in values)
