"""Raw access to a server: replies, frames without repairs of stale ones, and a world that may move."""

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.diagnostics import Finding
from omniscv.errors import BadReplyError, ServerRefusedError
from omniscv.geometry import Array, Pose, pinhole
from omniscv.sources.base import Color, View
from omniscv.sources.codecs import decode, picture_size
from omniscv.sources.registry import Deadlines
from omniscv.sources.unreal import open_connection
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.driver import SETTLED
from omniscv.sources.unreal.instants import clock_of, movable_objects, object_names, object_poses
from omniscv.sources.unreal.objects import colors
from omniscv.sources.unreal.protocol import IS_PAUSED, VERSION, Reply, checked, described, fov, numbers
from omniscv.sources.unreal.source import open_driver

FACES = {
    "front": (0, 0), "left": (90, 0), "back": (180, 0), "right": (-90, 0), "up": (0, 90), "down": (0, -90),
}  # fmt: skip
"""Yaw to the left and pitch, degrees."""

EDGE_PX = 128  # frames are square and of this size, where the server can set it
_LARGEST_PX = 1 << 13
_FRAMES = 8  # after so many frames at one pose a camera shows it, if it ever does
NEVER = _FRAMES - 1  # so many stale frames mean that a camera does not rest
# By how much frames of one pose may differ:
_NOISE = 0.01  # relative depth
_MOVING = 0.05  # share of a frame
_TICKS = 6  # for how long to watch objects
_AWAY_CM = np.array([40.0, 30.0, 50.0])  # a move that changes the depth of nearly every surface
_LISTED = 3  # objects that a finding names


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
        self._connection = connection
        self.driver = open_driver(connection)
        if position is None:
            position = Pose.from_unreal(self.driver.read("location", 3), (0, 0, 0)).position
        self.position = position
        self.driver.attach()
        self._view: View | None = None
        self._sizes: dict[str, tuple[int, int]] = {}  # of each mode's pictures
        self.size = (EDGE_PX, EDGE_PX)
        self.lag = _FRAMES
        self._aim(0, 0)
        height, width = self.pixels("lit").shape[:2]
        self.size = width, height
        self._aim(0, 0)
        self._sizes.clear()
        command = f"vget /camera/{self.driver.camera}/{self.driver.table.fov}"
        self.fov_deg = fov(self._connection.text(command))

    def go(self, yaw_deg: float, pitch_deg: float = 0.0, forward_m: float = 0.0) -> Pose:
        """Turn and move, and wait until frames show it.

        Args:
            yaw_deg: to the left, in the world.
            pitch_deg: nose up.
            forward_m: from the camera's position along the new axis.
        """
        pose = self._aim(yaw_deg, pitch_deg, forward_m)
        for _ in range(self.lag):
            self.pixels("depth")
        return pose

    def settle(self, yaw_deg: float, pitch_deg: float) -> tuple[int, float, NDArray[Any]]:
        """Turn to ``yaw_deg`` and ``pitch_deg``, as :meth:`go`, and watch the frames.

        Returns:
            The number of stale depth frames, ``NEVER`` or more if the camera does not rest; seconds until a
            fresh one; and the last frame.
        """
        start = time.monotonic()
        self._aim(yaw_deg, pitch_deg)
        frames = []
        seconds = []
        for _ in range(_FRAMES):
            frames.append(self.pixels("depth"))
            seconds.append(time.monotonic() - start)
        stale = 0
        for number, depth in enumerate(frames, start=1):
            if not alike(depth, frames[-1]):
                stale = number
        return stale, seconds[stale], frames[-1]

    def pixels(self, mode: str) -> NDArray[Any]:
        """Return a frame: (H, W, 3) uint8, or (H, W) float32 depth in the server's meaning and unit."""
        address = self._connection.address

        def decoded(command: str, reply: Reply) -> NDArray[Any]:
            """Return the pixels of the ``reply`` to a ``command``."""
            if isinstance(reply, str):
                error = ServerRefusedError if reply.startswith("error") else BadReplyError
                raise error(f"{address}: expected a picture from {command!r}, got {shown(reply)}")
            width, height = picture_size(reply)
            if not 1 <= height <= width <= _LARGEST_PX:
                expected = f"expected a picture at most {_LARGEST_PX} px wide and no higher"
                raise BadReplyError(f"{address}: {expected}, got {width} x {height}")
            before = self._sizes.setdefault(mode, (width, height))
            if before != (width, height):
                expected = f"expected {mode} pictures of {before[0]} x {before[1]} as before"
                raise BadReplyError(f"{address}: {expected}, got {width} x {height}")
            view = View(Pose(np.zeros(3), np.eye(3)), 90.0, width, height)
            if mode == "depth":
                return decode(reply, "npy", "depth", view)
            return decode(reply, "png", "lit", view)  # of normals: their codes

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
    count_of: dict[Color, int] = {}
    for (red, green, blue), count in zip(colors.tolist(), counts.tolist(), strict=True):
        count_of[red, green, blue] = count
    return count_of


def largest_object(camera: RawCamera, colors: Mapping[str, Color]) -> str | None:
    """Return the object with the most pixels straight ahead of a ``camera``; None for none.

    ``colors`` are those of the objects in masks.
    """
    camera.go(0)
    names = {colors[name]: name for name in colors}
    areas = {}
    for color, count in color_counts(camera.pixels("object_mask")).items():
        if color in names:
            areas[names[color]] = count
    return max(areas, key=areas.__getitem__, default=None)


def alike(depth: NDArray[Any], other: NDArray[Any]) -> bool:
    """Return whether two frames, ``depth`` and ``other``, show the same but for noise and small movers."""
    return bool(np.isclose(depth, other, rtol=_NOISE).mean() > 1 - _MOVING)


def across(width: int, height: int) -> float:
    """Return the horizontal field of view, degrees, of ``width`` by ``height`` px that see 90 up and down."""
    return pinhole.fov_deg(width, height / 2)


class MovingWorld:
    """The objects and the clock of a game that the doctor examines; it is left as it was."""

    def __init__(self, connection: Connection, camera: RawCamera) -> None:
        self._connection = connection
        self._camera = camera
        self._clock = clock_of(camera.driver)
        self._can_stop = False  # whether it moves, and can be paused

    def findings(self) -> list[Finding]:
        """Return three findings: the world moves, the world pauses, captures follow a move."""
        moving = self._moving()
        value = f"yes: {_listed(moving)}" if moving else "no"
        moves = Finding.unless(not moving, "world moves", value, "warning", "--set freeze=puppet, or pause")
        try:
            with self._paused():
                self._can_stop = bool(moving)
                return [moves, self._pauses(), self._follows()]
        except ServerRefusedError as refused:
            pauses = Finding("world pauses", f"no: {refused}", "warning", "--set freeze=batch, or none")
            return [moves, pauses, self._follows()]

    def still(self) -> AbstractContextManager[None]:
        """Return a context in which a moving world is paused, after :meth:`findings`."""
        return self._paused() if self._can_stop else nullcontext()

    def _pauses(self) -> Finding:
        if moving := self._moving():
            self._can_stop = False
            value = f"no: {_listed(moving)} still moving"
            return Finding("world pauses", value, "bad", "--set freeze=batch, with branch 5.2; or stop them")
        how = "pauses" if self._connection.supports(IS_PAUSED) else "toggles"
        return Finding("world pauses", f"yes, by a command that {how}")

    def _follows(self) -> Finding:
        """Move the movable object with the most pixels, and count the frames that do not show it yet."""
        title = "captures follow a move"
        movable = movable_objects(self._connection)
        table = colors(self._connection)
        name = largest_object(self._camera, {key: table[key] for key in table if key in movable})
        if name is None:
            return Finding(title, "unknown: nothing in sight can be moved", "warning", "give --position")

        def move(x: float, y: float, z: float) -> None:
            """Move the object to ``x``, ``y``, ``z``, in the server's unit and frame."""
            self._connection.text(f"vset {location} {x:.6f} {y:.6f} {z:.6f}")

        location = f"/object/{name}/location"
        start = np.array(numbers(self._connection.text(f"vget {location}"), 3))
        before = self._camera.pixels("depth")
        try:
            move(*(start + _AWAY_CM))
            frames = [self._camera.pixels("depth") for _ in range(_FRAMES)]
        finally:
            move(*start)
        changed = ~np.isclose(before, frames[-1], rtol=_NOISE)
        if not changed.any():
            return Finding(title, f"never: {name} stays", "warning", "set its mobility to Movable")
        count = 0
        for number, frame in enumerate(frames, start=1):
            if np.isclose(frame, frames[-1], rtol=_NOISE)[changed].mean() <= 0.5:
                count = number
        value = f"stale ticks: {count}" if count else "at once"
        remedy = f"at most {SETTLED} are waited for: raise the frame rate"
        return Finding.unless(count <= SETTLED, title, value, "bad", remedy)

    def _moving(self) -> list[str]:
        """Return the names of objects that move while some ticks go by."""
        names = object_names(self._connection)
        first = object_poses(self._connection, names)
        moving = set()
        for ticks in (_TICKS, 1):  # an object that swings may be back at its pose once, but not twice
            for _ in range(ticks):
                self._connection.text(VERSION)
            poses = object_poses(self._connection, names)
            for name in names:
                if first[name].to_dict() != poses[name].to_dict():
                    moving.add(name)
        return [name for name in names if name in moving]

    @contextmanager
    def _paused(self) -> Iterator[None]:
        before = self._clock.paused
        self._clock.set(True)
        try:
            yield
        finally:
            self._clock.set(before)


def _listed(names: list[str]) -> str:
    more = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {more} more" if more > 0 else "")
