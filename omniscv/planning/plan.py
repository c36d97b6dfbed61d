"""Plans of images, the strategies that say what is captured for them, and their registry."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np

from omniscv import modalities, plugins
from omniscv.arguments import one_of
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.arrays import Ints, Mask
from omniscv.geometry.pose import rotated
from omniscv.planning.densities import unproject
from omniscv.planning.rays import ImageRays, RayGroup
from omniscv.planning.rounds import Round, Rounds, Viewpoint, pass_on, pixels_of
from omniscv.render_options import MEAN_RAYS, RenderOptions
from omniscv.sources.base import Capabilities, Request, View
from omniscv.sources.recorded_views import RecordedViews

_LARGEST_PX = 16384  # of a finer view of ground truth
_TRACED_RAYS = 1 << 18
"""Rays that are traced together: what a source holds of them meanwhile, some 200 bytes a ray, is bounded."""


class Doubted(NamedTuple):
    """What an image doubts.

    Attributes:
        pixels: (H, W) bool, those in doubt that finer captures may resolve.
        beyond: how many others show what is farther than captures store.
        largest_m: how far these store depth.
    """

    pixels: Mask
    beyond: int
    largest_m: float


@dataclass(frozen=True, eq=False)
class Plan:
    """One image to be captured, and its rounds.

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
        doubt: returns what the image doubts, as far as it is composed; None where captures are not composed.
        made: its rounds, as far as they do not depend on captures; None: not made yet.
        traced: modes that are not captured: the source tells what the ray of each pixel meets.
        shaded: rays of a pixel whose mean colours are, in place of captures; 0: colours are captured.
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
    doubt: Callable[[], Doubted] | None = None
    made: tuple[Round, ...] | None = None
    traced: tuple[str, ...] = ()
    shaded: int = 0

    def __post_init__(self) -> None:
        if self.border_px is not None and self.border_px < 0:
            raise ArgumentError(f"border_px: expected a whole number of pixels >= 0, got {self.border_px!r}")

    @cached_property
    def edge(self) -> int:
        """px of a 90 degree face."""
        size = self.options.face_size
        return self.rays.face_size if size == "auto" else size

    def available(self, views: Sequence[View]) -> bool:
        """Return whether the source can deliver views: a recording, as colours or as ground truth."""
        recorded = self.recorded
        scale = self.options.truth_scale
        if recorded is None or recorded.hold(views):
            return True
        return scale > 1 and recorded.hold([view.scaled(scale) for view in views])

    @property
    def sets_views(self) -> bool:
        """Whether views may have any size and field of view."""
        return self.capabilities.can_set_size and self.capabilities.can_set_fov

    @property
    def scattered(self) -> bool:
        """Whether nearly every pixel has an optical centre of its own, and the options ask for no fewer."""
        return self.options.viewpoints is None and self.rays.scattered

    @cached_property
    def doubt_share(self) -> float | None:
        """Share of the valid pixels that may be doubtful; None where captures do not depend on it."""
        if self.by_ray and not self.modes:
            return None
        return get(self.options.strategy).doubt_share(self)

    def rounds(self) -> Rounds:
        """Yield the rounds: those that were made, or new ones by the strategy if they depend on captures.

        ArgumentError: an unknown strategy, or truth or an accuracy that it, or the source, does not reach.
        """
        scale = self.options.truth_scale
        if self.made is not None and not self._adapts and self.doubt_share is None:
            for round_ in self.made:  # noqa: UP028 - a tuple takes nothing that is sent
                yield round_
            return
        if scale > 1 and not self.capabilities.can_set_size:
            raise ArgumentError(f"truth_scale: expected 1 of a source that cannot set the size, got {scale}")
        planned = get(self.options.strategy).rounds(self)
        yield from pass_on(planned, lambda round_: round_.changed(self.finished))

    @property
    def _adapts(self) -> bool:
        """Whether rounds that were made depend on what is captured."""
        return any(round_.informs for round_ in self.made or ())

    def by_rays(self) -> Plan:
        """Return the plan with what comes by rays, and needs no captures.

        Ground truth is one ray a pixel where the source traces rays; colours are the mean of several where
        the options say so. Both only where the strategy and the options have each pixel look from its own
        optical centre.

        Raises:
            ArgumentError: the options ask for colours by rays that the source or the strategy does not have.
        """
        own = get(self.options.strategy).own_centers and self.options.viewpoints is None
        traced: tuple[str, ...] = ()
        if own and self.capabilities.traces:
            traced = tuple(mode for mode in self.modes if modalities.get(mode).truth)
        shaded = self._color_rays(own) if "lit" in self.modes else 0
        plan = replace(self, traced=traced, shaded=shaded)
        captured = plan.captured(self.modes)
        return replace(plan, modes=captured, made=self.made if captured else ())

    def _color_rays(self, own: bool) -> int:
        """Return how many rays of a pixel colours are the mean of; ``own``: each from its own centre."""
        rays = self.options.color_rays
        shades = self.capabilities.shades
        if rays == "auto":
            return MEAN_RAYS if own and shades and not self.rays.one_center else 0
        if rays and not shades:
            expected = "expected auto, 0, or a live source that shades rays, such as scene://"
            kind = self.capabilities.dialect or "another"
            raise ArgumentError(f"color_rays: {expected}; got {rays} of a source of kind {kind}")
        if rays and not own:
            expected = "expected auto, 0, or strategy 'auto' or 'exact' without viewpoints"
            raise ArgumentError(f"color_rays: {expected}; got {rays} with {self.options.strategy!r}")
        return rays

    @property
    def by_ray(self) -> tuple[str, ...]:
        """The modes that take no captures: those that are traced, and colours that are shaded."""
        return (*self.traced, "lit") if self.shaded else self.traced

    def captured(self, modes: Sequence[str]) -> tuple[str, ...]:
        """Return those of some modes that take captures."""
        return tuple(mode for mode in modes if mode not in self.by_ray)

    def make(self, modes: Sequence[str]) -> Plan:
        """Return the plan with its rounds made for what is captured in some modes, without capturing.

        Modes that come by rays are left out: there are no rounds where nothing else is wanted.
        """
        captured = self.captured(modes)
        made = replace(self, modes=captured)
        if self.by_ray and not captured:
            return replace(made, made=())
        return replace(made, made=tuple(made.rounds()))

    @cached_property
    def requests(self) -> dict[Request, None]:
        """The captures of the rounds that were made, each once."""
        requests: dict[Request, None] = {}
        for round_ in self.made or ():
            requests |= dict.fromkeys(round_.requests(self.modes))
        return requests

    def by(self, **options: Any) -> Plan:
        """Return the plan of the image with other options."""
        return replace(self, options=replace(self.options, **options), made=None)

    def finished(self, viewpoint: Viewpoint) -> Viewpoint:
        """Return a viewpoint in the state of the world, its truth as fine and compared as the options ask.

        Raises:
            ArgumentError: the source cannot capture that.
        """
        scale = self.options.truth_scale if viewpoint.truth_scale is None else viewpoint.truth_scale
        largest = max((max(view.width, view.height) for view in viewpoint.views), default=0)
        if scale > 1 and scale * largest > _LARGEST_PX:
            wanted = f"expected views of at most {_LARGEST_PX} px, got {scale} x {largest}"
            raise ArgumentError(f"truth_scale: {wanted}; give a smaller face_size or truth_scale")
        compared = self.options.checks == "beat" and (len(viewpoint.pixels) > 0 or not viewpoint.keep)
        if compared and not self.capabilities.can_set_size:
            raise ArgumentError("checks: expected none or light of a source of one size, got beat")
        return replace(viewpoint, truth_scale=scale, state=self.state, compared=compared)

    def border(self, default: int) -> int:
        """Return how much wider views are on every side, px."""
        return default if self.border_px is None else self.border_px

    def groups(self, viewpoints: int | None = None) -> tuple[RayGroup, ...]:
        """Return the valid pixels by optical centre, as many centres as the options have, else as given."""
        count = self.options.viewpoints
        return self.rays.groups(viewpoints if count is None else count)

    def origins_w(self, pixels: Ints) -> Array:
        """Return the optical centres of pixels, (N, 3) or, of a central camera, (3,); world frame, metres."""
        if self.rays.origins is None:
            return self.pose.t_w_c
        return self.pose.to_world(self.rays.origins.reshape(-1, 3)[pixels])

    def directions_w(self, pixels: Ints) -> Array:
        """Return (N, 3) the unit rays of pixels, world frame."""
        return rotated(RayGroup(np.zeros(3), pixels, self.rays).directions, self.pose.R_w_c)

    def world_rays(self) -> Iterator[tuple[Ints, Array, Array]]:
        """Yield all valid pixels in blocks: their (N,) flat indices, origins and directions, world frame.

        Origins are metres, as :meth:`origins_w` has them; directions are (N, 3) unit vectors.
        """
        pixels = np.flatnonzero(self.rays.valid)
        for block in self.rays.blocks(pixels):
            of_block = pixels[block.part]
            directions_c = block.directions
            for first in range(0, len(of_block), _TRACED_RAYS):
                some = slice(first, first + _TRACED_RAYS)
                directions_w = rotated(directions_c[some], self.pose.R_w_c)
                yield of_block[some], self.origins_w(of_block[some]), directions_w

    def color_rays(self) -> Iterator[tuple[Ints, Array, Array]]:
        """Yield all valid pixels in blocks, each with the rays of which its colour is the mean.

        They run through the middles of :attr:`shaded` equal squares of the pixel. Where one is beyond the
        field of view, the ray of the pixel's own middle takes its place.

        Returns:
            Pixels, (N,) flat indices; origins (k, N, 3), metres, and unit directions (k, N, 3), world frame.
        """
        camera = self.rays.camera
        across = math.isqrt(self.shaded)
        steps = (np.arange(across) + 0.5) / across - 0.5
        offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 1, 2)  # px
        pixels = np.flatnonzero(self.rays.valid)
        most = max(1, _TRACED_RAYS // (self.shaded + 1))
        for first in range(0, len(pixels), most):
            of_block = pixels[first : first + most]
            row, column = np.divmod(of_block, camera.width)
            middles = np.stack([column, row], axis=-1) + 0.5
            center = unproject(camera, middles[None])
            spread = unproject(camera, middles + offsets)
            inside = spread.valid[..., None]
            directions_c = np.where(inside, spread.directions, center.directions)
            origins_c = np.where(inside, spread.origins, center.origins)
            yield of_block, self.pose.to_world(origins_c), rotated(directions_c, self.pose.R_w_c)


class Strategy(ABC):
    """Which views an image is captured with: a class without arguments, registered under its name.

    Attributes:
        name: of the options.
        own_centers: whether it looks from the optical centre of each pixel, where the options ask for no
            fewer: ground truth may then come by rays (:meth:`Plan.by_rays`).
    """

    name: ClassVar[str]
    own_centers: ClassVar[bool] = False

    @abstractmethod
    def rounds(self, plan: Plan) -> Rounds:
        """Yield rounds until every valid pixel is served, each once.

        A round whose captures are not sent (None: a plan is made) is followed by what is needed at least.

        Raises:
            ArgumentError: the source cannot do what the strategy needs.
        """

    def doubt_share(self, plan: Plan) -> float | None:
        """Return the share of the valid pixels that may be doubtful, where captures depend on it; else None.

        Raises:
            ArgumentError: the options ask for an accuracy that the strategy does not know.
        """
        if plan.options.accuracy is not None:
            expected = "expected none, or strategy 'auto', which captures finer until it is reached"
            raise ArgumentError(f"accuracy: {expected}; got strategy {self.name!r}")
        return None

    def expected(self, plan: Plan) -> tuple[int, int]:
        """Return how many requests and pixels an image is expected to take, in a furnished room."""
        requests = plan.make(plan.modes).requests
        return len(requests), pixels_of(request.view for request in requests)


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
    """Return the strategy of a name; ArgumentError if there is none."""
    if name not in _strategies and name not in names():
        one_of("strategy", name, names())
    return _strategies[name]()
