"""The interface of a world that a live source can change: its objects, its clock, its console."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import AbstractContextManager
from typing import Literal

from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import ObjectBox

ExposureMethod = Literal["histogram", "basic", "manual"]
Freeze = Literal["auto", "puppet", "pause", "batch", "none"]
"""How a live source keeps an instant while it is captured (:meth:`omniscv.sources.Source.at`):

``puppet``: the game is paused, and the instant's objects are placed; ``pause``: the game is paused, and the
objects' poses are read; ``batch``: the requests of a viewpoint are answered in one tick; ``none``: objects
are placed, and nothing is kept; ``auto``: the strongest that the server has.
"""


class World(ABC):
    """The running world behind a source: poses in the world frame, metres.

    What the server's dialect cannot do raises ServerRefusedError before anything is sent. Every change gives
    the world another state (:attr:`omniscv.sources.Source.state`). ArgumentError for names of no object.
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
        """Make an object of a kind, ``cube`` or an engine's class, under a name that is not taken."""

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

    def call(self, name: str, function: str, *arguments: object) -> str:
        """Call a function of an object's blueprint, and return what the server replies."""
        raise self._cannot("whose objects have functions")

    def light(
        self, name: str, pose: Pose, intensity: float, color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    ) -> None:
        """Set a light of a world whose blueprints have ``set_light``, as those of UnrealZoo.

        Args:
            name: of the light.
            pose: its rotation ``R_w_o`` is the light's; its position is not used.
            intensity: in the engine's unit for that light.
            color: RGB, 0 to 1.
        """
        raise self._cannot("whose lights can be set")

    def exposure(self, method: ExposureMethod, bias_ev: float | None = None) -> None:
        """Set how the capture camera is exposed: the method, and the compensation in f-stops if given."""
        raise self._cannot("whose camera has an exposure")

    @abstractmethod
    def changes(self) -> AbstractContextManager[None]:
        """Return a context at whose end what was changed within is put back, whatever happened.

        What no server reports cannot be put back, and keeps the state another: console commands, functions,
        lights, and objects that are shown though nothing here had hidden them.
        """

    def _cannot(self, what: str) -> ArgumentError:
        return ArgumentError(f"world: expected one {what}, got {type(self).__name__}")
