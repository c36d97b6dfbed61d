"""The running world behind a live source: its objects and its clock, and how it is kept at an instant."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import ServerRefusedError, SourceError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.sources.unreal.boxes import upright_box
from omniscv.sources.unreal.commands import WORLDS, changes_world
from omniscv.sources.unreal.driver import CameraDriver
from omniscv.sources.unreal.instants import (
    Journal,
    Objects,
    Turns,
    clock_of,
    object_names,
    object_poses,
    put_back,
)
from omniscv.sources.unreal.replies import described, numbers
from omniscv.sources.world import Freeze, World


class UnrealWorld(World):
    """Objects and clock of a game. Changes are noted in a journal, which knows the state.

    Methods take turns with captures; after a change the next capture waits until frames show it.

    Args:
        driver: of the capture camera.
        turns: of the source.
        journal: of the source.
        freeze: how an instant is kept.

    Attributes:
        freeze: the same, with ``puppet`` for ``auto``: every dialect can pause, and the poses are then known
            exactly.

    Raises:
        ServerRefusedError: the dialect cannot freeze the world so.
    """

    def __init__(self, driver: CameraDriver, turns: Turns, journal: Journal, freeze: Freeze) -> None:
        self._driver, self._connection = driver, driver.connection
        self._turns, self._journal = turns, journal
        self._table = WORLDS[driver.capabilities.dialect]
        self._objects = Objects(self._connection, journal)
        self._clock = clock_of(driver, self._table.pause_toggles)
        self._stands = False  # whether it was paused here
        self.freeze = "puppet" if freeze == "auto" else freeze
        if freeze == "batch":
            self._table.check(self._table.batches, "answer a batch in one tick")

    def objects(self) -> list[str]:
        with self._turns.turn():
            return sorted(object_names(self._connection))

    def pose(self, name: str) -> Pose:
        with self._turn_for(name):
            return object_poses(self._connection, [name])[name]

    def bounds(self, name: str) -> ObjectBox:
        self._table.check(self._table.reads_bounds, "read the bounds of objects")
        with self._turn_for(name):
            reply = self._connection.text(f"vget /object/{name}/bounds")
        box = upright_box(np.array(numbers(reply, 6)).reshape(2, 3))
        if box is None:
            raise ServerRefusedError(f"{shown(name)}: expected an object with a shape, got one without")
        return box

    def move(self, name: str, pose: Pose) -> None:
        with self._turn_for(name):
            self._objects.place({name: pose})
            self._driver.settle()

    def show(self, name: str) -> None:
        with self._turn_for(name):
            with self._journal.unless_refused():
                if self._journal.value("hidden", name):
                    self._journal.note("hidden", name, None, (f"vset /object/{name}/hide",))
                else:  # whether it was hidden cannot be read, so this cannot be put back
                    self._journal.note("shown", name, True)
                self._connection.set([f"vset /object/{name}/show"])
            self._driver.settle()

    def hide(self, name: str) -> None:
        with self._turn_for(name):
            self._objects.hide([name])
            self._driver.settle()

    def pause(self) -> None:
        self._set_paused(True)

    def resume(self) -> None:
        self._set_paused(False)

    @property
    def paused(self) -> bool:
        with self._turns.turn():
            return self._clock.paused

    @contextmanager
    def changes(self) -> Iterator[None]:
        with self._turns.turn():
            layer = self._journal.open()
        try:
            yield
        except BaseException:
            with suppress(SourceError):  # the first fault is the one to raise
                put_back(self._driver, self._turns, self._journal, layer)
            raise
        put_back(self._driver, self._turns, self._journal, layer)

    def send(self, command: str) -> str:
        """Return the reply to any command, the size and format of a binary one; the state may change."""
        with self._turns.turn(), self._journal.unless_refused():
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

        With ``pause`` it stays where it is: the poses of the instant's objects are read, or, if it has none,
        those of every movable object, and the time is not known.
        """
        self._objects.check({*instant.poses, *instant.hidden})
        if self.freeze in ("puppet", "pause"):
            self._set_paused(True)
        if self.freeze == "pause":
            objects = instant.poses or self._objects.movable()
            for name, pose in object_poses(self._connection, objects).items():
                self._journal.note("seen", name, pose, ())
        else:
            self._objects.place(instant.poses)
            if instant.time is not None:
                self._journal.note("time", "", instant.time, ())
        if instant.name:
            self._journal.note("name", "", instant.name, ())
        self._objects.hide(sorted(instant.hidden))

    def leave_out(self, names: list[str]) -> None:
        """Hide objects from captures only; to be used within a turn and an open layer of the journal."""
        self._objects.hide(names, "left out")

    def check(self, names: list[str]) -> None:
        """Raise ArgumentError for a name that no object has; to be used within a turn."""
        self._objects.check(names)

    def set_again(self) -> None:
        """Set again what was set and can be: with a new connection, the game may be a new one, too."""
        if self._stands:
            self._clock.set(True)
        self._objects.set_again()

    def check_lost(self) -> None:
        """Raise SourceError, once, if a restarted game lacks changes that cannot be made again."""
        if lost := self._journal.forget("shown", "commands"):
            expected = f"expected the game in which these were changed: {', '.join(lost)}"
            raise SourceError(f"{self._connection.address}: {expected}; got one that was started anew")

    @contextmanager
    def _turn_for(self, name: str) -> Iterator[None]:
        """A turn about one object; ArgumentError if there is none of that name."""
        with self._turns.turn():
            self._objects.check([name])
            yield

    def _set_paused(self, paused: bool) -> None:
        with self._turns.turn():
            undo = partial(self._set_clock, self._clock.paused)
            with self._journal.unless_refused():
                self._journal.note("paused", "", None, undo)
                self._set_clock(paused)

    def _set_clock(self, paused: bool) -> None:
        self._clock.set(paused)
        self._stands = paused
