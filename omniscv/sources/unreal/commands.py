"""The commands of plugins 0.3.10 and 1.x, the encodings of their pictures, and what commands may change."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.sources.base import Capabilities

VERSION = "vget /unrealcv/version"
SCENE = "vget /scene/name"
LEVEL = "vget /level/name"
OBJECTS = "vget /objects"
CAMERAS = "vget /cameras"
LIT_VIEW_MODE = "vset /viewmode lit"
IS_PAUSED = "vget /action/game/is_paused"
BOUNDS, VERTICES = "vget /object/[str]/bounds", "vget /object/[str]/vertex_location"
PAUSE_ALL, RESUME_ALL = "vset /world/pause_all_except_pawn", "vset /world/resume_all"
ANNOTATE = "vset /annotation/object/[str]"
CAMERA_IDS = "vget /cameras/ids"
CINE_ENABLED = "vget /camera/[uint]/cine/enabled"
EXPOSURE_METHOD = "vset /camera/[uint]/exposure_method [str]"
PAUSE, RESUME = "vset /action/game/pause", "vset /action/game/resume"
FIX_EXPOSURE = ("vrun r.Tonemapper.Quality 1", "vrun r.EyeAdaptationQuality 0")
"""Switch vignette and auto exposure off (protocol reference, section 7.1)."""

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
    """How plugin 0.3.10 and 1.x differ in their cameras.

    Attributes:
        images: by mode, the end of the command and the encoding of its reply.
        fov: name of the horizontal field of view in commands.
        can_set_size: whether the size of pictures can be set.
        vertex_colors: whether masks change dark colours.
    """

    images: Mapping[str, tuple[str, str]]
    fov: str
    can_set_size: bool
    vertex_colors: bool

    def image(self, camera: int | str, mode: str) -> str:
        """Return the command for a picture."""
        return f"vget /camera/{camera}/{self.images[mode][0]}"

    def capabilities(self, dialect: str) -> Capabilities:
        """Return what servers of a dialect can do, as far as it is known before one is connected."""
        modes = frozenset(self.images)
        exposes = dialect in ("N2", "N3", "Dev")
        return Capabilities(
            modes, self.can_set_size, can_set_tall=False, can_set_exposure=exposes, dialect=dialect
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
_SHARED_IMAGES = {
    mode: (f"{command.split()[0]}_shared", encoding.replace("png", "npy"))
    for mode, (command, encoding) in _IMAGES.items()
}
SHARED_MASK = "vget /camera/[uint]/object_mask_shared"
MODERN = CameraTable(_IMAGES, "fov", can_set_size=True, vertex_colors=False)
SHARED = CameraTable(_SHARED_IMAGES, "fov", can_set_size=True, vertex_colors=False)
"""Pictures by shared memory, whose names come as JSON."""
_RAY_DEPTH = {"depth": ("depth npy", "npy ray m")}
LEGACY = CameraTable({**_IMAGES, **_RAY_DEPTH}, "horizontal_fieldofview", False, vertex_colors=True)


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
