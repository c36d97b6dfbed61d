"""The running world behind a live source: its objects and its clock, and how it is kept at an instant."""

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from typing import Literal

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import ServerRefusedError, SourceError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.sources.base import known_objects
from omniscv.sources.unreal.driver import CameraDriver
from omniscv.sources.unreal.instants import (
    UNSEEN,
    Journal,
    Key,
    Layer,
    clock_of,
    locations_and_rotations,
    movable_objects,
    object_names,
    object_poses,
    pose_commands,
    same_pose,
    set_commands,
)
from omniscv.sources.unreal.objects import upright_box
from omniscv.sources.unreal.protocol import BOUNDS, DIALECTS, changes_world, described, numbers
from omniscv.sources.world import Freeze, World


class UnrealWorld(World):
    """Objects and clock of a game, whose state the journal knows.

    Methods take turns with captures; after a change the next capture waits until frames show it. ``freeze``
    is how an instant is kept, ``puppet`` for ``auto``: every dialect can pause, and the poses are then known
    exactly. Raises ServerRefusedError if the dialect cannot freeze the world so.
    """

    def __init__(self, driver: CameraDriver, journal: Journal, freeze: Freeze) -> None:
        self._driver = driver
        self._connection = driver.connection
        self._journal = journal
        self._clock = clock_of(driver)
        self._stands = False  # whether it was paused here
        self.freeze = "puppet" if freeze == "auto" else freeze
        if freeze == "batch" and not DIALECTS[self._connection.plugin.dialect].batches:
            raise self._cannot("answer a batch in one tick")

    def objects(self) -> list[str]:
        with self._journal.turn():
            return sorted(object_names(self._connection))

    def pose(self, name: str) -> Pose:
        with self._turn_for(name):
            return object_poses(self._connection, [name])[name]

    def bounds(self, name: str) -> ObjectBox:
        if not self._connection.supports(BOUNDS):
            raise self._cannot("read the bounds of objects")
        with self._turn_for(name):
            reply = self._connection.text(f"vget /object/{name}/bounds")
        box = upright_box(np.array(numbers(reply, 6)).reshape(2, 3))
        if box is None:
            raise ServerRefusedError(f"{shown(name)}: expected an object with a shape, got one without")
        return box

    def move(self, name: str, pose: Pose) -> None:
        """Move the object ``name`` to a ``pose``, and wait until captures show it."""
        with self._turn_for(name):
            self._place({name: pose})
            self._driver.settle()

    def show(self, name: str) -> None:
        with self._turn_for(name):
            with self._journal.unless_refused():
                if self._journal.value("hidden", name):
                    self._journal.note("hidden", name, None, (_hide_command(name),))
                else:  # whether it was hidden cannot be read, so this cannot be put back
                    self._journal.note("shown", name, True)
                self._connection.set([_show_command(name)])
            self._driver.settle()

    def hide(self, name: str) -> None:
        with self._turn_for(name):
            self.hide_all([name])
            self._driver.settle()

    def pause(self) -> None:
        self._set_paused(True)

    def resume(self) -> None:
        self._set_paused(False)

    @property
    def paused(self) -> bool:
        with self._journal.turn():
            return self._clock.paused

    @contextmanager
    def changes(self) -> Iterator[None]:
        with self._journal.turn():
            layer = self._journal.open()
        try:
            yield
        except BaseException:
            with suppress(SourceError):  # the first fault is the one to raise
                self.put_back(layer)
            raise
        self.put_back(layer)

    def send(self, command: str) -> str:
        """Return the reply to any command, the size and format of a binary one; the state may change."""
        with self._journal.turn(), self._journal.unless_refused():
            if changes_world(command):
                sent = self._journal.value("commands") or ""
                digest = hashlib.sha256(f"{sent}\n{command}".encode()).hexdigest()[:16]
                self._journal.note("commands", "", digest)
            reply = self._connection.reply(command)
            if not command.startswith("vget "):
                self._driver.settle()
            return described(reply)

    def set_instant(self, instant: Instant) -> None:
        """Bring the world to an instant; to be used within a turn and an open layer of the journal.

        With ``pause`` it stays where it is: the poses of the instant's objects, or of every movable one, are
        read.
        """
        self.check({*instant.poses, *instant.hidden, *instant.varied.get("objects", {})})
        if self.freeze in ("puppet", "pause"):
            self._set_paused(True)
        if self.freeze == "pause":
            objects = instant.poses or movable_objects(self._connection)
            for name, pose in object_poses(self._connection, objects).items():
                self._journal.note("seen", name, pose, ())
        else:
            self._place(instant.poses)
            if instant.time is not None:
                self._journal.note("time", "", instant.time, ())
        if instant.name:
            self._journal.note("name", "", instant.name, ())
        poses, undrawn = instant.placed(partial(object_poses, self._connection))
        self._place(poses, "drawn")
        self._connection.ask(_commands(instant))
        self.hide_all(sorted(instant.hidden))
        self.hide_all(sorted(undrawn), "drawn out")

    def check(self, objects: Collection[str]) -> None:
        """Raise ArgumentError for a name that no object has; to be used within a turn."""
        if objects:
            known_objects(objects, object_names(self._connection), self._connection.address)

    def hide_all(
        self, objects: Iterable[str], what: Literal["hidden", "left out", "drawn out"] = "hidden"
    ) -> None:
        """Hide ``objects`` in the world, or leave them out of captures alone.

        To be used within a turn and an open layer; ``what`` is the kind of change that the journal notes.
        """
        new = [name for name in objects if not self._journal.value(what, name)]
        invisible = set(self._hidden())
        visible = [name for name in new if name not in invisible]
        with self._journal.unless_refused():
            for name in new:
                undo = () if name in invisible else (_show_command(name),)
                self._journal.note(what, name, True, undo)
            try:
                self._connection.set(list(map(_hide_command, visible)))
            except ServerRefusedError:
                self._connection.texts(list(map(_show_command, visible)))
                raise

    def _hidden(self) -> list[str]:
        """Return the objects that are hidden for any reason, those of a kind of change together."""
        hidden: list[str] = []
        for kind in UNSEEN:
            hidden += self._journal.named(kind)
        return hidden

    def set_again(self) -> None:
        """Repeat all settings over a new connection: the game may have started anew."""
        if self._stands:
            self._clock.set(True)
        seen = self._journal.named("seen")
        poses = object_poses(self._connection, seen)
        if not all(same_pose(poses[name], seen[name]) for name in seen):
            self._journal.forget("seen")
            address = self._connection.address
            raise ServerRefusedError(f"{address}: expected objects where they were read, got them elsewhere")
        self._connection.set(pose_commands({**self._journal.named("pose"), **self._journal.named("drawn")}))
        self._connection.ask(_commands(self._journal.instant))
        self._connection.set(list(map(_hide_command, self._hidden())))

    def put_back(self, layer: Layer) -> None:
        """Undo a layer's changes, the last one first; a refusal does not stop the others. Nothing once it is
        closed.

        Raises SourceError if the server is gone, or refused; the state keeps what was not put back.
        """
        with self._journal.lock:
            self._journal.close(layer)
            if not layer or self._journal.closed:
                return
            fault: ServerRefusedError | None = None
            for keys in _steps(layer):
                try:
                    self._undo(layer, keys)
                except ServerRefusedError as refused:
                    if fault is None:
                        fault = refused
                    for key in keys:
                        with suppress(ServerRefusedError):
                            self._undo(layer, [key])
            self._driver.settle()
            if fault is not None:
                raise fault

    def check_lost(self) -> None:
        """Raise SourceError, once, if a restarted game lacks changes that cannot be made again."""
        if lost := self._journal.forget("shown", "commands"):
            expected = f"expected the game in which these were changed: {', '.join(lost)}"
            raise SourceError(f"{self._connection.address}: {expected}; got one that was started anew")

    @contextmanager
    def _turn_for(self, name: str) -> Iterator[None]:
        """A turn about one object; ArgumentError if there is none of that name."""
        with self._journal.turn():
            self.check([name])
            yield

    def _set_paused(self, paused: bool) -> None:
        with self._journal.turn():
            undo = partial(self._set_clock, self._clock.paused)
            with self._journal.unless_refused():
                self._journal.note("paused", "", None, undo)
                self._set_clock(paused)

    def _set_clock(self, paused: bool) -> None:
        self._clock.set(paused)
        self._stands = paused

    def _place(self, poses: Mapping[str, Pose], what: Literal["pose", "drawn"] = "pose") -> None:
        """Move and turn objects; if one cannot be moved, restore all and raise ServerRefusedError."""
        texts = locations_and_rotations(self._connection, poses)
        restoring: list[str] = []
        with self._journal.unless_refused():
            for name, location, rotation in zip(poses, texts[::2], texts[1::2], strict=True):
                undo = set_commands(name, location, rotation)
                restoring += undo
                self._journal.note(what, name, poses[name], undo)
            try:
                try:
                    self._connection.set(pose_commands(poses))
                except ServerRefusedError:  # plugin 0.3.10 refuses to move a static object
                    self._check_placed(poses)
                    raise
                self._check_placed(poses)  # the others reply ok
            except ServerRefusedError:
                self._connection.texts(restoring)
                raise

    def _check_placed(self, poses: Mapping[str, Pose]) -> None:
        """Raise ServerRefusedError for an object that did not move and is not movable."""
        for name, actual in object_poses(self._connection, poses).items():
            if not same_pose(actual, poses[name]):
                mobility = self._connection.text(f"vget /object/{name}/mobility")
                if mobility != "Movable":
                    expected = f"expected an object that can be moved, got {shown(name)}"
                    address = self._connection.address
                    raise ServerRefusedError(f"{address}: {expected}, whose mobility is {shown(mobility)}")

    def _undo(self, layer: Layer, keys: list[Key]) -> None:
        commands: list[str] = []
        functions: list[Callable[[], None]] = []
        for key in keys:
            _, undo = layer[key]
            if callable(undo):
                functions.append(undo)
            else:
                commands += undo
        self._connection.set(commands)
        for function in functions:
            function()
        for key in keys:
            self._journal.undone(layer, key)

    def _cannot(self, what: str) -> ServerRefusedError:
        dialect = self._connection.plugin.dialect
        plugin = f"{DIALECTS[dialect].plugin}, dialect {dialect}"
        return ServerRefusedError(f"expected a server that can {what}, got {plugin}")


def _commands(instant: Instant) -> list[str]:
    """Return the commands of draws; no reply says what was before, so they stay until the next draw."""
    commands = []
    for kind in ("lights", "materials"):
        for settings in instant.varied.get(kind, {}).values():
            commands.append(settings["command"])
    return commands


def _show_command(name: str) -> str:
    return f"vset /object/{name}/show"


def _hide_command(name: str) -> str:
    return f"vset /object/{name}/hide"


def _steps(layer: Layer) -> list[list[Key]]:
    """Return the keys from the last to the first; those that are undone by commands go together."""
    steps: list[list[Key]] = []
    for key in reversed(layer):
        if callable(layer[key][1]) or not steps or callable(layer[steps[-1][0]][1]):
            steps.append([])
        steps[-1].append(key)
    return steps
