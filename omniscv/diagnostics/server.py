"""Raw access to a server: replies to commands, and a camera's frames without repairs of stale ones."""

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.errors import BadReplyError, ServerRefusedError
from omniscv.geometry import Array, Pose, pinhole
from omniscv.sources.base import Color, View
from omniscv.sources.codecs import decode, picture_size
from omniscv.sources.registry import Deadlines
from omniscv.sources.unreal import open_connection
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.protocol import Reply, checked, described, fov
from omniscv.sources.unreal.source import open_driver

FACES = {
    "front": (0, 0), "left": (90, 0), "back": (180, 0), "right": (-90, 0), "up": (0, 90), "down": (0, -90),
}  # fmt: skip
"""Yaw to the left and pitch, degrees."""

EDGE_PX = 128  # frames are square and of this size, where the server can set it
_LARGEST_PX = 1 << 13
_FRAMES = 8  # after so many frames at one pose a camera shows it, if it ever does
NEVER = _FRAMES - 1  # so many stale frames mean that a camera does not rest
_NOISE, _MOVING = 0.01, 0.05  # relative depth, and share of a frame, by which frames of one pose may differ


def replies_to(address: str, commands: Iterable[str], **deadlines: Unpack[Deadlines]) -> Iterator[str]:
    """Yield the replies to commands, of binary ones the size and format, each before the next is sent.

    Nothing else is done to the game. Address and deadlines are those of :func:`omniscv.open_source`.

    Raises:
        ArgumentError: an address of another form, or a command that is no single line.
        SourceError: no UnrealCV server reachable there, or one that refuses a command.
    """
    lines = [checked(command) for command in commands]
    with open_connection(address, **deadlines) as connection:
        for line in lines:
            yield described(connection.reply(line))


class RawCamera(AbstractContextManager["RawCamera"]):
    """A camera that a driver aims, without the driver's repairs, so that faults are visible.

    A context manager, which leaves the game as it was. Depth is in the server's unit.

    Args:
        position: (3,) where the camera starts, world frame, metres; None: the player's position.

    Attributes:
        size: width and height of its lit frames, px.
        fov_deg: the horizontal field of view that it reports, set to see 90 degrees up and down.
        lag: how many frames after a move to drop.
    """

    def __init__(self, connection: Connection, position: Array | None = None) -> None:
        self._connection, self.driver = connection, open_driver(connection)
        if position is None:
            position = Pose.from_unreal(self.driver.read("location", 3), (0, 0, 0)).position
        self.position = position
        self.driver.attach()
        self._view: View | None = None
        self._sizes: dict[str, tuple[int, int]] = {}  # of each mode's pictures
        self.size, self.lag = (EDGE_PX, EDGE_PX), _FRAMES
        self._aim(0, 0)
        height, width = self.pixels("lit").shape[:2]
        self.size = width, height
        self._aim(0, 0)
        self._sizes.clear()
        command = f"vget /camera/{self.driver.camera}/{self.driver.table.fov}"
        self.fov_deg = fov(self._connection.text(command))

    def go(self, yaw_deg: float, pitch_deg: float = 0.0, forward_m: float = 0.0) -> Pose:
        """Turn to world angles, move along the new axis, and wait until frames show it."""
        pose = self._aim(yaw_deg, pitch_deg, forward_m)
        for _ in range(self.lag):
            self.pixels("depth")
        return pose

    def settle(self, yaw_deg: float, pitch_deg: float) -> tuple[int, float, NDArray[Any]]:
        """Turn; return the number of stale depth frames, seconds until a fresh one, and the last frame.

        ``NEVER`` or more are stale if the camera does not rest.
        """
        start = time.monotonic()
        self._aim(yaw_deg, pitch_deg)
        frames = [(self.pixels("depth"), time.monotonic() - start) for _ in range(_FRAMES)]
        last = frames[-1][0]
        stale = max((i + 1 for i, (depth, _) in enumerate(frames) if not alike(depth, last)), default=0)
        return stale, frames[stale][1], last

    def pixels(self, mode: str) -> NDArray[Any]:
        """Return a frame: (H, W, 3) uint8, or (H, W) float32 depth in the server's meaning and unit."""
        address = self._connection.address

        def decoded(command: str, reply: Reply) -> NDArray[Any]:
            if isinstance(reply, str):
                error = ServerRefusedError if reply.startswith("error") else BadReplyError
                raise error(f"{address}: expected a picture from {command!r}, got {shown(reply)}")
            width, height = picture_size(reply)
            if not 1 <= height <= width <= _LARGEST_PX:
                expected = f"expected a picture at most {_LARGEST_PX} px wide and no higher"
                raise BadReplyError(f"{address}: {expected}, got {width} x {height}")
            if (known := self._sizes.setdefault(mode, (width, height))) != (width, height):
                expected = "expected {} pictures of {} x {} as before".format(mode, *known)
                raise BadReplyError(f"{address}: {expected}, got {width} x {height}")
            view = View(Pose(np.zeros(3), np.eye(3)), 90.0, width, height)
            encoding, shown_as = ("npy", mode) if mode == "depth" else ("png", "lit")  # normals: their codes
            return decode(reply, encoding, shown_as, view)

        return self._connection.read([self.driver.table.image(self.driver.camera, mode)], decoded)[0]

    def __exit__(self, *error: object) -> None:
        self.driver.release()

    def _aim(self, yaw_deg: float, pitch_deg: float, forward_m: float = 0.0) -> Pose:
        turned = Pose.from_angles(self.position, yaw_deg, pitch_deg)
        pose = Pose(turned.to_world((0.0, 0.0, forward_m)), turned.R_w_c)
        view = View(pose, across(*self.size), *self.size)
        for command in self.driver.aim(self._view, view):
            self._connection.text(command)
        self._view = view
        return pose


def color_counts(mask: NDArray[np.uint8]) -> dict[Color, int]:
    """Return the colours in an object mask (H, W, 3), and how many pixels have each."""
    colors, counts = np.unique(mask.reshape(-1, 3), axis=0, return_counts=True)
    return {(r, g, b): count for (r, g, b), count in zip(colors.tolist(), counts.tolist(), strict=True)}


def largest_object(camera: RawCamera, colors: Mapping[str, Color]) -> str | None:
    """Return the object with the most pixels straight ahead, by the colours of masks; None for none."""
    camera.go(0)
    names = {color: name for name, color in colors.items()}
    counts = color_counts(camera.pixels("object_mask"))
    areas = {names[color]: count for color, count in counts.items() if color in names}
    return max(areas, key=areas.__getitem__, default=None)


def alike(depth: NDArray[Any], other: NDArray[Any]) -> bool:
    """Return whether two frames show the same, except for noise and small things that move."""
    return bool(np.isclose(depth, other, rtol=_NOISE).mean() > 1 - _MOVING)


def across(width: int, height: int) -> float:
    """Return the horizontal field of view that sees 90 degrees up and down, degrees."""
    return pinhole.fov_deg(width, height / 2)
