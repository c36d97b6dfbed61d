"""The running world behind a live source, by the commands of its dialect."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import get_args

import numpy as np

from omniscv import arguments
from omniscv.arguments import shown
from omniscv.errors import ArgumentError, ServerRefusedError, SourceError
from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.geometry.unreal_frame import rotation_to_unreal
from omniscv.sources.unreal import replies
from omniscv.sources.unreal.clock import clock_of
from omniscv.sources.unreal.connection import RETRIED
from omniscv.sources.unreal.exchange import Exchange
from omniscv.sources.unreal.journal import Journal, Undo
from omniscv.sources.unreal.mask_colors import paint
from omniscv.sources.unreal.placing import Placing
from omniscv.sources.unreal.putting_back import put_back
from omniscv.sources.unreal.shapes import upright_box
from omniscv.sources.unreal.world_commands import TABLES, changes_world, checked
from omniscv.sources.world import ExposureMethod, World

_CUBE = "CubeActor"  # the plugin's own: its command for cubes takes a name in the newest dialect only
_LOST = ("spawned", "destroyed", "shown", "commands", "exposure")
"""Changes that a game that is started anew has not, and that are not made again."""


class UnrealWorld(World):
    """Objects, clock and console of a game. Changes are noted in a journal, which knows the state.

    Methods take turns with captures; after a change the next capture waits until frames show it.
    ``renew_camera`` replaces the capture camera by one with the engine's own settings.
    """

    def __init__(self, exchange: Exchange, journal: Journal, renew_camera: Callable[[], None]) -> None:
        self._exchange, self._journal, self._renew_camera = exchange, journal, renew_camera
        self._table = TABLES[exchange.driver.capabilities.dialect]
        self._placing = Placing(exchange, journal)
        self._clock = clock_of(exchange, self._table.pause_toggles)
        self._stands = False  # whether it was paused here

    def objects(self) -> list[str]:
        with self._exchange.turn():
            return sorted(self._placing.names())

    def pose(self, name: str) -> Pose:
        with self._of_object(name):
            return self._placing.poses([name])[name]

    def bounds(self, name: str) -> ObjectBox:
        command = self._table.command("read the bounds of objects", name)
        with self._of_object(name):
            corners = np.array(replies.numbers(self._exchange.ask([command])[0], 6)).reshape(2, 3)
        box = upright_box(corners)
        if box is None:
            raise ServerRefusedError(f"{shown(name)}: expected an object with a shape, got one without")
        return box

    def move(self, name: str, pose: Pose) -> None:
        with self._of_object(name):
            self._placing.place({name: pose})
            self._exchange.settle()

    def show(self, name: str) -> None:
        with self._of_object(name):
            with self._journal.unless_refused():
                if self._journal.value("hidden", name):
                    self._journal.note("hidden", name, None, Undo((f"vset /object/{name}/hide",)))
                else:  # whether it was hidden cannot be read, so this cannot be put back
                    self._journal.note("shown", name, True)
                self._exchange.do([f"vset /object/{name}/show"])
            self._exchange.settle()

    def hide(self, name: str) -> None:
        with self._of_object(name):
            self._placing.hide([name])
            self._exchange.settle()

    def spawn(self, kind: str, name: str, pose: Pose) -> None:
        engine_class = _CUBE if kind.lower() == "cube" else _word("kind", kind)
        command = self._table.command("spawn objects", engine_class, _word("name", name))
        with self._exchange.turn():
            if name in self._placing.names():
                raise ArgumentError(f"name: expected one that no object has, got {shown(name)}")
            with self._journal.unless_refused():
                self._journal.note("spawned", name, kind, Undo(run=partial(self._remove, name)))
                try:
                    self._exchange.reply(command)
                except RETRIED:
                    if name not in self._placing.names():
                        raise
                if name not in self._placing.names():
                    raise ServerRefusedError(f"{shown(command)}: expected an object of that name, got none")
            self._placing.place({name: pose})
            # What is spawned late is in no mask and no depth until its colour is set (reference, 2.5).
            paint(self._exchange.connection, self._exchange.driver.table.vertex_colors)
            self._exchange.settle()

    def destroy(self, name: str) -> None:
        command = self._table.command("destroy objects", name)
        with self._of_object(name):
            layers, spawned = self._journal.layers, self._journal.value("spawned", name)
            if layers and ("spawned", name) not in layers[-1]:
                wanted = "expected an object that was spawned within these changes"
                raise ArgumentError(f"name: {wanted}, as no other can be put back; got {shown(name)}")
            with self._journal.unless_refused():
                if spawned is None:
                    self._journal.note("destroyed", name, True)
                self._exchange.reply(command)
            if spawned is not None:
                self._journal.forget(name)
            self._exchange.settle()

    def pause(self) -> None:
        self.set_paused(True)

    def resume(self) -> None:
        self.set_paused(False)

    @property
    def paused(self) -> bool:
        with self._exchange.turn():
            return self._clock.paused

    def console(self, command: str) -> None:
        self.send(self._table.console(checked(command)))

    def call(self, name: str, function: str, *arguments: object) -> str:
        words = " ".join(_word("argument", str(each)) for each in (function, *arguments))
        return self.send(self._table.command("call blueprint functions", _word("name", name), words))

    def light(
        self, name: str, pose: Pose, intensity: float, color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    ) -> None:
        pitch, yaw, roll = rotation_to_unreal(pose.rotation)
        values = arguments.numbers("light", (roll, yaw, pitch, intensity, *color), (7,)).tolist()
        numbers = " ".join(f"{value:.6f}" for value in values)
        self.send(self._table.command("set lights", _word("name", name), numbers))

    def exposure(self, method: ExposureMethod, bias_ev: float | None = None) -> None:
        what, values = "set the exposure", [arguments.one_of("method", method, get_args(ExposureMethod))]
        values += [] if bias_ev is None else [f"{arguments.number('bias_ev', bias_ev):.6f}"]
        self._table.command(what, 0, "", "")
        with self._exchange.turn():
            if "exposure_bias" not in self._exchange.ask(["vget /unrealcv/help"])[0]:
                raise ServerRefusedError(f"expected a server that can {what}, got one without the commands")
            before = self._journal.value("exposure")
            with self._journal.unless_refused():
                undo = Undo(run=partial(self._expose_again, before))
                self._journal.note("exposure", "", " ".join(values), undo)
                self._expose(values)
            self._exchange.settle()

    @contextmanager
    def changes(self) -> Iterator[None]:
        with self._exchange.turn():
            layer = self._journal.open()
        try:
            yield
        except BaseException:
            with suppress(SourceError):  # the fault that is raised came first
                put_back(self._exchange, self._journal, layer)
            raise
        put_back(self._exchange, self._journal, layer)

    def send(self, command: str) -> str:
        """Return the reply to any command, of binary ones the size and kind; it may make the state new."""
        with self._exchange.turn(), self._journal.unless_refused():
            if changes_world(command):
                sent = self._journal.value("commands") or ""
                digest = hashlib.sha256(f"{sent}\n{command}".encode()).hexdigest()[:16]
                self._journal.note("commands", "", digest)
            reply = self._exchange.reply(command)
            if not command.startswith("vget "):
                self._exchange.settle()
            return replies.described(reply)

    def set_paused(self, paused: bool) -> None:
        """Pause the game, or let it run."""
        with self._exchange.turn():
            undo = Undo(run=partial(self._set_clock, self._clock.paused))
            with self._journal.unless_refused():
                self._journal.note("paused", "", None, undo)
                self._set_clock(paused)

    def set_again(self) -> None:
        """Set again what was set and can be: over a new connection, the game may be a new one, too."""
        if self._stands:
            self._clock.set(True)
        self._placing.set_again()

    def check_lost(self) -> None:
        """Raise SourceError, once, if a game that was started anew lacks what cannot be set again."""
        if lost := self._journal.lose(_LOST):
            where = self._exchange.connection.address
            wanted = f"expected the game in which these were changed: {', '.join(lost)}"
            raise SourceError(f"{where}: {wanted}; got one that was started anew")

    @contextmanager
    def _of_object(self, name: str) -> Iterator[None]:
        """A turn about one object; ArgumentError if there is none of that name."""
        with self._exchange.turn():
            self._placing.check([name])
            yield

    def _set_clock(self, paused: bool) -> None:
        self._clock.set(paused)
        self._stands = paused

    def _remove(self, name: str) -> None:
        """Destroy an object if it is there."""
        command = self._table.command("destroy objects", name)
        with suppress(*RETRIED):  # then it is looked for again, over a new connection
            if name in self._placing.names():
                self._exchange.reply(command)
        if name in self._placing.names():
            self._exchange.reply(command)
        self._journal.forget(name)

    def _expose(self, values: list[str]) -> None:
        camera = self._exchange.driver.camera
        keys = zip(("method", "bias"), values, strict=False)
        self._exchange.do([self._table.command("set the exposure", camera, *each) for each in keys])

    def _expose_again(self, before: str | None) -> None:
        """Put the exposure back: what the engine's was cannot be read, but a new camera has it."""
        self._renew_camera()
        if before is not None:
            self._expose(before.split())


def _word(what: str, text: str) -> str:
    """Return a word of a command; ArgumentError for what is more than one."""
    if not isinstance(text, str) or not text.isprintable() or len(text.split()) != 1 or text != text.strip():
        raise ArgumentError(f"{what}: expected one word, got {shown(text)}")
    return text
