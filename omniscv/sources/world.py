"""The world that a source shows: its identity, its objects, and the interface to change a running one."""

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import astuple, dataclass, field
from functools import cached_property
from typing import Any, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number, shown
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.records import checked, record

Freeze = Literal["auto", "puppet", "pause", "batch", "none"]
"""How a live source keeps an instant while it is captured (:meth:`omniscv.sources.Source.at`):

``puppet``: the game is paused, and the instant's objects are moved; ``pause``: the game is paused, and the
objects' poses are read; ``batch``: the requests of a viewpoint are answered in one tick; ``none``: objects
are moved, and the game runs on; ``auto``: the strongest that the server has.
"""

Exposure = float | Literal["game"]
"""Exposure of a spawned camera: manual, with a bias in stops, or ``game``: as the game has it."""
CameraExposure = Exposure | Literal["auto"]
"""As ``Exposure``, or ``auto``: manual, with the bias that matches the game's own exposure."""
EXPOSURE_LIMITS = (-16.0, 16.0)
_MANUAL = "manual, bias "
_LONGEST_PART = 150  # characters of a part of a scene's identity

Color = tuple[int, int, int]


@dataclass(frozen=True)
class ObjectTable:
    """The objects of a scene, and how its object masks show them.

    Labels: 1 + the rank of the name in sorted order; 0 = nothing known.

    Attributes:
        colors: name to the colour that masks show, RGB 0..255; made up where only ``ids`` are given.
        tolerance: how far a channel of a mask may be off its object's colour.
        ids: name to the instance id that masks hold in place of colours.
    """

    colors: dict[str, Color]
    tolerance: int = 0
    ids: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.ids and not self.colors:
            object.__setattr__(self, "colors", {name: _color_of(self.ids[name]) for name in self.ids})

    def label(self, name: str) -> int:
        """Return the label of an object; ArgumentError for an unknown name."""
        if name not in self._labels:
            raise ArgumentError(f"objects: expected objects of the scene, got {shown(name)}")
        return self._labels[name]

    def names(self) -> list[str]:
        """Return all names in sorted order: label - 1 is the index."""
        return list(self._labels)

    def mask_values(self) -> NDArray[Any]:
        """Return what masks show of each label, from 0: ids (L,) uint16, or colours (L, 3) uint8."""
        if self.ids:
            return np.array([0, *(self.ids[name] for name in self.names())], np.uint16)
        return np.array([(0, 0, 0), *(self.colors[name] for name in self.names())], np.uint8)

    @cached_property
    def _labels(self) -> dict[str, int]:
        return {name: label for label, name in enumerate(sorted(self.colors), start=1)}


def _color_of(instance: int) -> Color:
    """Return a unique colour for an instance id, never black: a multiple of an odd number modulo 2^24."""
    code = (1 + instance) * 0x9E3779 % (1 << 24)
    return code >> 16, code >> 8 & 255, code & 255


def _part(name: str, value: object) -> str:
    if not isinstance(value, str):
        raise ArgumentError(f"{name}: expected a text, got {shown(value)}")
    return value[:_LONGEST_PART]


@record
class SceneIdentity:
    """The scene that a source shows: the ``name`` of the project or scene, the ``level``, or map, in it, and
    a digest of its visible ``content``; parts that the source does not know are empty.
    """

    name: str = checked(_part, default="")
    level: str = checked(_part, default="")
    content: str = checked(_part, default="")

    def differs(self, other: Self) -> bool:
        """Return whether a part that both know differs, so that they are two scenes."""
        for own, others in zip(astuple(self), astuple(other), strict=True):
            if own and others and own != others:
                return True
        return False

    def merged(self, other: Self) -> Self:
        """Return this identity, with parts of another one where this one knows none."""
        name = self.name or other.name
        level = self.level or other.level
        content = self.content or other.content
        return type(self)(name, level, content)


def exposure_bias(name: str, value: object) -> CameraExposure:
    """Return ``value``, a bias in stops, ``auto`` or ``game``; ArgumentError for anything else.

    ``name`` is what messages call it.
    """
    if value == "auto" or value == "game":
        return value
    return number(f"{name}, if not auto or game", value, least=EXPOSURE_LIMITS[0], most=EXPOSURE_LIMITS[1])


def exposure_to_text(bias: float) -> str:
    """Return manual exposure as provenance has it."""
    return f"{_MANUAL}{bias:g}"


def exposure_from_text(text: object) -> Exposure:
    """Return the exposure in provenance; ``game`` where there is none that a camera can have."""
    if isinstance(text, str) and text.startswith(_MANUAL):
        with suppress(ValueError):
            bias = float(text.removeprefix(_MANUAL))
            if EXPOSURE_LIMITS[0] <= bias <= EXPOSURE_LIMITS[1]:
                return bias
    return "game"


class SharedExposure:
    """The exposure that the cameras of one recording, or of replicas, share: the first camera finds it.

    ``position`` (3,) is where, world frame, metres; None: where the first colour is captured. ``value`` is
    None before it is found.
    """

    def __init__(self, position: Array | None = None) -> None:
        self.position = position
        self._lock = threading.Lock()
        self.value: Exposure | None = None

    def get(self, find: Callable[[], Exposure]) -> Exposure:
        """Return the exposure, found by a function if it is not known; other cameras wait meanwhile."""
        with self._lock:
            if self.value is None:
                self.value = find()
            return self.value


class World(Protocol):
    """The running world behind a source: poses in the world frame, metres.

    A dialect that cannot do something raises ServerRefusedError before anything is sent. Every change gives
    the world another state (:attr:`omniscv.sources.Source.state`). A name of no object is an ArgumentError.
    """

    def objects(self) -> list[str]:
        """Return the names of the objects, sorted."""

    def pose(self, name: str) -> Pose:
        """Return an object's pose: ``R_w_o`` and its position."""

    def move(self, name: str, pose: Pose) -> None:
        """Move and turn the object ``name`` to a ``pose``."""

    def bounds(self, name: str) -> ObjectBox:
        """Return the box around an object, along the world's axes."""

    def show(self, name: str) -> None:
        """Show an object that was hidden."""

    def hide(self, name: str) -> None:
        """Hide an object."""

    def pause(self) -> None:
        """Stop the world's clock, if it runs."""

    def resume(self) -> None:
        """Let the world's clock run, if it is stopped."""

    @property
    def paused(self) -> bool:
        """Whether the clock is stopped."""

    def changes(self) -> AbstractContextManager[None]:
        """Return a context at whose end what was changed within is put back, whatever happened.

        What no server reports stays, and keeps the state another: commands that may change the world, and
        objects that are shown though nothing here had hidden them.
        """
