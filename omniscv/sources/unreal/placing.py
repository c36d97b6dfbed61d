"""Reads and sets where objects are, and which are hidden, many at once."""

from collections.abc import Collection, Iterable, Mapping
from typing import Literal

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import ServerRefusedError
from omniscv.geometry import Pose
from omniscv.geometry.unreal_frame import (
    position_from_unreal,
    position_to_unreal,
    rotation_from_unreal,
    rotation_to_unreal,
)
from omniscv.sources.base import known_objects
from omniscv.sources.unreal import replies
from omniscv.sources.unreal.exchange import Exchange
from omniscv.sources.unreal.journal import Journal, Undo
from omniscv.sources.unreal.world_commands import OBJECTS

_PRINTED_M, _PRINTED = 1.1e-4, 4e-4  # of positions, and entries of a rotation: 0.3.10 prints two decimals
_CAMERAS = "FusionCameraActor"  # how the plugin names the actors of cameras


class Placing:
    """Objects of a game; to be used within a turn. Poses are those of objects: ``R_w_o`` and position."""

    def __init__(self, exchange: Exchange, journal: Journal) -> None:
        self._exchange, self._journal = exchange, journal

    def names(self) -> list[str]:
        """Return the names of all objects, in the server's order."""
        return replies.names(self._exchange.ask([OBJECTS])[0])

    def check(self, names: Collection[str]) -> None:
        """Raise ArgumentError for a name that no object has."""
        if names:
            known_objects(names, self.names(), self._exchange.connection.address)

    def movable(self) -> list[str]:
        """Return the names of the objects that the game may move."""
        names = [name for name in self.names() if not name.startswith(_CAMERAS)]
        found = self._exchange.connection.texts([f"vget /object/{name}/mobility" for name in names])
        return [name for name, mobility in zip(names, found, strict=True) if mobility == "Movable"]

    def poses(self, names: Iterable[str]) -> dict[str, Pose]:
        """Return the poses of objects."""
        names = list(names)
        found = [np.array(replies.numbers(text, 3)) for text in self._texts(names)]
        placed = zip(names, found[::2], found[1::2], strict=True)
        return {name: Pose(position_from_unreal(p), rotation_from_unreal(r)) for name, p, r in placed}

    def place(self, poses: Mapping[str, Pose]) -> None:
        """Move and turn objects; ServerRefusedError, and all as before, if one cannot be moved."""
        texts = self._texts(poses)
        before = dict(zip(poses, zip(texts[::2], texts[1::2], strict=True), strict=True))
        with self._journal.unless_refused():
            for name, pose in poses.items():
                self._journal.note("pose", name, pose, Undo(_commands(name, *before[name])))
            try:
                self._exchange.do([c for name in poses for c in _commands(name, *_placed(poses[name]))])
                self._check_placed(poses)
            except ServerRefusedError:
                back = [command for name in before for command in _commands(name, *before[name])]
                self._exchange.connection.texts(back)
                raise

    def hide(self, names: Iterable[str], what: Literal["hidden", "left out"] = "hidden") -> None:
        """Hide objects: in the world, or only left out of its captures, which gives it no other state."""
        new = [name for name in names if not self._journal.value(what, name)]
        either = ("hidden", "left out")
        shown = [name for name in new if not any(self._journal.value(each, name) for each in either)]
        back = {name: f"vset /object/{name}/show" for name in shown}
        with self._journal.unless_refused():
            for name in new:
                self._journal.note(what, name, True, Undo((back[name],) if name in back else ()))
            try:
                self._exchange.do([f"vset /object/{name}/hide" for name in shown])
            except ServerRefusedError:
                self._exchange.connection.texts(list(back.values()))
                raise

    def set_again(self) -> None:
        """Place and hide what is placed and hidden: the game may have been started anew."""
        seen, poses = dict(self._journal.named("seen")), self._journal.named("pose")
        if any(not _same(pose, seen[name]) for name, pose in self.poses(seen).items()):
            self._journal.lose(["seen"])
            where = self._exchange.connection.address
            raise ServerRefusedError(f"{where}: expected objects where they were read, got them elsewhere")
        hidden = [*self._journal.named("hidden"), *self._journal.named("left out")]
        self._exchange.do([c for name, pose in poses for c in _commands(name, *_placed(pose))])
        self._exchange.do([f"vset /object/{name}/hide" for name, _ in hidden])

    def _texts(self, names: Iterable[str]) -> list[str]:
        """Return locations and rotations in turn, as the server prints them."""
        commands = [f"vget /object/{name}/{what}" for name in names for what in ("location", "rotation")]
        return self._exchange.ask(commands)

    def _check_placed(self, poses: Mapping[str, Pose]) -> None:
        """Raise ServerRefusedError for an object that is not where it was put, as it can never be moved."""
        for name, found in self.poses(poses).items():
            if not _same(found, poses[name]):
                (mobility,) = self._exchange.ask([f"vget /object/{name}/mobility"])
                if mobility != "Movable":
                    wanted = f"expected an object that can be moved, got {shown(name)}"
                    where = self._exchange.connection.address
                    raise ServerRefusedError(f"{where}: {wanted}, whose mobility is {shown(mobility)}")


def _same(a: Pose, b: Pose) -> bool:
    """Return whether poses are equal as far as servers print them."""
    moved, turned = np.abs(a.position - b.position).max(), np.abs(a.rotation - b.rotation).max()
    return bool(moved <= _PRINTED_M and turned <= _PRINTED)


def _commands(name: str, location: str, rotation: str) -> tuple[str, str]:
    return f"vset /object/{name}/location {location}", f"vset /object/{name}/rotation {rotation}"


def _placed(pose: Pose) -> tuple[str, str]:
    """Return location and rotation as commands have them."""
    return _text(position_to_unreal(pose.position)), _text(rotation_to_unreal(pose.rotation))


def _text(values: Iterable[float]) -> str:
    """Return numbers with fixed decimals, as servers parse them."""
    return " ".join(f"{value:.6f}" for value in values)
