"""Strategies: the interface, the registry, and the task that a strategy plans for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, TypeVar

import numpy as np

from omniscv import plugins
from omniscv.arguments import one_of
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.arrays import Ints
from omniscv.planning.rays import ImageRays, RayGroup
from omniscv.planning.recorded_views import RecordedViews
from omniscv.planning.rounds import Rounds, Viewpoint, change_viewpoints
from omniscv.render_options import RenderOptions
from omniscv.sources.base import Capabilities, View

_LARGEST_PX = 16384  # of a finer view of ground truth
AIM = 0.03
"""Of ``auto`` for several optical centres."""


@dataclass(frozen=True, eq=False)
class Task:
    """One image for which captures are planned.

    Attributes:
        rays: the camera's, in its frame.
        pose: of the camera, world frame.
        capabilities: of the source.
        options: how the image is rendered.
        cover: the views that together show all that one should (:meth:`omniscv.sources.Source.cover`).
        recorded: the views of a recording; None for sources that make new captures.
        border_px: how much wider views are on every side; what the widest filter needs, if not given.
        state: of the world, in which captures are made.
        modes: that the image samples; only a planner that is asked for an accuracy reads them.
        shared: whether its captures serve other cameras, too: faces of a cube map, and no view of its own.
    """

    rays: ImageRays
    pose: Pose
    capabilities: Capabilities
    options: RenderOptions = field(default_factory=RenderOptions)
    cover: Callable[[View], tuple[View, ...]] = lambda view: (view,)
    recorded: RecordedViews | None = None
    border_px: int | None = None
    state: str = ""
    modes: tuple[str, ...] = ()
    shared: bool = False

    def __post_init__(self) -> None:
        if self.border_px is not None and self.border_px < 0:
            raise ArgumentError(f"border_px: expected a whole number of pixels >= 0, got {self.border_px!r}")

    @cached_property
    def edge(self) -> int:
        """px of a 90 degree face."""
        size = self.options.face_size
        return self.rays.face_size if size == "auto" else size

    def available(self, views: Sequence[View]) -> bool:
        """Return whether the source can deliver views: if it is a recording, as colours or as ground
        truth."""
        scales = {1, self.options.truth_scale}
        return self.recorded is None or any(
            self.recorded.hold(view.scaled(scale) for view in views) for scale in scales
        )

    @property
    def sets_views(self) -> bool:
        """Whether views may have any size and field of view."""
        return self.capabilities.can_set_size and self.capabilities.can_set_fov

    @property
    def scattered(self) -> bool:
        """Whether nearly every pixel has an optical centre of its own, and the options ask for no fewer."""
        return self.options.viewpoints is None and self.rays.scattered

    @property
    def aim(self) -> float | None:
        """Share of the valid pixels that may be doubtful; None where captures do not depend on it.

        ``auto`` has an aim of its own where there are several optical centres.
        """
        if self.options.accuracy is None and self.options.strategy == "auto" and not self.rays.one_center:
            return AIM
        return self.options.accuracy

    def border(self, default: int) -> int:
        """Return how much wider views are on every side, px."""
        return default if self.border_px is None else self.border_px

    def groups(self, viewpoints: int | None = None) -> tuple[RayGroup, ...]:
        """Return the valid pixels by optical centre, as many centres as the options have, else as given."""
        count = self.options.viewpoints
        return self.rays.groups(viewpoints if count is None else count)

    def origins_w(self, pixels: Ints) -> Array:
        """Return (N, 3) the optical centres of a non-central camera's pixels, world frame, metres."""
        assert self.rays.origins is not None
        return self.pose.to_world(self.rays.origins.reshape(-1, 3)[pixels])

    def directions_w(self, pixels: Ints) -> Array:
        """Return (N, 3) the unit rays of pixels, world frame."""
        return RayGroup(np.zeros(3), pixels, self.rays).directions @ self.pose.R_w_c.T


class Strategy(ABC):
    """Which views an image is captured with: a class without arguments, registered under its name.

    Attributes:
        name: of the options.
    """

    name: ClassVar[str]

    @abstractmethod
    def rounds(self, task: Task) -> Rounds:
        """Yield rounds until every valid pixel is served, each once.

        A round whose captures are not sent (None: a plan is made) is followed by what is needed at least.

        Raises:
            ArgumentError: the source cannot do what the strategy needs.
        """


S = TypeVar("S", bound=Strategy)

_strategies: dict[str, type[Strategy]] = {}


def register(strategy: type[S]) -> type[S]:
    """Add a strategy under its name; also as a decorator.

    Raises:
        ArgumentError: no subclass of Strategy with a name, or another class under a name that is taken.
    """
    if not (isinstance(strategy, type) and issubclass(strategy, Strategy) and hasattr(strategy, "name")):
        raise ArgumentError(f"strategy: expected a subclass of Strategy with a name, got {strategy!r}")
    if _strategies.setdefault(strategy.name, strategy) is not strategy:
        raise ArgumentError(f"strategy: expected a name that is not taken, got {strategy.name!r} again")
    return strategy


def names() -> tuple[str, ...]:
    """Return the names of all strategies."""
    plugins.load()
    return tuple(_strategies)


def get(name: str) -> Strategy:
    """Return the strategy of a name.

    Raises:
        ArgumentError: no strategy has that name.
    """
    if name not in _strategies and name not in names():
        one_of("strategy", name, names())
    return _strategies[name]()


def rounds(task: Task) -> Rounds:
    """Return the rounds of a task's strategy, in the task's state of the world, with its ``truth_scale``.

    Raises:
        ArgumentError: an unknown strategy, or finer ground truth of a source that cannot set the size of
            views.
    """
    options, strategy = task.options, get(task.options.strategy)
    if options.truth_scale > 1 and not task.capabilities.can_set_size:
        wanted = "expected 1 of a source that cannot set the size"
        raise ArgumentError(f"truth_scale: {wanted}, got {options.truth_scale}")

    scale = options.truth_scale

    def finish(viewpoint: Viewpoint) -> Viewpoint:
        largest = max((max(view.width, view.height) for view in viewpoint.views), default=0)
        if scale > 1 and scale * largest > _LARGEST_PX:
            raise ArgumentError(
                f"truth_scale: expected views of at most {_LARGEST_PX} px, got {scale} x {largest}; "
                "give a smaller face_size or truth_scale"
            )
        return replace(viewpoint, truth_scale=scale, state=task.state)

    changed = scale > 1 or task.state
    return change_viewpoints(strategy.rounds(task), finish) if changed else strategy.rounds(task)
