"""Images with several optical centres and a given accuracy: captures from few centres, finer where it helps.

Depth is captured coarsely at the camera's position. Rays are marched through it
(:mod:`omniscv.depth.ray_marching`), and centres are added where rays are hidden from there. Where a ray
passes another surface within a pixel, or ends at an edge, finer patches of depth replace the coarse one, and
the ray is marched again. So no centre is captured finer as a whole.
"""

import math
from collections import defaultdict
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints, Mask
from omniscv.planning import tuned
from omniscv.planning.patches import Doubt
from omniscv.planning.plan import Plan
from omniscv.planning.ray_search import Search, serving_all
from omniscv.planning.rays import Groups, RayGroup
from omniscv.planning.refinement import STUCK, Choice, Refinement, first_view
from omniscv.planning.rounds import Captures, Round, Rounds, Viewpoint, pixels_of
from omniscv.planning.viewpoints import capture_around, edges_around, holds_search, occlusion
from omniscv.planning.views import FACE_BORDER_PX
from omniscv.sources.base import Capture, View

_NONE = np.zeros(0, np.int64)


def searches_given_centers(plan: Plan) -> bool:
    """Return whether what rays meet is searched from as many optical centres as the options give.

    So it is where the source has depth and sets its views. Recordings from before the search was there hold
    other pictures around the camera, and are composed as they were made.
    """
    if plan.options.viewpoints is None or plan.rays.one_center:
        return False
    if "depth" not in plan.capabilities.modes or not plan.sets_views:
        return False
    if plan.recorded is None:
        return True
    return holds_search(plan) and plan.recorded.hold(
        Search(replace(plan, recorded=None), plan.groups()).first_views()
    )


class SeveralCenters(Refinement):
    """The captures of an image whose rays start at several optical centres."""

    serves = False  # masks wait until depth is known

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self._search: Search
        self._shown_finer: Mask  # rays that finer depth shows
        self._was_wrong: Mask  # those that coarser depth was wrong about
        self._occluded: Mask | None = None
        self._focal_px = float(self.focal_px[0])  # of coarse views
        self._finer: dict[int, list[View]] = defaultdict(list)  # by the number of their centre, finest first

    def planned(self) -> Rounds:
        """Yield the rounds of the image: first what rays pass through, then what they hit.

        1. Coarse depth at the camera's position and at few centres; rays are marched through it.
        2. Finer depth where a ray is in doubt.
        3. All modes in coarse views of what rays hit, and finer patches while they resolve enough.

        If the source lacks depth or settable views, the rounds of ``exact`` come instead.
        """
        groups = self._groups()
        if isinstance(groups, str):
            yield from self._exactly(groups)
            return
        around = None
        if len(groups) > 1 or self.plan.options.viewpoints is not None:
            around = yield from capture_around(self.plan, groups, edges_around(self.plan, searched=True))
        self._search = search = Search(self.plan, groups)
        self._shown_finer = np.zeros(len(search.pixels), np.bool_)
        self._was_wrong = np.zeros(len(search.pixels), np.bool_)
        if not (yield from self._march(groups)):
            return
        if around is None and len(groups) == 1:  # captured at the camera's position
            around = search.shells[0]
        if around is not None:
            self._occluded = occlusion(around, search.origins_w)[1]
        search.adopt_lost()
        rate = yield from self._refine_depth()
        self.reserved = 0, 0
        all_rows = np.arange(len(search.pixels))
        yield Round(tuple(self._coarse_views(all_rows, self.plan.modes)))
        if not self.truth:
            yield Round((), self.reached if len(self.doubtful()) <= self.doubt_pixels else STUCK)
            return
        if rate:
            yield from self._serve(self._rows_of(self.doubtful()), rate)
        yield from self.finer()

    def _refine_depth(self) -> Generator[Round, Captures | None, float]:
        """Yield finer depth while it resolves enough.

        Returns:
            The price of a pixel that the last patches resolved, ms; 0 without any.
        """
        search = self._search
        rate = 0.0
        most = math.inf
        for _ in range(tuned.DEPTH_ROUNDS):
            doubt = search.pixels[search.doubtful(search.hits)]
            enough = tuned.EDGES * self.doubt_pixels if self.truth else self.doubt_pixels
            if not enough < len(doubt) < most:
                break
            choice = self.choice(doubt)
            if isinstance(choice, str):
                break
            rate = choice.rate
            most = len(doubt) - tuned.LEAST_RESOLVED * choice.promised
            yield from self._capture_depth(choice)
        return rate

    def _exactly(self, why: str) -> Rounds:
        """Yield the rounds of ``exact`` instead, and why."""
        yield from self.exact().rounds()
        if self.plan.doubt is not None:
            yield Round((), why, "exact")

    def _groups(self) -> Groups | str:
        """Return the pixels by the centres that are captured first: one, unless the options give others; or
        why the captures are not planned."""
        plan = self.plan
        if "depth" not in plan.capabilities.modes:
            return "the source captures no depth"
        if plan.options.accuracy is None and not (plan.sets_views or plan.scattered):
            return "the source cannot set size and field of view"
        # Of ``auto``, the views as they are planned: others may be recorded without colours, or coarser.
        planned = plan if plan.options.accuracy is not None else replace(plan, recorded=None)
        choices: list[Groups] = []
        if plan.options.viewpoints is None:
            choices.append((RayGroup(np.zeros(3), np.flatnonzero(plan.rays.valid), plan.rays),))
        if plan.recorded is not None or not choices:
            choices.append(plan.groups(tuned.INITIAL_VIEWPOINTS))
        for groups in choices:
            if plan.recorded is None or plan.recorded.hold(Search(planned, groups).first_views()):
                return groups
        return choices[0] if plan.scattered else "the recording holds other captures"

    def _march(self, groups: Groups) -> Generator[Round, Captures | None, bool]:
        """Yield depth at few centres, and at more while these are worth it; return whether it was sent."""
        search = self._search
        plan = self.plan
        hidden = math.inf
        viewpoints = [search.depth_viewpoint(plan.pose.to_world(group.center_c)) for group in groups]
        while viewpoints:
            serving = Round(tuple(map(serving_all, viewpoints))).changed(plan.finished)
            later = serving.requests(plan.modes)
            requests, pixels = self.reserved
            later_pixels = pixels_of(request.view for request in later)
            self.reserved = requests + len(later), pixels + later_pixels
            kept = yield Round(tuple(viewpoints))
            if kept is None:  # only a plan
                yield serving
                self.expected_ms = self.local_ms(tuned.ROOM_OF_FEW_CENTERS * tuned.ROOM)
                return False
            search.march([captures["depth"] for captures in kept])
            before = hidden
            hidden = float(np.count_nonzero(~search.hits.sure))
            if not tuned.MOST_HIDDEN * self.doubt_pixels < hidden < tuned.HIDDEN_LEFT * before:
                break
            origin_w = search.hidden_origin(max(1.0, tuned.LEAST_PROMISED * self.doubt_pixels))
            if origin_w is None:
                break
            more = search.depth_viewpoint(origin_w)
            if not self._may_capture(more):
                break
            viewpoints = [more]
        return True

    def _may_capture(self, viewpoint: Viewpoint) -> bool:
        """Return whether budgets and a recording allow one more viewpoint, of depth and then of masks."""
        plan = self.plan
        serving = plan.finished(serving_all(viewpoint))
        requests = viewpoint.requests(plan.modes) + serving.requests(plan.modes)
        if self.full(pixels_of(request.view for request in requests), len(requests)):
            return False
        return plan.recorded is None or plan.recorded.hold(viewpoint.views_of("depth"))

    def _coarse_views(self, rows: Ints, modes: tuple[str, ...]) -> Iterator[Viewpoint]:
        """Yield the viewpoints of rays with coarse views, a centre each."""
        for number in np.unique(self._search.shell_of[rows]):
            mine = rows[self._search.shell_of[rows] == number]
            yield replace(self._viewpoint(mine), modes=modes)

    def _serve(self, rows: Ints, rate: float, again: bool = False) -> Rounds:
        """Yield the patches of rays whose depth is not in doubt, as far as these are worth their price.

        Args:
            rows: (N,) the rays.
            rate: worth of a ray, ms.
            again: whether rays that no patch shows are served by coarse views once more.
        """
        chosen = []
        request_count = 0
        pixel_count = 0
        for viewpoint in self._serving_viewpoints(rows, again):
            requests = viewpoint.requests(self.patched)
            pixels = pixels_of(request.view for request in requests)
            if self.price.of(len(requests), pixels) > rate * len(viewpoint.pixels):
                continue
            if self.full(pixel_count + pixels, request_count + len(requests)):
                continue
            chosen.append(viewpoint)
            request_count += len(requests)
            pixel_count += pixels
            self.focal_px[viewpoint.pixels] = viewpoint.views_of("depth")[0].focal_px
        if chosen:
            yield Round(tuple(chosen))

    def _serving_viewpoints(self, rows: Ints, again: bool) -> list[Viewpoint]:
        """Return the viewpoints of the patches that show rays whose depth is not in doubt; see ``_serve``."""
        search = self._search
        viewpoints = []
        certain = rows[~search.doubtful(search.hits.of(rows))]
        for number in np.unique(search.shell_of[certain]):
            rows_here = certain[search.shell_of[certain] == number]
            views = self._finer[number]
            patch_of = first_view(search.toward_w(rows_here), views, FACE_BORDER_PX)
            for index, view in enumerate(views):
                shown = rows_here[patch_of == index]
                if len(shown):
                    viewpoints.append(replace(self._viewpoint(shown, view), modes=self.patched))
            unseen = rows_here[patch_of < 0]
            if again and len(unseen):
                viewpoints += self._coarse_views(unseen, self.patched)
        return viewpoints

    def _viewpoint(self, rows: Ints, view: View | None = None) -> Viewpoint:
        """Return the viewpoint of rays that one centre serves, with a patch or with coarse views."""
        occluded = None if self._occluded is None else self._occluded[rows]
        viewpoint = self._search.viewpoint(rows, None if view is None else (view,), occluded)
        known = viewpoint.known_depth
        if view is None and known is not None:  # masks coarser than depth may be wrong without a sign
            doubtful = self._shown_finer[rows] & self._search.doubtful(self._search.hits.of(rows))
            known = known._replace(grazes=known.grazes | self._was_wrong[rows] | doubtful)
        return replace(viewpoint, known_depth=known)

    def doubts(self, pixels: Ints) -> list[Doubt]:
        search = self._search
        rows = self._rows_of(pixels)
        hits = search.hits.of(rows)
        deep = search.doubtful(hits)
        beside = deep & (hits.beside_from <= hits.beside_to)
        helped = ~hits.known_depth().unsure | (hits.hidden_from > hits.hidden_to)  # finer depth shows an end
        rows_of_parts = []
        directions_of_parts = []
        for chosen, reach in (
            (helped & ~beside, hits.reach),
            (helped & beside, hits.beside_from),
            (helped & beside & (hits.beside_to > hits.beside_from), hits.beside_to),
        ):
            rows_of_parts.append(rows[chosen])
            directions_of_parts.append(search.toward_w(rows[chosen], reach[chosen]))
        helped_rows = np.concatenate(rows_of_parts)
        toward_w = np.concatenate(directions_of_parts)
        toward_w /= np.linalg.norm(toward_w, axis=1, keepdims=True)
        deep = deep[np.searchsorted(rows, helped_rows)]
        doubts: list[Doubt] = []
        for number in np.unique(search.shell_of[helped_rows]):
            mine = np.flatnonzero(search.shell_of[helped_rows] == number)
            coarse = self._focal_px_of(number, search.pixels[helped_rows[mine]], toward_w[mine], deep[mine])
            pixels = search.pixels[helped_rows[mine]]
            doubts.append(Doubt(int(number), search.centers_w[number], pixels, toward_w[mine], coarse))
        return doubts

    def _focal_px_of(self, number: int, pixels: Ints, toward_w: Array, deep: Mask) -> Floats:
        """Return how finely a centre captured pixels so far: their depth where ``deep``, else masks."""
        views = self._finer[number]
        focal_px = np.array([*(view.focal_px for view in views), self._focal_px], np.float32)
        patch_of = first_view(toward_w, views, FACE_BORDER_PX)
        patch_of[patch_of < 0] = len(views)  # coarse views
        return np.where(deep, focal_px[patch_of], self.focal_px[pixels])

    def _rows_of(self, pixels: Ints) -> Ints:
        """Return the rays of pixels."""
        return np.searchsorted(self._search.pixels, pixels)

    def capture(self, choice: Choice) -> Rounds:
        rows, wrong = yield from self._capture_depth(choice)
        if len(wrong):  # until finer masks are captured
            search = self._search
            known = search.hits.of(wrong).known_depth()._replace(unsure=np.ones(len(wrong), np.bool_))
            pixels = search.pixels[wrong]
            yield Round((Viewpoint(search.centers_w[0], (), pixels, modes=(), known_depth=known),))
            rows = np.union1d(rows, wrong)
        yield from self._serve(rows, choice.rate, again=True)

    def _capture_depth(self, choice: Choice) -> Generator[Round, Captures | None, tuple[Ints, Ints]]:
        """Yield depth in patches and march rays again; return those of the patches, and those that coarser
        depth was wrong about."""
        views: dict[int, list[View]] = defaultdict(list)
        for patch in choice.patches:
            views[patch.center].append(patch.view)
        viewpoints = []
        for patches in views.values():
            center_w = patches[0].pose.t_w_c
            viewpoints.append(Viewpoint(center_w, tuple(patches), _NONE, modes=("depth",), keep=True))
        kept = yield Round(tuple(viewpoints))
        assert kept is not None
        finer = {}
        for number, captures in zip(views, kept, strict=True):
            finer[number] = captures["depth"]
            self._finer[number] += [capture.view for capture in captures["depth"]]
            self._finer[number].sort(key=lambda view: -view.focal_px)
        rows = self._rows_of(np.unique(np.concatenate([patch.pixels for patch in choice.patches])))
        return rows, self._march_again(rows, finer)

    def _march_again(self, doubted: Ints, finer: Mapping[int, Sequence[Capture]]) -> Ints:
        """March doubted rays again through finer depth, and those of which several centres were asked; return
        those that coarser depth was wrong about."""
        search = self._search
        again = np.union1d(doubted, np.flatnonzero(search.asked > 1))
        clear = again[~search.doubtful(search.hits.of(again))]
        search.march_again(again, finer)
        wrong = [clear[search.doubtful(search.hits.of(clear))]]
        self._shown_finer[doubted] = True
        for number, captures in finer.items():
            mine = np.flatnonzero((search.shell_of == number) & ~search.doubtful(search.hits))
            mine = np.setdiff1d(mine, again, assume_unique=True)
            views = [capture.view for capture in captures]
            shown = mine[first_view(search.toward_w(mine), views, FACE_BORDER_PX) >= 0]
            self._shown_finer[shown] = True
            wrong.append(search.corrected(shown, number))
        search.adopt_lost()
        rows = np.concatenate(wrong)
        self._was_wrong[rows] = True
        return rows
