"""Changes of a running world, and how they are put back; the poses of its objects, and its clock."""

import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any, Literal

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
from omniscv.sources.base import closed_error, known_objects
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.commands import IS_PAUSED, OBJECTS, PAUSE, RESUME
from omniscv.sources.unreal.driver import CameraDriver
from omniscv.sources.unreal.replies import names, numbers


class Turns:
    """The lock by which threads take turns: one captures a viewpoint, or sends commands that belong together.

    Attributes:
        lock: held for one turn.
        closed: whether the source is closed, so that there are no more turns.
    """

    def __init__(self, address: str) -> None:
        self._address, self.lock, self.closed = address, threading.RLock(), False

    @contextmanager
    def turn(self) -> Iterator[None]:
        """A context of commands that belong together; SourceError once the source is closed."""
        with self.lock:
            if self.closed:
                raise closed_error(self._address)
            yield


# -- the journal ----------------------------------------------------------------------------------------

Key = tuple[str, str]
"""What was changed, such as ``pose``, and the object's name; empty for what is no object's."""
Undo = tuple[str, ...] | Callable[[], None]
"""How a change is put back: commands that set the values from before, or a function."""
Layer = dict[Key, tuple[Any, Undo]]
"""By key: the value before the layer's first change of it, and how to put it back."""

_KNOWN = ("pose", "seen", "hidden", "left out", "time", "name")
"""What an instant describes: poses that were set, or seen. Objects left out of captures are in no state."""


class Journal:
    """The values that were set, and layers of how to put them back.

    A layer is open from the beginning of some changes until they are put back.
    """

    def __init__(self) -> None:
        self.layers: list[Layer] = []
        self._values: dict[Key, Any] = {}

    @property
    def instant(self) -> Instant:
        """What is known of the world as it is now; other changes than an instant's are in its name."""
        values = self._values.copy()  # other threads may change the world meanwhile
        poses = {name: value for (what, name), value in values.items() if what == "seen"}
        poses |= {name: value for (what, name), value in values.items() if what == "pose"}
        hidden = frozenset(name for what, name in values if what == "hidden")
        labels = [values["name", ""]] if ("name", "") in values else []
        others = sorted(key for key in values if key[0] not in _KNOWN)
        labels += [f"{_label(key)}: {values[key]}" for key in others]
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
        """Note a change before it is made, so that it is put back however making it ends.

        A value of None is the one from before any change. Without ``undo`` the value stays for good.
        """
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
        values, layers = self._values.copy(), [layer.copy() for layer in self.layers]
        try:
            yield
        except ServerRefusedError:
            for layer, before in zip(self.layers, layers, strict=True):
                layer.clear()
                layer.update(before)
            self._values = values
            raise

    def forget(self, *kinds: str) -> list[str]:
        """Forget changes that the game has lost; return what they were."""
        lost = [key for key in self._values if key[0] in kinds]
        for key in lost:
            self._set(key, None)
            for layer in self.layers:
                layer.pop(key, None)
        return [_label(key) for key in lost]

    def _set(self, key: Key, value: Any) -> None:
        if value is None:
            self._values.pop(key, None)
        else:
            self._values[key] = value


def put_back(driver: CameraDriver, turns: Turns, journal: Journal, layer: Layer) -> None:
    """Undo a layer's changes, the last one first; what is refused does not keep others from being undone.

    Nothing is done after the source is closed, which has put back all it could.

    Raises:
        SourceError: the server is gone, or what it refused first; the state keeps what was not put back.
    """
    with turns.lock:
        journal.close(layer)
        if not layer or turns.closed:
            return
        fault: ServerRefusedError | None = None
        for keys in _steps(layer):
            try:
                _undo(driver.connection, journal, layer, keys)
            except ServerRefusedError as refused:
                fault = fault or refused
                for key in keys:
                    try:
                        _undo(driver.connection, journal, layer, [key])
                    except ServerRefusedError:
                        continue
        driver.settle()
        if fault is not None:
            raise fault


def _steps(layer: Layer) -> list[list[Key]]:
    """Return the keys from the last to the first; those that are undone by commands go together."""
    steps: list[list[Key]] = []
    for key in reversed(layer):
        if callable(layer[key][1]) or not steps or callable(layer[steps[-1][0]][1]):
            steps.append([])
        steps[-1].append(key)
    return steps


def _undo(connection: Connection, journal: Journal, layer: Layer, keys: list[Key]) -> None:
    undos = [layer[key][1] for key in keys]
    connection.set([command for undo in undos if not callable(undo) for command in undo])
    for undo in undos:
        if callable(undo):
            undo()
    for key in keys:
        journal.undone(layer, key)


def _label(key: Key) -> str:
    return " ".join(filter(None, key))


# -- objects --------------------------------------------------------------------------------------------

_PRINTED_M, _PRINTED = 1.1e-4, 4e-4  # of positions, and entries of a rotation: 0.3.10 prints two decimals
_CAMERAS = "FusionCameraActor"  # how the plugin names the actors of cameras


def object_names(connection: Connection) -> list[str]:
    """Return the names of all objects, in the server's order."""
    return names(connection.text(OBJECTS))


def object_poses(connection: Connection, objects: Iterable[str]) -> dict[str, Pose]:
    """Return the poses of objects: ``R_w_o`` and position."""
    objects = list(objects)
    values = [np.array(numbers(text, 3)) for text in _locations_and_rotations(connection, objects)]
    rows = zip(objects, values[::2], values[1::2], strict=True)
    return {name: Pose(position_from_unreal(p), rotation_from_unreal(r)) for name, p, r in rows}


class Objects:
    """Moves and hides objects of a game; to be used within a turn."""

    def __init__(self, connection: Connection, journal: Journal) -> None:
        self._connection, self._journal = connection, journal

    def check(self, objects: Collection[str]) -> None:
        """Raise ArgumentError for a name that no object has."""
        if objects:
            known_objects(objects, object_names(self._connection), self._connection.address)

    def movable(self) -> list[str]:
        """Return the names of the objects that the game may move."""
        objects = [name for name in object_names(self._connection) if not name.startswith(_CAMERAS)]
        mobilities = self._connection.texts([f"vget /object/{name}/mobility" for name in objects])
        return [name for name, mobility in zip(objects, mobilities, strict=True) if mobility == "Movable"]

    def place(self, poses: Mapping[str, Pose]) -> None:
        """Move and turn objects; ServerRefusedError, and all as before, if one cannot be moved."""
        texts = _locations_and_rotations(self._connection, poses)
        before = dict(zip(poses, zip(texts[::2], texts[1::2], strict=True), strict=True))
        back = {name: _set_commands(name, *values) for name, values in before.items()}
        with self._journal.unless_refused():
            for name, pose in poses.items():
                self._journal.note("pose", name, pose, back[name])
            try:
                self._connection.set(_pose_commands(poses))
                self._check_placed(poses)
            except ServerRefusedError:
                self._connection.texts([command for commands in back.values() for command in commands])
                raise

    def hide(self, objects: Iterable[str], what: Literal["hidden", "left out"] = "hidden") -> None:
        """Hide objects: in the world, or only ``left out`` of its captures, which is not in the state."""
        new = [name for name in objects if not self._journal.value(what, name)]
        either = ("hidden", "left out")
        visible = [name for name in new if not any(self._journal.value(key, name) for key in either)]
        back = {name: f"vset /object/{name}/show" for name in visible}
        with self._journal.unless_refused():
            for name in new:
                self._journal.note(what, name, True, (back[name],) if name in back else ())
            try:
                self._connection.set([f"vset /object/{name}/hide" for name in visible])
            except ServerRefusedError:
                self._connection.texts(list(back.values()))
                raise

    def set_again(self) -> None:
        """Place and hide what is placed and hidden: the game may have been restarted."""
        seen = self._journal.named("seen")
        if any(not _same(pose, seen[name]) for name, pose in object_poses(self._connection, seen).items()):
            self._journal.forget("seen")
            address = self._connection.address
            raise ServerRefusedError(f"{address}: expected objects where they were read, got them elsewhere")
        self._connection.set(_pose_commands(self._journal.named("pose")))
        hidden = [*self._journal.named("hidden"), *self._journal.named("left out")]
        self._connection.set([f"vset /object/{name}/hide" for name in hidden])

    def _check_placed(self, poses: Mapping[str, Pose]) -> None:
        """Raise ServerRefusedError for an object that did not move and never can."""
        for name, actual in object_poses(self._connection, poses).items():
            if not _same(actual, poses[name]):
                mobility = self._connection.text(f"vget /object/{name}/mobility")
                if mobility != "Movable":
                    expected = f"expected an object that can be moved, got {shown(name)}"
                    address = self._connection.address
                    raise ServerRefusedError(f"{address}: {expected}, whose mobility is {shown(mobility)}")


def _locations_and_rotations(connection: Connection, objects: Iterable[str]) -> list[str]:
    """Return locations and rotations in turn, as the server prints them."""
    return connection.ask([f"vget /object/{o}/{what}" for o in objects for what in ("location", "rotation")])


def _pose_commands(poses: Mapping[str, Pose]) -> list[str]:
    """Return the commands that set poses, with fixed decimals, as servers parse them."""
    commands: list[str] = []
    for name, pose in poses.items():
        values = position_to_unreal(pose.position), rotation_to_unreal(pose.rotation)
        commands += _set_commands(name, *(" ".join(f"{number:.6f}" for number in row) for row in values))
    return commands


def _set_commands(name: str, location: str, rotation: str) -> tuple[str, str]:
    return f"vset /object/{name}/location {location}", f"vset /object/{name}/rotation {rotation}"


def _same(a: Pose, b: Pose) -> bool:
    """Return whether poses are equal as far as servers print them."""
    moved, turned = np.abs(a.position - b.position).max(), np.abs(a.rotation - b.rotation).max()
    return bool(moved <= _PRINTED_M and turned <= _PRINTED)


# -- the clock ------------------------------------------------------------------------------------------

_ROTATION = "vget /camera/0/rotation"
_READINGS = 5  # each comes at least a tick later
_TURN = (0.0, -30.0, 0.0)


class Clock:
    """The clock of plugin 1.x."""

    def __init__(self, driver: CameraDriver) -> None:
        self._driver, self._connection = driver, driver.connection

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
            address, what = self._connection.address, "stands still" if paused else "goes on"
            expected = f"expected a game that {what} after {PAUSE!r}"
            raise ServerRefusedError(f"{address}: {expected}, but it does not")

    def _rotation(self) -> tuple[float, ...]:
        return tuple(numbers(self._connection.text(_ROTATION), 3))

    def _turn(self, rotation: tuple[float, ...]) -> None:
        self._connection.set(["vset /camera/0/rotation {:.3f} {:.3f} {:.3f}".format(*rotation)])


def clock_of(driver: CameraDriver, pause_toggles: bool) -> Clock:
    """Return the clock of a dialect."""
    return TogglingClock(driver) if pause_toggles else Clock(driver)
