"""The journal of changes of a running world; the poses of its objects, and its clock."""

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import BadReplyError, ServerRefusedError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.unreal_frame import (
    position_from_unreal,
    position_to_unreal,
    rotation_from_unreal,
    rotation_to_unreal,
)
from omniscv.sources.base import closed_error
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.driver import CameraDriver
from omniscv.sources.unreal.protocol import IS_PAUSED, OBJECTS, PAUSE, RESUME, names, numbers

Key = tuple[str, str]
"""The kind of a change, such as ``pose``, and the object's name, which is empty for changes of the game."""
Undo = tuple[str, ...] | Callable[[], None]
"""How a change is put back: commands that set the values from before, or a function."""
Layer = dict[Key, tuple[Any, Undo]]
"""By key: the value before the layer's first change of it, and how to put it back."""

UNSEEN = ("hidden", "left out", "drawn out")
"""Kinds of change that hide an object."""
_KNOWN = ("pose", "seen", "time", "name", "drawn", *UNSEEN)
"""Kinds of change that an instant describes, or that belong to no state.

``pose`` was set, ``seen`` is a pose that was read; objects ``left out`` of captures are in no state. Poses
``drawn`` and objects ``drawn out`` are those of the draws that are the instant's name.
"""


class Journal:
    """The values that were set, and layers of undo steps: the changes since a layer was opened, to put back.

    Attributes:
        lock: held for one turn: captures of a viewpoint, or commands that belong together.
        closed: whether the source is closed, so that there are no more turns.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self.lock = threading.RLock()
        self.closed = False
        self.layers: list[Layer] = []
        self._values: dict[Key, Any] = {}
        self._changes = 0
        self._described = 0, Instant()  # the instant after so many changes

    @contextmanager
    def turn(self) -> Iterator[None]:
        """A context of commands that belong together; SourceError once the source is closed."""
        with self.lock:
            if self.closed:
                raise closed_error(self._address)
            yield

    @property
    def instant(self) -> Instant:
        """The known state of the world now; changes that an instant does not describe are in its name."""
        changes = self._changes
        (described, instant) = self._described
        if described != changes:
            instant = self._describe()
            self._described = changes, instant
        return instant

    def _describe(self) -> Instant:
        values = self._values.copy()  # other threads may change the world meanwhile
        poses = {name: value for (what, name), value in values.items() if what == "seen"}
        poses |= {name: value for (what, name), value in values.items() if what == "pose"}
        hidden = frozenset(name for what, name in values if what == "hidden")
        labels = [values["name", ""]] if ("name", "") in values else []
        others = sorted(key for key in values if key[0] not in _KNOWN)
        labels += [f"{' '.join(key).strip()}: {values[key]}" for key in others]
        return Instant(MappingProxyType(poses), hidden, values.get(("time", "")), "; ".join(labels))

    def value(self, what: str, name: str = "") -> Any:
        """Return what was set; None for what was not changed."""
        return self._values.get((what, name))

    def named(self, what: str) -> dict[str, Any]:
        """Return what was set, by the names of the objects."""
        return {name: value for (key, name), value in self._values.items() if key == what}

    def open(self) -> Layer:
        """Return a new layer, which records all changes from now on."""
        self.layers.append({})
        return self.layers[-1]

    def close(self, layer: Layer) -> None:
        """Remove a layer."""
        self.layers = [other for other in self.layers if other is not layer]

    def note(self, what: str, name: str, value: Any, undo: Undo | None = None) -> None:
        """Note a change before it is made, None for the value from before any; without ``undo`` it stays."""
        key = what, name
        if undo is not None:
            for layer in self.layers:
                layer.setdefault(key, (self._values.get(key), undo))
        self._set(key, value)

    def undone(self, layer: Layer, key: Key) -> None:
        """Note that a layer's change was put back."""
        value, _ = layer.pop(key)
        self._set(key, value)

    @contextmanager
    def unless_refused(self) -> Iterator[None]:
        """A context in which changes are noted and made; forget them if the server refuses them."""
        values = self._values.copy()
        layers = [layer.copy() for layer in self.layers]
        try:
            yield
        except ServerRefusedError:
            for layer, before in zip(self.layers, layers, strict=True):
                layer.clear()
                layer.update(before)
            self._values = values
            self._changes += 1
            raise

    def forget(self, *kinds: str) -> list[str]:
        """Forget changes that the game has lost; return what they were."""
        lost = [key for key in self._values if key[0] in kinds]
        for key in lost:
            self._set(key, None)
            for layer in self.layers:
                layer.pop(key, None)
        return [" ".join(key).strip() for key in lost]

    def _set(self, key: Key, value: Any) -> None:
        if value is None:
            self._values.pop(key, None)
        else:
            self._values[key] = value
        self._changes += 1  # after the change: an instant that another thread describes meanwhile is older


_CAMERAS = "FusionCameraActor"  # how the plugin names the actors of cameras
# of positions, and entries of a rotation: 0.3.10 prints two decimals
_PRINTED_M = 1.1e-4
_PRINTED = 4e-4


def object_names(connection: Connection) -> list[str]:
    """Return the names of all objects, in the server's order."""
    return names(connection.text(OBJECTS))


def movable_objects(connection: Connection) -> list[str]:
    """Return the names of the objects that the game may move, without cameras."""
    objects = [name for name in object_names(connection) if not name.startswith(_CAMERAS)]
    mobilities = connection.texts([f"vget /object/{name}/mobility" for name in objects])
    return [name for name, mobility in zip(objects, mobilities, strict=True) if mobility == "Movable"]


def object_poses(connection: Connection, objects: Iterable[str]) -> dict[str, Pose]:
    """Return the poses of objects: ``R_w_o`` and position."""
    objects = list(objects)
    values = [np.array(numbers(text, 3)) for text in locations_and_rotations(connection, objects)]
    rows = zip(objects, values[::2], values[1::2], strict=True)
    return {name: Pose(position_from_unreal(p), rotation_from_unreal(r)) for name, p, r in rows}


def locations_and_rotations(connection: Connection, objects: Iterable[str]) -> list[str]:
    """Return locations and rotations in turn, as the server prints them."""
    return connection.ask([f"vget /object/{o}/{what}" for o in objects for what in ("location", "rotation")])


def set_commands(name: str, location: str, rotation: str) -> tuple[str, str]:
    """Return the commands that set an object's location and rotation."""
    return f"vset /object/{name}/location {location}", f"vset /object/{name}/rotation {rotation}"


def pose_commands(poses: Mapping[str, Pose]) -> list[str]:
    """Return the commands that set poses, with fixed decimals, as servers parse them."""
    commands: list[str] = []
    for name, pose in poses.items():
        values = position_to_unreal(pose.position), rotation_to_unreal(pose.rotation)
        commands += set_commands(name, *(" ".join(f"{number:.6f}" for number in row) for row in values))
    return commands


def same_pose(a: Pose, b: Pose) -> bool:
    """Return whether poses are equal as far as servers print them."""
    moved = np.abs(a.position - b.position).max()
    turned = np.abs(a.rotation - b.rotation).max()
    return bool(moved <= _PRINTED_M and turned <= _PRINTED)


_ROTATION = "vget /camera/0/rotation"
_READINGS = 5  # each comes at least a tick later
_TURN = (0.0, -30.0, 0.0)


class Clock:
    """The clock of plugin 1.x."""

    def __init__(self, driver: CameraDriver) -> None:
        self._driver = driver
        self._connection = driver.connection

    @property
    def paused(self) -> bool:
        """Whether the game stands still."""
        reply = self._connection.text(IS_PAUSED)
        if reply not in ("true", "false"):
            address = self._connection.address
            raise BadReplyError(f"{address}: expected true or false from {IS_PAUSED!r}, got {shown(reply)}")
        return reply == "true"

    def set(self, paused: bool) -> None:
        """Pause the game, or let it run; ServerRefusedError if it does not."""
        if self.paused != paused:
            self._connection.set([PAUSE if paused else RESUME])


class TogglingClock(Clock):
    """The clock of plugin 0.3.10: one command pauses and resumes, and none reports which.

    While a game runs, every tick of its controller wraps the player's angles to 0 to 360 degrees. In a paused
    game a negative angle stays as it was set (protocol reference, section 4).
    """

    @property
    def paused(self) -> bool:
        before = self._rotation()
        try:
            self._turn(_TURN)
            return all(self._rotation()[1] < 0 for _ in range(_READINGS))
        finally:
            self._turn(before)
            self._driver.forget()

    def set(self, paused: bool) -> None:
        if self.paused == paused:
            return
        self._connection.reply(PAUSE)  # sent once: repeated, it would do the contrary
        if self.paused != paused:
            address = self._connection.address
            what = "stands still" if paused else "goes on"
            expected = f"expected a game that {what} after {PAUSE!r}"
            raise ServerRefusedError(f"{address}: {expected}, but it does not")

    def _rotation(self) -> tuple[float, ...]:
        return tuple(numbers(self._connection.text(_ROTATION), 3))

    def _turn(self, rotation: tuple[float, ...]) -> None:
        self._connection.set(["vset /camera/0/rotation {:.3f} {:.3f} {:.3f}".format(*rotation)])


def clock_of(driver: CameraDriver) -> Clock:
    """Return the clock that a driver's server has the commands for."""
    return Clock(driver) if driver.connection.supports(IS_PAUSED) else TogglingClock(driver)
