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
        self._described = (0, Instant())  # a number of changes, and the instant after them

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
        described, instant = self._described
        if described != changes:
            instant = self._describe()
            self._described = (changes, instant)
        return instant

    def _describe(self) -> Instant:
        """Return the instant that all changes until now have led to."""
        values = self._values.copy()  # other threads may change the world meanwhile
        poses = {**_of_kind(values, "seen"), **_of_kind(values, "pose")}
        hidden = frozenset(_of_kind(values, "hidden"))
        labels = [values["name", ""]] if ("name", "") in values else []
        for key in sorted(values):
            if key[0] not in _KNOWN:
                labels.append(f"{' '.join(key).strip()}: {values[key]}")
        return Instant(MappingProxyType(poses), hidden, values.get(("time", "")), "; ".join(labels))

    def value(self, what: str, name: str = "") -> Any:
        """Return what was set of the kind ``what``, of the object ``name``; None for what was not changed."""
        return self._values.get((what, name))

    def named(self, what: str) -> dict[str, Any]:
        """Return what was set of the kind ``what``, by the names of the objects."""
        return _of_kind(self._values, what)

    def open(self) -> Layer:
        """Return a new layer, which records all changes from now on."""
        self.layers.append({})
        return self.layers[-1]

    def close(self, layer: Layer) -> None:
        """Remove a layer."""
        self.layers = [other for other in self.layers if other is not layer]

    def note(self, what: str, name: str, value: Any, undo: Undo | None = None) -> None:
        """Note a change before it is made.

        Args:
            what: its kind, such as ``pose``.
            name: of the object; empty for changes of the game.
            value: from now on; None for the value from before any change.
            undo: how to put the change back; None if it stays.
        """
        key = (what, name)
        if undo is not None:
            for layer in self.layers:
                layer.setdefault(key, (self._values.get(key), undo))
        self._set(key, value)

    def undone(self, layer: Layer, key: Key) -> None:
        """Note that a ``layer``'s change of ``key`` was put back."""
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


def _of_kind(values: Mapping[Key, Any], what: str) -> dict[str, Any]:
    """Return the values of one kind of change, by the names of the objects."""
    by_name = {}
    for (kind, name), value in values.items():
        if kind == what:
            by_name[name] = value
    return by_name


_CAMERAS = "FusionCameraActor"  # how the plugin names the actors of cameras
# By how much poses that are equal may differ: 0.3.10 prints two decimals of cm and degrees.
_PRINTED_M = 1.1e-4  # positions
_PRINTED = 4e-4  # entries of a rotation


def object_names(connection: Connection) -> list[str]:
    """Return the names of all objects, in the server's order."""
    return names(connection.text(OBJECTS))


def movable_objects(connection: Connection) -> list[str]:
    """Return the names of the objects that the game may move, without cameras."""
    objects = [name for name in object_names(connection) if not name.startswith(_CAMERAS)]
    mobilities = connection.texts([f"vget /object/{name}/mobility" for name in objects])
    movable = []
    for name, mobility in zip(objects, mobilities, strict=True):
        if mobility == "Movable":
            movable.append(name)
    return movable


def object_poses(connection: Connection, objects: Iterable[str]) -> dict[str, Pose]:
    """Return the poses of ``objects``, read over a ``connection``: ``R_w_o`` and position, world frame."""
    objects = list(objects)
    values = [np.array(numbers(text, 3)) for text in locations_and_rotations(connection, objects)]
    poses = {}
    for name, location_cm, rotation_deg in zip(objects, values[::2], values[1::2], strict=True):
        poses[name] = Pose(position_from_unreal(location_cm), rotation_from_unreal(rotation_deg))
    return poses


def locations_and_rotations(connection: Connection, objects: Iterable[str]) -> list[str]:
    """Return locations and rotations of ``objects`` in turn, as the server of ``connection`` prints them."""
    commands = []
    for name in objects:
        commands.append(f"vget /object/{name}/location")
        commands.append(f"vget /object/{name}/rotation")
    return connection.ask(commands)


def set_commands(name: str, location: str, rotation: str) -> tuple[str, str]:
    """Return the commands that set ``location`` (cm) and ``rotation`` (degrees) of the object ``name``."""
    return f"vset /object/{name}/location {location}", f"vset /object/{name}/rotation {rotation}"


def pose_commands(poses: Mapping[str, Pose]) -> list[str]:
    """Return commands that set poses of objects, world frame, with fixed decimals, as servers parse them."""
    commands: list[str] = []
    for name, pose in poses.items():
        location = _fixed(position_to_unreal(pose.position))
        rotation = _fixed(rotation_to_unreal(pose.rotation))
        commands += set_commands(name, location, rotation)
    return commands


def _fixed(values: Iterable[float]) -> str:
    return " ".join(f"{value:.6f}" for value in values)


def same_pose(pose: Pose, other: Pose) -> bool:
    """Return whether a ``pose`` and another (``other``) are equal as far as servers print them."""
    moved = np.abs(pose.position - other.position).max()
    turned = np.abs(pose.rotation - other.rotation).max()
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
