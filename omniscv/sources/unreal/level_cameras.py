"""The cameras of a level: their poses, and the projections of their pictures, cine models included."""

import json
from typing import NamedTuple

from omniscv.arguments import shown
from omniscv.errors import BadReplyError
from omniscv.geometry import Pose, pinhole
from omniscv.sources.base import Lens
from omniscv.sources.unreal import protocol
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.protocol import CAMERAS, CINE_ENABLED

_MOST_TEXT = 1 << 16  # characters of intrinsics that are read
_KEYS = ("width", "height", "fx", "fy", "cx", "cy")


class Intrinsics(NamedTuple):
    """A projection without distortion: size, focal lengths and principal point, px from the corner."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def lens(self) -> Lens | None:
        """The lens; None if pixels are square around the axis, to a thousandth of a pixel."""
        off = self.fx - self.fy, self.cx - self.width / 2, self.cy - self.height / 2
        if max(map(abs, off)) < 1e-3:
            return None
        return Lens(self.fy / self.fx, self.cx / self.width - 0.5, self.cy / self.height - 0.5)


class LevelCamera(NamedTuple):
    """A camera of a level.

    Attributes:
        number: in commands; Dev servers also accept a stable id.
        name: of its component; several may have one.
        pose: in the world.
        intrinsics: of its pictures.
        cine: whether these are of its cine model.
    """

    number: int
    name: str
    pose: Pose
    intrinsics: Intrinsics
    cine: bool


def level_cameras(connection: Connection) -> list[LevelCamera]:
    """Return the cameras of a level; nothing is set, so no cine model is switched on."""
    result = []
    for number, name in enumerate(protocol.names(connection.text(CAMERAS))):
        location, rotation = (
            protocol.numbers(connection.text(f"vget /camera/{number}/{what}"), 3)
            for what in ("location", "rotation")
        )
        cine = cine_intrinsics(connection, number)
        intrinsics = cine or _plain(connection, number)
        result.append(
            LevelCamera(number, name, Pose.from_unreal(location, rotation), intrinsics, cine is not None)
        )
    return result


def cine_intrinsics(connection: Connection, camera: str | int) -> Intrinsics | None:
    """Return the intrinsics of a camera's cine model; None where it is off.

    ``intrinsics`` also replies while the model is off, so ``enabled`` is read first.
    """
    if not connection.supports(CINE_ENABLED):
        return None
    if connection.text(f"vget /camera/{camera}/cine/enabled") != "1":
        return None
    reply = connection.text(f"vget /camera/{camera}/cine/intrinsics")
    try:
        fields = json.loads(reply[:_MOST_TEXT])
        width, height, *numbers = (float(fields[key]) for key in _KEYS)
    except (ValueError, TypeError, KeyError, RecursionError):
        width, height, numbers = 0.0, 0.0, []
    if not (1 <= width <= protocol.MAX_NAMES and 1 <= height <= protocol.MAX_NAMES and min(numbers[:2]) > 0):
        expected = f"expected intrinsics as JSON with {', '.join(_KEYS)}"
        raise BadReplyError(f"{connection.address}: {expected}, got {shown(reply[:100])}")
    return Intrinsics(int(width), int(height), *numbers)


def _plain(connection: Connection, camera: int) -> Intrinsics:
    width, height = map(int, protocol.numbers(connection.text(f"vget /camera/{camera}/size"), 2))
    fov = protocol.fov(connection.text(f"vget /camera/{camera}/fov"))
    focal = pinhole.focal_px(max(width, height), fov)  # engines take it along the longer side
    return Intrinsics(width, height, focal, focal, width / 2, height / 2)
