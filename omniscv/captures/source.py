"""The seam behind which captures come from: a live server, a record, or a wrapper around either."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from omniscv.captures.view import MODES, Capture, Request, View


@dataclass(frozen=True)
class Capabilities:
    """What a source can do, found by probing, never from a version string.

    Attributes:
        modes: the modes it can capture.
        can_set_size, can_set_fov: whether views may differ from ``image_size`` and ``fov_deg``.
        can_spawn: whether it makes a camera of its own, which no player moves.
        can_look_vertical: whether pitch +-90 is exact; else captures come with the view they had.
        image_size: (width, height) in force, where it cannot be set.
        fov_deg: horizontal field of view in force, where it cannot be set.
        min_size: the smallest width and height of a view that it accepts, px.
        pipelines: whether several requests may be under way at once.
        mask_through_viewport: object masks come from the game's window, not from the capture camera.
        depth_kind: "planar" or "ray": what the wire carries (captures are planar in any case).
        depth_unit: "cm" or "m" on the wire (captures are in metres in any case).
        dialect: "0.3.10", "M", "N1", "N2" for live servers; a word for other sources.
    """

    modes: frozenset[str] = frozenset(MODES)
    can_set_size: bool = True
    can_set_fov: bool = True
    can_spawn: bool = False
    can_look_vertical: bool = True
    image_size: tuple[int, int] | None = None
    fov_deg: float | None = None
    min_size: int = 1
    pipelines: bool = False
    mask_through_viewport: bool = False
    depth_kind: str = "planar"
    depth_unit: str = "cm"
    dialect: str = ""


@dataclass(frozen=True)
class ObjectTable:
    """The objects of a scene: name to the colour that its mask shows, RGB 0..255.

    Labels: 1 + the rank of the name in sorted order; 0 = nothing known.
    """

    colors: dict[str, tuple[int, int, int]]

    def label(self, name: str) -> int:
        """The label of an object."""
        return 1 + self.names().index(name)

    def names(self) -> list[str]:
        """All names in sorted order: label - 1 is the index."""
        return sorted(self.colors)


class Source(ABC):
    """Where captures come from. A context manager; closing twice is fine."""

    @property
    @abstractmethod
    def capabilities(self) -> Capabilities:
        """What this source can do."""

    @abstractmethod
    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """Captures, one per request, in the order of the requests; ``requests`` is read lazily.

        Raises:
            SourceError: a live source could not deliver within its deadlines and retries.
            RecordError: a recorded source does not hold a capture, or holds it damaged.
        """

    @abstractmethod
    def objects(self) -> ObjectTable:
        """The objects of the scene and their mask colours."""

    def recorded_views(self) -> tuple[View, ...] | None:
        """The views that can be replayed, for a source that cannot make new ones; None otherwise."""
        return None

    def close(self) -> None:  # noqa: B027 - most sources hold nothing
        """Give back what the source holds."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
