"""Finer captures of what an image doubts, until as little is doubtful as was asked for.

The doubt of an image lies along edges, in bands as wide as a capture's pixel. The cheapest views that narrow
these bands enough are patches along the edges (:mod:`omniscv.planning.patches`), or finer faces where the
source cannot set a field of view. What they leave in doubt is measured, and captured finer again.
"""

import heapq
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from omniscv import modalities
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints
from omniscv.planning import tuned
from omniscv.planning.patches import Doubt, Patch, held, patches
from omniscv.planning.plan import Doubted, Plan
from omniscv.planning.rounds import Round, Rounds, Viewpoint, pass_on, pixels_of
from omniscv.planning.views import ALL_FACES, CubeFaces
from omniscv.render_options import LARGEST_FACE_PX, PRICE, Price
from omniscv.sources.base import View
from omniscv.sources.recorded_views import RecordedViews

AIM = "aim"
_PANORAMA_SR = 2 * math.pi**2  # of its pixels, were all as large as those at its horizon
STUCK = "doubt no longer falls"
SPENT = "a budget is spent"
BEYOND = "captures store no depth beyond {:.4g} m"
RECORDED = "the recording holds no finer views"


@dataclass(frozen=True)
class Choice:
    """Patches that may follow.

    Attributes:
        patches: of the pixels in doubt.
        focal_px: of the patches.
        ms: their price, and that of what is expected to follow until as few pixels are in doubt as may be.
        rate: ms that resolve a pixel.
    """

    patches: list[Patch]
    focal_px: float
    ms: float
    rate: float

    @property
    def promised(self) -> float:
        """How many pixels the patches are expected to resolve."""
        return sum(patch.worth for patch in self.patches)


class Refinement(ABC):
    """The captures of one image whose accuracy is given.

    Attributes:
        plan: the image.
        price: of captures.
        truth, colors: its modes.
        patched: those of patches; a beat spoils colours, too.
        serves: whether all that is captured is composed at once.
        reserved: requests and pixels that budgets must allow later.
        expected_ms: of patches, in a furnished room.
        focal_px: (H W,) of the ground truth that each pixel shows.
    """

    serves: ClassVar[bool] = True

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        options = plan.options
        assert plan.doubt_share is not None
        self.price = Price(*options.capture_ms)
        self.truth = tuple(mode for mode in plan.modes if modalities.get(mode).truth)
        self.colors = tuple(mode for mode in plan.modes if mode not in self.truth)
        beats = options.checks == "beat"
        self.patched = plan.modes if beats else self.truth
        self._modes = max(1, len(self.patched) + beats * len(self.truth))  # captures of a patch
        self._asked_pixels = plan.doubt_share * plan.rays.valid_count
        self._doubted = Doubted(plan.rays.valid, 0, np.inf)
        self.expected_ms = 0.0
        self.focal_px: Floats = np.full(plan.rays.valid.size, plan.edge / 2 * options.truth_scale, np.float32)
        self.reserved = 0, 0
        self._requests = 0
        self._pixels = 0
        self._limited = False
        self._partly = False  # whether a recording lacks views that were chosen

    @property
    def doubt_pixels(self) -> float:
        """How many pixels that finer captures may resolve may stay doubtful."""
        return self._asked_pixels - (self._doubted.beyond if self._reachable else 0)

    @property
    def reached(self) -> str:
        """Why no captures follow when all that finer ones may resolve is resolved."""
        return AIM if self._reachable else BEYOND.format(self._doubted.largest_m)

    @property
    def _reachable(self) -> bool:
        return self._doubted.beyond <= self._asked_pixels

    def counted(self) -> Rounds:
        """Return the first rounds, and finer ones; a last one has no viewpoints and says why they end.

        ArgumentError: a budget does not allow the first rounds.
        """
        options = self.plan.options
        if options.most_captures is not None or options.most_megapixels is not None:
            self._check_budgets()
        return pass_on(self.planned(), self._count)

    def _check_budgets(self) -> None:
        """Refuse budgets that do not allow what is captured first, whatever it shows."""
        options = self.plan.options
        first = type(self)(replace(self.plan, doubt=None))
        for _ in pass_on(first.planned(), first._count):
            pass
        count = first._requests
        megapixels = first._pixels / 1e6
        advice = "which the first captures of the image take"
        if options.most_captures is not None and count > options.most_captures:
            raise ArgumentError(
                f"most_captures: expected at least {count}, {advice}, got {options.most_captures}"
            )
        if options.most_megapixels is not None and megapixels > options.most_megapixels:
            least = math.ceil(100 * megapixels) / 100
            raise ArgumentError(
                f"most_megapixels: expected at least {least:g}, {advice}, got {options.most_megapixels:g}"
            )

    @abstractmethod
    def planned(self) -> Rounds:
        """Yield the first rounds, and then finer ones; :meth:`counted` also counts their requests."""

    @abstractmethod
    def doubts(self, pixels: Ints) -> list[Doubt]:
        """Return pixels in doubt by the centre from which finer captures resolve them."""

    @abstractmethod
    def capture(self, choice: Choice) -> Rounds:
        """Yield the rounds of patches."""

    def exact(self, **options: Any) -> Plan:
        """Return the plan by the strategy ``exact``, with other options."""
        return self.plan.by(strategy="exact", accuracy=None, **options)

    def expected(self) -> tuple[int, int]:
        """Return how many requests and pixels are expected in a furnished room."""
        requests = []
        for round_ in self.counted():
            requests += round_.requests(self.plan.modes)
        local = self.expected_ms / (self.price.of(1, tuned.PATCH_PX) or 1)
        pixels = pixels_of(request.view for request in requests)
        return len(requests) + round(local), pixels + round(local * tuned.PATCH_PX)

    def _count(self, planned: Round) -> Round:
        # Views of finer truth are as fine as they are given here.
        finished = self.plan.finished

        def finish(viewpoint: Viewpoint) -> Viewpoint:
            return finished(replace(viewpoint, truth_scale=viewpoint.truth_scale or 1))

        planned = planned.changed(finish)
        requests = planned.requests(self.plan.modes)
        self._requests += len(requests)
        self._pixels += pixels_of(request.view for request in requests)
        return planned

    def doubtful(self) -> Ints:
        """Return the pixels that the image doubts and finer captures may resolve."""
        assert self.plan.doubt is not None
        self._doubted = self.plan.doubt()
        return np.flatnonzero(self._doubted.pixels)

    def finer(self) -> Rounds:
        """Yield finer captures of what is in doubt, and at last why they end."""
        before = np.inf
        stuck = 0
        promised = 0.0
        for _ in range(tuned.MOST_ROUNDS):
            doubt = self.doubtful()
            if len(doubt) <= self.doubt_pixels:
                yield Round((), self.reached)
                return
            stuck = stuck + 1 if before - len(doubt) < tuned.LEAST_RESOLVED * promised else 0
            if stuck == tuned.PATIENCE or (len(doubt) == before and self.serves):
                break
            before = len(doubt)
            choice = self.choice(doubt)
            if isinstance(choice, str):
                yield Round((), choice)
                return
            promised = choice.promised
            yield from self.capture(choice)
        yield Round((), self._why_stuck())

    def _why_stuck(self) -> str:
        """Return why captures end although more pixels are in doubt than may be."""
        if self._partly:
            return RECORDED
        return SPENT if self._limited else STUCK

    def choice(self, pixels: Ints) -> Choice | str:
        """Return the cheapest patches after which few enough pixels are in doubt; or why there are none."""
        plan = self.plan
        if not plan.capabilities.can_set_size:
            return "the source captures one size"
        doubts = self.doubts(pixels)
        if not doubts:
            return STUCK
        focal_px = np.concatenate([doubt.focal_px for doubt in doubts])
        coarse = float(np.quantile(focal_px, tuned.COARSE_QUANTILE))
        lengths = [finer * coarse for finer in tuned.FINER]
        best = self._cheapest(len(pixels), doubts, lengths)
        if best is None:
            return SPENT if self._limited else "no finer view fits"
        recorded = plan.recorded
        if recorded is not None and not recorded.hold(patch.view for patch in best.patches):
            self._partly = True
            return self._most_held(recorded, len(pixels), doubts, lengths) or RECORDED
        return best

    def _cheapest(self, count: int, doubts: Sequence[Doubt], lengths: Sequence[float]) -> Choice | None:
        """Return the cheapest patches among focal lengths that grow; None where no patch fits."""
        best: Choice | None = None
        self._limited = False
        for length in lengths:
            choice = self._patched(count, doubts, length, np.inf if best is None else best.ms)
            if not choice.patches:
                continue
            if best is not None and choice.ms >= best.ms:
                break  # finer ones are dearer still
            best = choice
        return best

    def _most_held(
        self, recorded: RecordedViews, count: int, doubts: Sequence[Doubt], lengths: Sequence[float]
    ) -> Choice | None:
        """Return the patches of which a recording holds the most: it was made for another share of doubt."""
        choices = []
        for focal_px in lengths:
            choice = self._patched(count, doubts, focal_px, np.inf)
            recorded_patches = [patch for patch in choice.patches if recorded.hold([patch.view])]
            if recorded_patches:
                choices.append(replace(choice, patches=recorded_patches))
        return max(choices, key=lambda choice: len(choice.patches), default=None)

    def _patched(self, count: int, doubts: Sequence[Doubt], focal_px: float, most_ms: float) -> Choice:
        """Return patches of a focal length; not all of them if they cost more than another choice."""
        modes = self._modes
        left = float(count)
        target = tuned.SAFE * self.doubt_pixels
        ms = 0.0
        area = 0.0
        batch: list[Patch] = []
        sources = [self._patches(doubt, focal_px) for doubt in doubts]
        for patch in heapq.merge(*sources, key=lambda patch: -patch.worth / patch.price):
            area += modes * patch.view.width * patch.view.height
            if self.full(area, modes * (len(batch) + 1)):
                self._limited = True
                break
            batch.append(patch)
            ms += patch.price
            left -= patch.worth
            if left <= target or ms > most_ms:
                break
        if left > target:
            ms *= left / target
        return Choice(batch, focal_px, ms, ms / max(1.0, count - target))

    def _patches(self, doubt: Doubt, focal_px: float) -> Iterator[Patch]:
        """Return patches of a centre, those first that resolve the most doubt at their price."""
        plan = self.plan
        worth = np.maximum(0, 1 - tuned.DOUBT_LEFT * doubt.focal_px / focal_px)
        _, where, repeated = np.unique(doubt.pixels, return_inverse=True, return_counts=True)
        worth /= repeated[where]
        if plan.capabilities.can_set_fov:
            return patches(doubt, worth, focal_px, self._modes, self.price, plan.capabilities)
        return iter(self._finer_faces(doubt, focal_px, worth))

    def _finer_faces(self, doubt: Doubt, focal_px: float, worth: Array) -> list[Patch]:
        """Return finer faces of a source that cannot set a field of view."""
        edge = int(2 * focal_px)
        faces = []
        if edge > LARGEST_FACE_PX:
            return []
        views = CubeFaces(self.plan, edge, 0).views(doubt.center_w, ALL_FACES)
        view_of = nearest_view(doubt.directions_w, views)
        for number, view in enumerate(views):
            rows = np.flatnonzero(view_of == number)
            price = self._modes * self.price.of(1, view.width * view.height)
            faces.append(Patch(view, doubt.center, doubt.pixels[rows], float(worth[rows].sum()), price))
        worthy = (patch for patch in faces if patch.worth > 0)
        return sorted(worthy, key=lambda patch: -patch.worth / patch.price)

    def local_ms(self, share: float) -> float:
        """Return what patches are expected to take after faces that leave a share of the pixels in doubt."""
        rays = self.plan.rays
        price = self.price
        edges = share / tuned.ROOM * rays.valid_count * rays.typical_step**2 / _PANORAMA_SR
        dearer = (price.request / PRICE[0] + price.megapixel / PRICE[1]) / 2 * len(self.truth) / 2
        further = math.sqrt(share * rays.valid_count / max(1.0, self.doubt_pixels)) - 1
        return float(dearer * tuned.LOCAL_MS * edges * max(0.0, further))

    def full(self, pixels: float, requests: int) -> bool:
        """Return whether so many more ``requests``, with so many ``pixels``, exceed a budget."""
        options = self.plan.options
        most = self.plan.options.most_captures
        if most is None and options.accuracy is None:
            most = tuned.DEFAULT_MOST_CAPTURES
        requests += self._requests + self.reserved[0]
        megapixels = (self._pixels + self.reserved[1] + pixels) / 1e6
        too_many = most is not None and requests > most
        return too_many or (options.most_megapixels is not None and megapixels >= options.most_megapixels)


def first_view(directions_w: Array, views: Sequence[View], border_px: int) -> Ints:
    """Return (N,) the first view that holds each ray, and a border around it; -1 where none does.

    Args:
        directions_w: (N, 3) rays of any length, world frame.
        views: the candidates.
        border_px: what a view shows around the ray at least.
    """
    view_of = np.full(len(directions_w), -1)
    for number, view in reversed(list(enumerate(views))):
        half = (np.array([view.width, view.height]) / 2 - border_px) / view.focal_px
        view_of[held(directions_w, view.pose.R_w_c, half)] = number
    return view_of


def nearest_view(directions_w: Array, views: Sequence[View]) -> Ints:
    """Return (N,) the view whose axis is nearest to each ray; of a cube's faces, the one that shows it.

    A ray between two faces, or along a diagonal, belongs to either. No border decides, so that none is lost
    to rounding there.

    Args:
        directions_w: (N, 3) rays of any length, world frame.
        views: one at least.
    """
    axes_w = np.stack([view.pose.R_w_c[:, 2] for view in views])
    return np.asarray(np.argmax(directions_w @ axes_w.T, axis=1))
