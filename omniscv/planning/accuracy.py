"""Captures that become finer where an image doubts itself, until as little is doubtful as was asked for.

Colours are captured as fine as the image needs, ground truth first coarsely. Its doubt lies along edges, in
bands as wide as a capture's pixel. Next are the cheapest views that narrow these bands enough: patches along
the edges (:mod:`omniscv.planning.patches`), or finer faces where the source cannot set a field of view. What
they leave in doubt is measured, and captured finer again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from omniscv import modalities
from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints
from omniscv.planning import strategy
from omniscv.planning.cube_faces import ALL_FACES, FACE_BORDER_PX, CubeFaces
from omniscv.planning.densities import SMALLEST
from omniscv.planning.patches import Patch, Precision, held, patches
from omniscv.planning.ray_marching import KnownDepth
from omniscv.planning.reproject import INITIAL_VIEWPOINTS
from omniscv.planning.rounds import (
    Kept,
    Round,
    Rounds,
    Viewpoint,
    change_viewpoints,
    drive,
    pixels_of,
    planned_requests,
)
from omniscv.planning.strategy import Task
from omniscv.render_options import FINEST_TRUTH, LARGEST_FACE_PX, PRICE, Price
from omniscv.sources.base import Request, View

AIM = "aim"
_ROOM = 0.029
"""Share of the pixels that faces of 384 px leave in doubt in a furnished room."""
_LARGEST = 8 * SMALLEST
"""px of the first faces of ground truth, at most."""
_LOCAL_MS = 180.0
"""What patches in two modes take that leave 1 / e of the doubt of a room, by measurement; 1 / e^n takes n^1.5
times as much."""
_PATCH_PX = 200_000  # of a typical patch
_PROBED = 2
"""Views in which an image of more views is measured first."""
_CAPS, _STEEP = 0.2, 0.7
"""Density of edges in faces that look up or down, relative to others, and the least sine of their pitch."""
_FINER = (2.0, 3.0, 4.5, 7.0, 11.0, 18.0, 30.0)
"""How many times finer patches may be than what is in doubt."""
_BAND_PX = 4.0  # of a capture: the width of a band of doubt
_LEFT = 0.85  # of the doubt that n times finer captures leave, by 1 / n
_SAFE = 0.97  # of the pixels that may stay doubtful: what captures are aimed at
_AGAIN = 0.85  # factor of the chance that a patch resolves a pixel, per patch that it was in before
_FALLS, _PATIENCE = 0.02, 3  # least relative fall of doubt in a round, and how many rounds may miss it
_MOST_ROUNDS = 12
_STILL = 0.9  # of the doubt: finer captures of everything must leave less
_FEW = "adaptive"
"""The strategy of few viewpoints, which several centres are captured with unless another one is given."""
_DEPTH = 0.01  # relative bound of a depth above which it is doubtful
_FEW_CENTERS = 2
"""Centres that are tried first."""
_LEAST_DOUBT, _MOST_DOUBT = 1.06, 1.3
"""Doubt of an image relative to that of its depth, least and most, by measurement: label edges add to it."""
_SHRINKS = 1.09
"""Views that are n^_SHRINKS times finer leave 1 / n of the doubt, by measurement."""
_STUCK, _SPENT = "doubt no longer falls", "a budget is spent"

_Probed = Generator[Round, Kept | None, int]
_Sent = Generator[Round, Kept | None, Kept | None]
"""Rounds that return what was sent for the last one."""


def rounds(task: Task) -> Rounds:
    """Return the rounds of a task's strategy; with ``accuracy``, and finer ones until it is reached.

    Then the last round has no viewpoints, and says why captures stop.

    Raises:
        ArgumentError: as :func:`omniscv.planning.strategy.rounds`.
    """
    return strategy.rounds(task) if task.options.accuracy is None else _Planner(task).rounds()


def expected(task: Task) -> tuple[int, int]:
    """Return how many requests and pixels a task's accuracy is expected to take in a furnished room."""
    planner = _Planner(task)
    requests = planned_requests(planner.rounds(), task.modes)
    pixels = pixels_of(request.view for request in requests)
    local = planner.expected_ms / (planner.price.of(1, _PATCH_PX) or 1)
    return len(requests) + round(local), pixels + round(local * _PATCH_PX)


@dataclass(frozen=True)
class _Choice:
    """Patches that may follow.

    Attributes:
        patches: of the pixels in doubt.
        focal_px: of the patches.
        ms: their price, and that of what is expected to follow until the aim is reached.
    """

    patches: list[Patch]
    focal_px: float
    ms: float


class _Planner:
    """The rounds of one image.

    Attributes:
        price: of captures.
        expected_ms: of patches, in a furnished room.
    """

    def __init__(self, task: Task) -> None:
        self._task, options = task, task.options
        assert options.accuracy is not None
        self.price = Price(*options.capture_ms)
        self._truth = tuple(mode for mode in task.modes if modalities.get(mode).truth)
        self._colors = tuple(mode for mode in task.modes if mode not in self._truth)
        self._aim = options.accuracy * task.rays.valid_count
        self._requests, self._pixels, self.expected_ms = 0, 0, 0.0
        self._limited = False  # by a budget
        self._centers: int | None = None
        self._around: tuple[tuple[Request, ...], Kept | None] = (), None
        self._scale, self._tried, self._probing = 1, 0, False
        self._finest = FINEST_TRUTH if task.capabilities.can_set_size else 1
        self._focal_px: Floats = np.zeros(task.rays.valid.size, np.float32)
        self._tries = np.zeros(task.rays.valid.size, np.uint8)  # patches that a pixel was in

    def rounds(self) -> Rounds:
        """Yield the first rounds, and finer ones."""
        if self._task.rays.origins is not None:
            yield from self._noncentral()
            return
        kept = yield from self._counted(self._first())
        if kept is not None:
            yield from self._finer(kept)

    def _counted(self, rounds: Rounds, abandon: Callable[[Round], bool] = lambda _: False) -> _Sent:
        """Yield rounds until one is abandoned, and count what they capture: depth around the camera once."""
        kept: Kept | None = None
        with closing(rounds):
            while True:
                try:
                    planned = rounds.send(kept)
                except StopIteration:
                    return kept
                if abandon(planned):
                    return None
                requests = tuple(planned.requests(self._task.modes))
                if requests and requests == self._around[0]:
                    kept = self._around[1]
                    continue
                self._requests += len(requests)
                self._pixels += pixels_of(request.view for request in requests)
                kept = yield planned
                if kept and len(kept) == 1:
                    self._around = requests, kept

    # -- The first captures

    def _first(self) -> Rounds:
        """Yield captures of all that the image shows: ground truth as coarse as the aim allows."""
        task = self._task
        base = self._faces(task.edge)
        if base is None or not self._sizes_free() or not self._truth:
            yield from strategy.rounds(task)
            self._focal_px[:] = task.edge / 2 * task.options.truth_scale
            return
        if self._colors:
            yield Round((replace(base, modes=self._colors),))
        small = self._faces(SMALLEST) or base
        face_of = _view_of(self._task.directions_w(base.pixels), small.views, FACE_BORDER_PX)
        probed = _PROBED if len(small.views) > _PROBED else 0
        if probed:
            edge = yield from self._probe(base, small, face_of)
        else:
            edge = self._best_edge(_ROOM, base)
        self.expected_ms = self._local_ms(_ROOM, edge)
        faces, pixels = self._faces(edge) or base, base.pixels
        if edge == SMALLEST:
            faces, pixels = replace(small, views=small.views[probed:]), pixels[face_of >= probed]
        self._focal_px[:] = faces.views[0].focal_px
        yield Round((replace(faces, pixels=pixels, modes=self._truth),))

    def _probe(self, base: Viewpoint, small: Viewpoint, face_of: Ints) -> _Probed:
        """Yield the first small faces, and return the size of faces that promises to reach the aim for least.

        Args:
            base, small: the views of colours, and those of the smallest faces.
            face_of: (N,) the small view that shows each pixel.
        """
        probed = face_of < _PROBED
        first = replace(small, views=small.views[:_PROBED], pixels=base.pixels[probed], modes=self._truth)
        kept = yield Round((first,))
        if kept is None or kept.doubt is None:
            return self._best_edge(_ROOM, base)
        dense = np.array([_CAPS if abs(view.pose.R_w_c[2, 2]) > _STEEP else 1.0 for view in small.views])[
            face_of
        ]
        share = np.count_nonzero(kept.doubt()) / max(1.0, dense[probed].sum()) * dense.mean()
        return self._best_edge(share, base)

    def _sizes_free(self) -> bool:
        """Return whether ground truth may be captured in another size than colours."""
        options, capabilities = self._task.options, self._task.capabilities
        return options.face_size == "auto" and options.truth_scale == 1 and capabilities.can_set_size

    def _faces(self, edge: int) -> Viewpoint | None:
        """Return the only viewpoint of a central camera, with views as fine as faces of a size; else None."""
        task = self._task
        sized = replace(task, options=replace(task.options, face_size=edge))
        planned = strategy.rounds(task if edge == task.edge else sized)
        with closing(planned):
            viewpoints = next(planned).viewpoints
        return viewpoints[0] if len(viewpoints) == 1 else None

    def _best_edge(self, share: float, base: Viewpoint) -> int:
        """Return the size of the first faces of ground truth that promises to reach the aim for least.

        Args:
            share: of the pixels that the smallest faces leave in doubt.
            base: the views of colours.
        """
        count, area = len(base.views), pixels_of(base.views)
        modes = len(self._truth)

        def pixels(edge: int) -> float:
            return modes * area * (edge / self._task.edge) ** 2

        def ms(edge: int) -> float:
            return float(self.price.of(modes * count, pixels(edge))) + self._local_ms(share, edge)

        edges = range(SMALLEST, _LARGEST + 1, SMALLEST // 4)
        within = [edge for edge in edges if not self._full(pixels(edge), modes * count)]
        return min(within or edges[:1], key=ms)

    def _local_ms(self, share: float, edge: int) -> float:
        """Return what patches are expected to take after faces of a size; arguments as :meth:`_best_edge`."""
        aim, left = self._aim / max(1, self._task.rays.valid_count), share * SMALLEST / edge
        steps = math.log(max(1.0, left / aim))
        dearer = (self.price.request / PRICE[0] + self.price.megapixel / PRICE[1]) / 2
        return float(dearer * len(self._truth) / 2 * share / _ROOM * _LOCAL_MS * steps**1.5)

    # -- Several centres

    def _noncentral(self) -> Rounds:
        """Yield the rounds of a strategy with ground truth as fine as the aim takes, then finer.

        Unless centres are given, a few are tried first, with ground truth as coarse as colours.
        """
        task, options = self._task, self._task.options
        self._centers, self._scale, finest = options.viewpoints, self._usual_scale, self._finest
        free = options.strategy == "auto" and options.viewpoints is None and options.truth_scale == 1
        self._probing = free and finest > 1 and self._can_capture(_FEW_CENTERS, 1)
        if self._probing:
            self._centers, self._scale = _FEW_CENTERS, 1
        before = np.inf
        while True:
            centers, scale = self._centers, self._scale
            planned = self._shared(centers, scale)
            if before < np.inf:  # colours are there
                planned = change_viewpoints(planned, self._without_colors)
            kept = yield from self._counted(planned, self._improved)
            if (self._centers, self._scale) != (centers, scale):
                continue
            if kept is None or kept.doubt is None:
                return
            doubtful = int(np.count_nonzero(kept.doubt()))
            finer = min(finest, math.ceil(scale * doubtful / (_SAFE * self._aim)))
            stopped = ""
            if doubtful <= self._aim:
                stopped = AIM
            elif doubtful > _STILL * before:
                stopped = _STUCK
            elif finer == scale:
                stopped = "no finer view fits" if finest > 1 else "the source captures one size"
            elif self._full(self._pixels * (finer / scale) ** 2, self._requests):
                stopped = _SPENT
            elif task.recorded is not None:
                stopped = "the recording holds no finer views"
            if stopped:
                yield Round((), stopped)
                return
            self._scale, before = finer, doubtful

    def _shared(self, centers: int | None, scale: int) -> Rounds:
        """Return the rounds of few centres, or of the strategy that is given."""
        options = self._task.options
        name = _FEW if options.strategy == "auto" else options.strategy
        changed = replace(options, accuracy=None, strategy=name, viewpoints=centers, truth_scale=scale)
        return strategy.rounds(replace(self._task, options=changed))

    def _can_capture(self, centers: int | None, scale: int) -> bool:
        """Return whether budgets allow centres, and a recording, if it is one, holds their depth."""
        task = self._task
        if task.recorded is not None:
            planned: list[Round] = []
            drive(self._shared(centers, scale), planned.append)
            kept = [viewpoint for round_ in planned for viewpoint in round_.viewpoints if viewpoint.keep]
            return task.recorded.hold(view for viewpoint in kept for view in viewpoint.views_of("depth"))
        requests = planned_requests(self._shared(centers, scale), task.modes)
        return not self._full(pixels_of(request.view for request in requests), len(requests))

    @property
    def _usual_scale(self) -> int:
        """How much finer ground truth is than colours to reach the aim in a furnished room."""
        task = self._task
        expected = _ROOM * SMALLEST / task.edge * task.rays.valid_count / (_SAFE * self._aim)
        return max(task.options.truth_scale, min(self._finest, math.ceil(expected)))

    def _improved(self, planned: Round) -> bool:
        """Choose other centres or finer views, if those of a round promise less; return whether it did.

        Depth is known when a round serves pixels: what it leaves in doubt foretells the doubt of the image.
        """
        now = self._centers, self._scale
        serving = [viewpoint for viewpoint in planned.viewpoints if viewpoint.known_depth is not None]
        if serving:
            self._choose(serving)
            self._probing = False
        elif self._probing and len(planned.viewpoints) > 1:
            self._tried += 1
            if self._tried > 1:  # some rays are hidden from the few
                self._centers, self._scale, self._probing = None, self._usual_scale, False
        coarsest = now[1] + 1 if self._centers == now[0] else 1
        for scale in range(self._scale, coarsest - 1, -1):
            if self._can_capture(self._centers, scale):
                self._scale = scale
                return True
        self._centers, self._scale = now
        return False

    def _choose(self, serving: Sequence[Viewpoint]) -> None:
        """Choose how many centres, and how fine, by the depth that viewpoints know."""
        known = [viewpoint.known_depth for viewpoint in serving if viewpoint.known_depth is not None]
        doubtful = sum(map(_depth_doubt, known))
        left, scale, most = doubtful / self._aim, self._scale, self._finest
        finer = math.ceil(scale * max(1.0, _MOST_DOUBT * left / _SAFE) ** _SHRINKS)
        if not self._probing:
            if _LEAST_DOUBT * left > 1 and self._task.options.truth_scale == 1:
                self._scale = min(most, finer)
            return
        usual = min(self._usual_scale, finer)
        views = [view for viewpoint in serving for view in viewpoint.views]
        area, many = pixels_of(views), INITIAL_VIEWPOINTS / len(serving)
        few_ms, many_ms = (self.price.of(len(views), area * size**2) for size in (finer, usual))
        if finer > most or few_ms > many * many_ms or not any(len(viewpoint.pixels) for viewpoint in serving):
            self._centers, self._scale = None, usual
        else:
            self._scale = finer

    def _without_colors(self, viewpoint: Viewpoint) -> Viewpoint:
        return replace(viewpoint, modes=self._truth) if viewpoint.modes is None else viewpoint

    # -- Finer captures

    def _finer(self, kept: Kept) -> Rounds:
        """Yield finer captures of what is in doubt, and at last why they end."""
        before, stuck = np.inf, 0
        for _ in range(_MOST_ROUNDS):
            assert kept.doubt is not None
            doubt = np.flatnonzero(kept.doubt())
            if len(doubt) <= self._aim:
                yield Round((), AIM)
                return
            stuck = stuck + 1 if len(doubt) > before * (1 - _FALLS) else 0
            if stuck == _PATIENCE:
                break
            before = len(doubt)
            choice = self._choice(doubt)
            if isinstance(choice, str):
                yield Round((), choice)
                return
            viewpoints = []
            for patch in sorted(choice.patches, key=lambda patch: (patch.view.width, patch.view.height)):
                pixels, view = doubt[patch.rows], patch.view
                self._focal_px[pixels] = choice.focal_px
                self._tries[pixels] += 1
                viewpoints.append(
                    Viewpoint(view.pose.t_w_c, (view,), pixels, self._truth, state=self._task.state)
                )
            sent = yield from self._counted(_once(Round(tuple(viewpoints))))
            assert sent is not None
            kept = sent
        yield Round((), _SPENT if self._limited else _STUCK)

    def _choice(self, doubt: Ints) -> _Choice | str:
        """Return the patches that promise to reach the aim for least, or why there are none."""
        task = self._task
        if not task.capabilities.can_set_size:
            return "the source captures one size"
        directions_w = self._task.directions_w(doubt)
        coarse = float(np.median(self._focal_px[doubt]))
        best: _Choice | None = None
        self._limited = False
        for finer in _FINER:
            choice = self._patched(doubt, directions_w, finer * coarse, best.ms if best else np.inf)
            if choice.patches and (best is None or choice.ms < best.ms):
                best = choice
        if best is None:
            return _SPENT if self._limited else "no finer view fits"
        if task.recorded is not None:
            held_ones = [patch for patch in best.patches if task.recorded.hold([patch.view])]
            return replace(best, patches=held_ones) if held_ones else "the recording holds no finer views"
        return best

    def _patched(self, doubt: Ints, directions_w: Array, focal_px: float, most_ms: float) -> _Choice:
        """Return patches of a focal length; not all of them if they cost more than another choice."""
        modes, left, target, ms, area = len(self._truth), float(len(doubt)), _SAFE * self._aim, 0.0, 0.0
        batch: list[Patch] = []
        for patch in self._patches(doubt, directions_w, focal_px):
            area += modes * patch.view.width * patch.view.height
            if self._full(area, modes * (len(batch) + 1)):
                self._limited = True
                break
            batch.append(patch)
            ms, left = ms + patch.price, left - patch.worth
            if left <= target or ms > most_ms:
                break
        if left > target and batch:  # bands are then thinner, views longer
            more = left / target
            thin = sum(patch.view.width * more * (2 * FACE_BORDER_PX + _BAND_PX * more) for patch in batch)
            ms += (1 - target / left) * modes * self.price.of(len(batch), thin)
        return _Choice(batch, focal_px, ms)

    def _patches(self, doubt: Ints, directions_w: Array, focal_px: float) -> Iterator[Patch]:
        """Yield patches, those first that resolve the most doubt at their price."""
        task, coarse = self._task, self._focal_px[doubt]
        worth = np.maximum(0, 1 - _LEFT * coarse / focal_px) * _AGAIN ** self._tries[doubt]
        if not task.capabilities.can_set_fov:
            yield from self._finer_faces(directions_w, focal_px, worth)
            return
        fine = Precision(focal_px, FACE_BORDER_PX, _BAND_PX / float(np.median(coarse)), len(self._truth))
        yield from patches(task.pose.t_w_c, directions_w, worth, fine, self.price, task.capabilities)

    def _finer_faces(self, directions_w: Array, focal_px: float, worth: Array) -> list[Patch]:
        """Return finer faces of a source that cannot set a field of view."""
        edge, faces = int(2 * focal_px), []
        if edge > LARGEST_FACE_PX:
            return []
        views = CubeFaces(self._task, edge, 0).views(self._task.pose.t_w_c, ALL_FACES)
        for number, view in enumerate(views):
            rows = np.flatnonzero(_view_of(directions_w, views, 0) == number)
            price = len(self._truth) * self.price.of(1, view.width * view.height)
            faces.append(Patch(view, rows, float(worth[rows].sum()), price))
        worthy = (patch for patch in faces if patch.worth > 0)
        return sorted(worthy, key=lambda patch: -patch.worth / patch.price)

    def _full(self, pixels: float, requests: int) -> bool:
        """Return whether more captures exceed a budget."""
        options = self._task.options
        requests, megapixels = self._requests + max(1, requests), (self._pixels + pixels) / 1e6
        too_many = options.most_captures is not None and requests > options.most_captures
        return too_many or (options.most_megapixels is not None and megapixels >= options.most_megapixels)


def _view_of(directions_w: Array, views: Sequence[View], border_px: int) -> Ints:
    """Return (N,) the first view that holds each ray, or the last one."""
    view_of = np.full(len(directions_w), len(views) - 1)
    for number, view in reversed(list(enumerate(views))):
        half = (np.array([view.width, view.height]) / 2 - border_px) / view.focal_px
        view_of[held(directions_w, view.pose.R_w_c, half)] = number
    return view_of


def _depth_doubt(known: KnownDepth) -> int:
    """Return how many pixels' depth is in doubt."""
    with np.errstate(invalid="ignore"):
        off = ~(known.error <= _DEPTH * known.distance)
    return int(np.count_nonzero(known.grazes | known.unsure | off))


def _once(round_: Round) -> Rounds:
    yield round_
