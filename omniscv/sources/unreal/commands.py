"""What plugins 0.3.10 and 1.x answer to, and in which encodings: the one table."""

from collections.abc import Mapping
from dataclasses import dataclass

from omniscv.sources.base import Capabilities

VERSION = "vget /unrealcv/version"
SCENE = "vget /scene/name"
LEVEL = "vget /level/name"
LIT_VIEW_MODE = "vset /viewmode lit"
FIX_EXPOSURE = ("vrun r.Tonemapper.Quality 1", "vrun r.EyeAdaptationQuality 0")
"""Switch vignette and auto exposure off (protocol reference, section 7.1)."""


@dataclass(frozen=True)
class CommandTable:
    """What differs between plugin 0.3.10 and 1.x."""

    images: Mapping[str, tuple[str, str]]  # by mode: the end of the command, the encoding of its reply
    fov: str  # the name of the horizontal field of view
    can_set_size: bool
    vertex_colors: bool  # whether masks change dark colours

    def image(self, camera: int, mode: str) -> str:
        """Return the command for a picture."""
        return f"vget /camera/{camera}/{self.images[mode][0]}"

    def capabilities(self, dialect: str) -> Capabilities:
        """Return what servers of a dialect can do, as far as it is known before one is connected."""
        modes = frozenset(self.images)
        return Capabilities(modes, self.can_set_size, can_set_tall=False, dialect=dialect)

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
MODERN = CommandTable(_IMAGES, "fov", can_set_size=True, vertex_colors=False)
_RAY_DEPTH = {"depth": ("depth npy", "npy ray m")}
LEGACY = CommandTable({**_IMAGES, **_RAY_DEPTH}, "horizontal_fieldofview", False, vertex_colors=True)
