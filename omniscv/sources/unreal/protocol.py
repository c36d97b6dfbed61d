"""The protocol: frames, commands of the plugins, readers of their replies, and the dialect of a server.

Versions do not identify a dialect (protocol reference, section 0), so the server is asked for its commands.
"""

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol, TypeVar

from omniscv.arguments import shown
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.sources.base import Capabilities
from omniscv.sources.codecs import picture_size

T = TypeVar("T")
Reply = str | bytes
"""Bytes where the reply is not UTF-8."""

MAX_NAMES = 65_535
"""Of objects, or cameras: labels are uint16, and 0 is the label of no object."""

_MAX_NAME = 1024  # characters, as in the engine
_MAX_NUMBER = 1e9  # cm, or degrees
_MAX_NUMBERS = 1000  # characters of all

MAGIC = 0x9E2B83C1
MAX_PAYLOAD = 1 << 30  # bytes: four times the depth of an 8192 x 8192 picture
_HEADER = struct.Struct("<II")  # of a frame: magic and payload size; the payload follows (section 1.1)

VERSION = "vget /unrealcv/version"
SCENE = "vget /scene/name"
LEVEL = "vget /level/name"
OBJECTS = "vget /objects"
CAMERAS = "vget /cameras"
LIT_VIEW_MODE = "vset /viewmode lit"
IS_PAUSED = "vget /action/game/is_paused"
BOUNDS = "vget /object/[str]/bounds"
VERTICES = "vget /object/[str]/vertex_location"
EXPOSURE_METHOD = "vset /camera/[uint]/exposure_method [str]"
PAUSE = "vset /action/game/pause"
RESUME = "vset /action/game/resume"
FIX_EXPOSURE = ("vrun r.Tonemapper.Quality 1", "vrun r.EyeAdaptationQuality 0")
"""Switch vignette and auto exposure off (protocol reference, section 7.1)."""

_LIST = "vget /unrealcv/commands"
_HELP = "vget /unrealcv/help"
_MOST_TEXT = 1 << 20  # characters of a list, or help, that are read

# The starts of replies to commands that a dialect does not know.
_UNKNOWN = re.escape("error Can not find a handler for URI '")
_UNKNOWN_N2 = re.escape("error No handler found for URI '")

_MAX_COMMAND = 4000  # characters
_REPEATABLE = re.compile(
    r"vget |vset /(?:object/\S*/(?:location|rotation|scale|color|show|hide)|viewmode|action/game/resume"
    r"|camera/\d*/(?!moveto\b)\S+) ?"
)
_SHOWS_THE_SAME = re.compile(
    r"vget |vset /(?:camera/\d*/(?:location|rotation|pose|moveto|fov|horizontal_fieldofview|size) "
    r"|cameras/spawn|viewmode |action/(?:input|game/(?:pause|resume)))"
)


@dataclass(frozen=True)
class CameraTable:
    """How plugin 0.3.10 and 1.x differ in their cameras."""

    images: Mapping[str, tuple[str, str]]  # by mode, the end of the command and the encoding of its reply
    fov: str  # name of the horizontal field of view in commands
    can_set_size: bool  # of pictures
    vertex_colors: bool  # whether masks change dark colours

    def image(self, camera: int, mode: str) -> str:
        """Return the command for a picture in a ``mode`` of the ``camera`` of a number."""
        return f"vget /camera/{camera}/{self.images[mode][0]}"

    def capabilities(self, dialect: str) -> Capabilities:
        """Return what servers of a dialect can do, as far as it is known before one is connected."""
        return Capabilities(
            modes=frozenset(self.images),
            can_set_size=self.can_set_size,
            can_set_tall=False,
            can_set_exposure=EXPOSURE_METHOD in DIALECTS[dialect].commands,
            dialect=dialect,
            varies=frozenset(("objects", "commands")),
        )

    @property
    def depth(self) -> tuple[str, str]:
        """What depth means on the wire, ``planar`` or ``ray``, and its unit, ``cm`` or ``m``."""
        _, kind, unit = self.images["depth"][1].split()
        return kind, unit


_IMAGES = {
    "lit": ("lit png", "png"),
    "object_mask": ("object_mask png", "png"),
    "depth": ("depth npy", "npy planar cm"),
    "normals": ("normal png", "png normal"),
}
MODERN = CameraTable(_IMAGES, "fov", can_set_size=True, vertex_colors=False)
_RAY_DEPTH = {"depth": ("depth npy", "npy ray m")}
LEGACY = CameraTable({**_IMAGES, **_RAY_DEPTH}, "horizontal_fieldofview", False, vertex_colors=True)


def read_frame(receive: Callable[[int], bytes]) -> bytes:
    """Return the payload of the next frame; ``receive`` is a function such as ``socket.recv``.

    Raises BadReplyError for wrong magic, or a payload that is empty or larger than ``MAX_PAYLOAD``,
    ConnectionError if the stream ends before.
    """
    magic, size = _HEADER.unpack(_read_exactly(receive, _HEADER.size))
    if magic != MAGIC:
        raise BadReplyError(f"expected a frame with magic {MAGIC:#x}, got {magic:#x}: out of step")
    if not 0 < size <= MAX_PAYLOAD:
        raise BadReplyError(f"expected a frame of 1 to {MAX_PAYLOAD} bytes, got one that claims {size}")
    return _read_exactly(receive, size)


def _read_exactly(receive: Callable[[int], bytes], size: int) -> bytes:
    """Read so many bytes; memory grows with what arrives, not with what the header claims."""
    data = bytearray()
    while len(data) < size:
        block = receive(min(1 << 20, size - len(data)))
        if not block:
            raise ConnectionError(f"the stream ended {size - len(data)} bytes before its frame did")
        data += block
    return bytes(data)


def is_repeatable(command: str) -> bool:
    """Return whether sending a command twice is harmless: it reads, or sets absolute values."""
    return _REPEATABLE.match(command) is not None


def changes_world(command: str) -> bool:
    """Return whether captures may show another world after a command; the camera is not part of the world."""
    return _SHOWS_THE_SAME.match(f"{command} ") is None


def checked(text: str) -> str:
    """Return a command that can be sent alone; ArgumentError for one that would break the stream."""
    if not isinstance(text, str) or not text.strip() or not text.isprintable() or len(text) > _MAX_COMMAND:
        raise ArgumentError(f"command: expected one line such as 'vget /objects', got {shown(text)}")
    if text.split()[0] == "vbatch":
        raise ArgumentError("command: expected one with its own reply, got vbatch; use freeze='batch'")
    return text.strip()


def numbers(reply: Reply, count: int) -> list[float]:
    """Return the numbers, separated by spaces, of a reply; BadReplyError if not ``count``, up to 1e9 each."""
    try:
        values = list(map(float, reply[:_MAX_NUMBERS].split()))
    except ValueError:
        values = []
    small = all(abs(value) <= _MAX_NUMBER for value in values)  # False for NaN, too
    if len(reply) > _MAX_NUMBERS or len(values) != count or not small:
        raise BadReplyError(f"expected {count} numbers of at most {_MAX_NUMBER:g}, got {shown(reply[:100])}")
    return values


def fov(reply: Reply) -> float:
    """Return the field of view of a reply, degrees; BadReplyError unless it is between 0 and 180."""
    (value,) = numbers(reply, 1)
    if not 0 < value < 180:
        raise BadReplyError(f"expected a field of view between 0 and 180 degrees, got {shown(reply)}")
    return value


def name(reply: str) -> str:
    """Return a reply that is one line of printable characters; BadReplyError otherwise."""
    if not 0 < len(reply) <= _MAX_NAME or not reply.isprintable():
        raise BadReplyError(f"expected a name of at most {_MAX_NAME} characters, got {shown(reply)}")
    return reply


def names(reply: str) -> list[str]:
    """Return the names, separated by spaces, of a reply; BadReplyError for too many or invalid ones."""
    words = [] if reply == "ok" else reply.split(maxsplit=MAX_NAMES)  # servers send ok for an empty text
    if len(words) > MAX_NAMES:
        raise BadReplyError(f"expected at most {MAX_NAMES} names, got more: {shown(reply[:100])}")
    return [name(word) for word in words]


_SIGNATURES = {b"\x89PNG": "PNG", b"\x93NUM": "NPY", b"BM": "BMP"}


def described(reply: Reply) -> str:
    """Return a reply that is text; the size and format of a binary one."""
    if isinstance(reply, str):
        return reply
    form = "binary"
    for start, name in _SIGNATURES.items():
        if reply.startswith(start):
            form = name
    size = ""
    if form in ("PNG", "NPY"):
        with suppress(BadReplyError):
            size = ", {} x {} px".format(*picture_size(reply))
    return f"{form}, {len(reply)} bytes{size}"


@dataclass(frozen=True)
class Dialect:
    """What releases of the ``plugin``, built for versions of the ``engine``, answer."""

    plugin: str
    engine: str
    batches: bool = False  # `vbatch` has the next requests answered in one tick; no list of commands says so
    commands: frozenset[str] = frozenset()  # which not every dialect has; for servers without help


_N1 = frozenset({BOUNDS, VERTICES, IS_PAUSED, LEVEL})
_N2 = _N1 | {EXPOSURE_METHOD}
DIALECTS = {
    "0.3.10": Dialect("plugin 0.3.10 (L)", "Unreal 4.12 to 4.16"),
    "M": Dialect("branches 4.22 to 4.27, which report 0.3.10", "Unreal 4.22 to 4.27", False, _N1),
    "N1": Dialect("plugin 1.0.1, before 2026-03", "Unreal 4.27 and 5", False, _N1),
    "N2": Dialect("plugin 1.0.1, branch 5.2 from 2026-03", "Unreal 5.2 and later", True, _N2),
    "N3": Dialect("plugin 1.1.0 and later", "Unreal 5.2 and later", True, _N2),
}


class Asked(Protocol):
    """A connection that reads replies to commands together: see ``client.Connection``."""

    address: str

    def read(self, commands: Sequence[str], reader: Callable[[str, Reply], T]) -> list[T]:
        """Return ``reader(command, reply)`` of each of the ``commands``."""


@dataclass(frozen=True)
class Plugin:
    """The plugin of a server: a key of ``DIALECTS``, and commands, with ``[uint]`` for a camera."""

    dialect: str
    templates: frozenset[str]


def identify(connection: Asked) -> Plugin:
    """Return a server's plugin; BadReplyError for one of no known kind.

    Its list of commands is trusted if it holds itself, its help likewise; else the dialect is found by how
    the server answers, and the commands are those of ``DIALECTS``.
    """
    listed = _templates(connection, _LIST)
    if _LIST in listed:
        # The closed build of UnrealZoo's games has [camera_id].
        return Plugin("N3", frozenset(template.replace("[camera_id]", "[uint]") for template in listed))
    dialect = _probed(connection)
    helped = _templates(connection, _HELP)[::2]  # descriptions are the other lines
    return Plugin(dialect, frozenset(helped) if _HELP in helped else DIALECTS[dialect].commands)


def _templates(connection: Asked, command: str) -> list[str]:
    """Return the lines of a reply; none of one that is no text."""
    (reply,) = connection.read([command], lambda _, reply: reply)
    return reply[:_MOST_TEXT].split("\n") if isinstance(reply, str) else []


def _probed(connection: Asked) -> str:
    """Return the dialect of a server without a list.

    N2 has error texts of its own for unknown commands; only 0.3.10 knows the field of view by this name; M
    has the commands of N1, and the version of 0.3.10.
    """
    number = r"\d+\.\d+$"
    if _first_match(connection, "vget /omniscv", _UNKNOWN, _UNKNOWN_N2) == _UNKNOWN_N2:
        return "N2"
    if _first_match(connection, "vget /camera/0/horizontal_fieldofview", _UNKNOWN, number) == number:
        return "0.3.10"
    old = r"0\.3\.10$"
    return "M" if _first_match(connection, VERSION, old, "") == old else "N1"


def _first_match(connection: Asked, command: str, *patterns: str) -> str:
    """Return the first of some patterns that the reply to a command begins with."""

    def match(command: str, reply: Reply) -> str:
        """Return the first pattern that the ``reply`` to a ``command`` begins with."""
        for pattern in patterns:
            if isinstance(reply, str) and re.match(pattern, reply, re.ASCII):
                return pattern
        expected = f"expected plugin 0.3.10 or 1.x to answer {command!r}"
        raise BadReplyError(f"{connection.address}: {expected}, got {shown(reply[:100])}")

    return connection.read([command], match)[0]
