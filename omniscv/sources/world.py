"""The interface of a world that a live source can change: its objects, its clock, its console."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import AbstractContextManager

from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import ObjectBox


class World(ABC):
    """The running world behind a source: poses in the world frame, metres.

    What the server's dialect cannot do raises ServerRefusedError before anything is sent. Every change gives
    the world another state (:attr:`omniscv.sources.Source.state`).
    """

    @abstractmethod
    def objects(self) -> list[str]:
        """Return the names of the objects, sorted."""

    @abstractmethod
    def pose(self, name: str) -> Pose:
        """Return an object's pose: ``R_w_o`` and its position."""

    @abstractmethod
    def move(self, name: str, pose: Pose) -> None:
        """Place and turn an object."""

    @abstractmethod
    def bounds(self, name: str) -> ObjectBox:
        """Return the box around an object, along the world's axes."""

    @abstractmethod
    def show(self, name: str) -> None:
        """Show an object that was hidden."""

    @abstractmethod
    def hide(self, name: str) -> None:
        """Hide an object."""

    @abstractmethod
    def spawn(self, kind: str, name: str, pose: Pose) -> None:
        """Make an object of a kind (an engine's class) under a name that is not taken."""

    @abstractmethod
    def destroy(self, name: str) -> None:
        """Remove an object."""

    @abstractmethod
    def pause(self) -> None:
        """Stop the world's clock; nothing if it stands."""

    @abstractmethod
    def resume(self) -> None:
        """Let the world's clock run; nothing if it runs."""

    @property
    @abstractmethod
    def paused(self) -> bool:
        """Whether the clock stands."""

    @abstractmethod
    def console(self, command: str) -> None:
        """Run a command of the engine's console, such as ``r.MotionBlurQuality 0``."""

    @abstractmethod
    def changes(self) -> AbstractContextManager[None]:
        """Return a context at whose end what was changed within is put back, whatever happened."""
