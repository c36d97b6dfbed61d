"""Brings a running world to an instant, and keeps it there while it is captured."""

from typing import Literal

from omniscv.geometry.instant import Instant
from omniscv.sources.unreal.exchange import Exchange
from omniscv.sources.unreal.journal import Journal, Undo
from omniscv.sources.unreal.placing import Placing
from omniscv.sources.unreal.world import UnrealWorld
from omniscv.sources.unreal.world_commands import TABLES
from omniscv.sources.world import Freeze


def strongest(freeze: Freeze, dialect: str) -> Literal["puppet", "pause", "batch", "none"]:
    """Return how a server freezes its world; ServerRefusedError for what its dialect cannot.

    Every dialect can be paused, so ``auto`` is ``puppet``: the poses are then known exactly.
    """
    if freeze == "auto":
        return "puppet"
    if freeze == "batch":
        TABLES[dialect].command("answer a batch in one tick", 0)
    return freeze


class Freezing:
    """Sets instants; to be used within a turn and an open layer of the journal."""

    def __init__(self, exchange: Exchange, journal: Journal, world: UnrealWorld, freeze: Freeze) -> None:
        self._exchange, self._journal, self._world = exchange, journal, world
        self._placing = Placing(exchange, journal)
        self.how = strongest(freeze, exchange.driver.capabilities.dialect)

    def set(self, instant: Instant) -> None:
        """Bring the world to an instant.

        With ``pause`` it stays where it is: the poses of the instant's objects are read, of every movable
        one if it has none, and the time is not known.
        """
        self._placing.check({*instant.poses, *instant.hidden})
        if self.how in ("puppet", "pause"):
            self._world.set_paused(True)
        if self.how == "pause":
            for name, pose in self._placing.poses(instant.poses or self._placing.movable()).items():
                self._journal.note("seen", name, pose, Undo())
        else:
            self._placing.place(instant.poses)
            if instant.time is not None:
                self._journal.note("time", "", instant.time, Undo())
        if instant.name:
            self._journal.note("name", "", instant.name, Undo())
        self._placing.hide(sorted(instant.hidden))
