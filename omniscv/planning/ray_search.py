"""Rays of several optical centres, and what they meet in depth that was captured at few.

Rays are marched through the depth captured at one centre after the other, the nearest first, until all of the
way is known to be free (:mod:`omniscv.depth.ray_marching`). A part of the way is in doubt only where no
centre sees it free (:meth:`Hits.narrow`). The pixel is looked up at the centre that knows most of its ray.

Where it fails: objects thinner than a pixel of a capture, which a ray may pass unnoticed; mirrors, glass
and gloss, whose lit colour depends on the viewpoint; a rim of half a capture's pixel around silhouettes,
where the nearest pixel may show the other side; surfaces seen at a grazing angle by every centre.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from omniscv import modalities
from omniscv.depth.depth_shell import DepthShell, depth_shell, distances
from omniscv.depth.hits import DOUBTFUL, FAR_M, Hits, KnownDepth
from omniscv.depth.ray_marching import march
from omniscv.geometry import Array, Pose
from omniscv.geometry.arrays import Ints, Mask
from omniscv.planning import tuned
from omniscv.planning.plan import Plan
from omniscv.planning.rays import Groups, looking
from omniscv.planning.rounds import Viewpoint, pixels_of
from omniscv.planning.views import FACE_BORDER_PX, STEEPEST, CubeFaces, faces_hit, holding_view
from omniscv.render_options import Price
from omniscv.sources.base import Capture, View


def serving_all(viewpoint: Viewpoint) -> Viewpoint:
    """Return a viewpoint of depth as if it served all of the image, for plans."""
    known = KnownDepth(*np.zeros((3, 0), np.float32), *np.zeros((2, 0), np.bool_))
    return replace(viewpoint, modes=None, keep=False, known_depth=known)


class Search:
    """The image's valid rays in the world, and what each is known to meet.

    Attributes:
        origins_w, directions_w: (N, 3), unit directions.
        center_of: (N,) the row of the optical centre among the camera's own viewpoints.
        hits: of the rays, as far as they are known.
        pixels: (N,) their flat indices in the image.
        shell_of: (N,) the number of the centre that serves the ray; -1: none does.
        asked: (N,) through how many centres' depth the ray was marched.
    """

    def __init__(self, plan: Plan, groups: Groups) -> None:
        rays = plan.rays
        self._plan = plan
        self._truth = any(modalities.get(mode).truth for mode in plan.modes)
        self.pixels = np.flatnonzero(rays.valid)
        self.origins_w = plan.origins_w(self.pixels)
        self.directions_w = plan.directions_w(self.pixels)
        own = rays.own_viewpoints
        self.center_of = own.index.ravel()[self.pixels].astype(np.int64)
        steps = rays.steps.ravel()[self.pixels]
        self._steps = np.where(steps > 0, steps, np.nanmedian(steps))  # unknown for a rim's single pixels
        self.shell_of = np.full(len(self.pixels), -1)
        self.hits = Hits.unknown(len(self.pixels))
        self.shells: list[DepthShell] = []
        self._faces = CubeFaces(plan, plan.edge, plan.border(FACE_BORDER_PX))
        self.asked = np.zeros(len(self.pixels), np.int64)
        self._first_w = [plan.pose.to_world(group.center_c) for group in groups]
        # A ray may be looked up at any centre: all faces that any of the camera's rays hits.
        hit = [faces_hit(group.directions, plan.pose.R_w_c) for group in groups]
        sample = slice(None, None, max(1, len(self.origins_w) // tuned.SAMPLED_RAYS))
        for group in groups:  # and those that see parts of the rays' way
            offset = self.origins_w[sample] - plan.pose.to_world(group.center_c)
            away = np.linalg.norm(offset, axis=1, keepdims=True)
            for part in tuned.ON_THE_WAY:
                points = offset + part * away * self.directions_w[sample]
                hit.append(faces_hit(points, np.eye(3)))
        self._hit = np.any(hit, axis=0)

    def depth_viewpoint(self, center_w: Array) -> Viewpoint:
        """Return a viewpoint whose depth is kept, and that serves no pixel yet."""
        views = self._faces.views(center_w, self._hit)
        scale = self._plan.options.truth_scale
        no_pixel = np.zeros(0, np.int64)
        return Viewpoint(center_w, views, no_pixel, modes=("depth",), keep=True, truth_scale=scale)

    def first_views(self) -> list[View]:
        """Return the views of depth at the groups' centres."""
        views: list[View] = []
        for center_w in self._first_w:
            views += self.depth_viewpoint(center_w).views_of("depth")
        return views

    def march(self, depth: Sequence[Sequence[Capture]]) -> None:
        """March rays that are not yet certified through depth captured at new centres, the nearest first."""
        first = len(self.shells)
        for captures in depth:
            self.shells.append(depth_shell(captures[0].view.pose.t_w_c, captures))
        self._march(np.flatnonzero(self.doubtful(self.hits)), first)

    def _march(self, unsure: Ints, first: int) -> None:
        """March rays that are not certified through the nearest centres, from the first one on."""
        nearest = self._nearest(unsure)
        for rank in range(nearest.shape[1]):
            for number in range(first, len(self.shells)):
                rows = unsure[(nearest[:, rank] == number) & self.doubtful(self.hits.of(unsure))]
                if len(rows):
                    self._march_through(number, rows)

    def _nearest(self, rows: Ints) -> Ints:
        """Return (N, C) the centres in the order of their distance from rays' origins."""
        x, y, z = (self.origins_w[rows].T[:, :, None] - self.centers_w.T[:, None]) ** 2
        away = x + y + z  # a sum over an axis of three takes twice as long
        return np.argsort(away, axis=1, kind="stable")

    @property
    def centers_w(self) -> Array:
        """(C, 3) the centres of captured depth, world frame, metres."""
        return np.array([shell.center_w for shell in self.shells])

    def march_again(self, rows: Ints, finer: Mapping[int, Sequence[Capture]]) -> None:
        """March ``rows`` of rays anew, through depth that is ``finer`` now, by the number of its centre."""
        for number, captures in finer.items():
            self.shells[number] = self.shells[number].refined(captures)
        self.hits[rows] = Hits.unknown(len(rows))
        self.asked[rows] = 0
        self.shell_of[rows] = -1
        self._march(rows, 0)

    def corrected(self, rows: Ints, number: int) -> Ints:
        """March rays again through the centre that serves them, where depth is finer now.

        Relief finer than a capture's pixels makes its depth wrong without a sign of it.

        Args:
            rows: (N,) the rays.
            number: of the centre.

        Returns:
            Of the rays that meet something else in finer depth, or an edge: their hits are replaced.
        """
        before = self.hits.of(rows)
        after = self._through(number, rows)
        with np.errstate(invalid="ignore"):
            off = np.abs(after.reach - before.reach)
            bounded = (off < np.inf) & (after.error < np.inf) & (off <= before.error + after.error)
        wrong = ~bounded & ~(np.isposinf(before.reach) & np.isposinf(after.reach))
        self.hits[rows[wrong]] = after[wrong]
        self.asked[rows[wrong]] = 1
        self.shell_of[rows[wrong & np.isnan(after.reach)]] = -1
        return rows[wrong]

    def doubtful(self, hits: Hits) -> Mask:
        """Return (N,) whether the depth of rays is in doubt; for colours alone, whether it is unverified."""
        known = hits.known_depth()
        if not self._truth:
            return known.unsure
        with np.errstate(invalid="ignore"):
            off = ~(known.error <= DOUBTFUL * known.distance)
        return np.asarray(known.grazes | known.unsure | off)

    def hidden_origin(self, worth: float) -> Array | None:
        """Return the origin (3,), world frame, metres, around which most rays are not certified; None where
        these are fewer than ``worth``."""
        groups = int(self.center_of.max()) + 1
        hidden = self.center_of[~self.hits.sure]
        reach = max(1, groups // tuned.NEIGHBOURHOODS)
        before = np.concatenate([[0], np.cumsum(np.bincount(hidden, minlength=groups))])
        at = np.arange(groups)
        around = before[np.minimum(at + reach + 1, groups)] - before[np.maximum(at - reach, 0)]
        off = np.abs(self.center_of - np.argmax(around))
        return self.origins_w[np.flatnonzero(off == off.min())[-1]] if around.max() >= worth else None

    def adopt_lost(self) -> None:
        """Serve rays that no depth map serves from the nearest centre, by what it sees in their direction;
        nothing is known of them."""
        lost = np.flatnonzero(self.shell_of < 0)
        self.shell_of[lost] = self._nearest(lost)[:, 0]
        for number in np.unique(self.shell_of[lost]):
            rows = lost[self.shell_of[lost] == number]
            self.hits.reach[rows] = distances(self.shells[number], self.directions_w[rows])[1]

    def _through(self, number: int, rows: Ints) -> Hits:
        hits = march(self.shells[number], self.origins_w[rows], self.directions_w[rows])
        hits.distrust(~(hits.direction_error <= tuned.MOST_ERROR_PX * self._steps[rows]))
        return hits

    def _march_through(self, number: int, rows: Ints) -> None:
        hits = self._through(number, rows)
        known = self.hits.of(rows)
        alone = hits.copy()
        agree = hits.narrow(known)
        known.narrow(alone)
        # A guess is better than none, and the nearer centre's is better than a farther one's.
        better = (hits.sure & ~known.sure) | (np.isnan(known.reach) & ~np.isnan(hits.reach))
        resolved = agree & self.doubtful(known) & ~self.doubtful(hits)
        better |= resolved & np.isfinite(known.error)  # where one sees an edge, the other may be too coarse
        known[better] = hits[better]
        self.shell_of[rows[better]] = number
        self.asked[rows] += 1
        self.hits[rows] = known

    def viewpoint(self, rows: Ints, views: tuple[View, ...] | None, occluded: Mask | None) -> Viewpoint:
        """Return the viewpoint of rays that one centre serves.

        Args:
            rows: (N,) the rays.
            views: which see what they meet; None: the cheapest that do.
            occluded: (N,) whether their own optical centres are.
        """
        center_w = self.shells[self.shell_of[rows[0]]].center_w
        toward_w = self.toward_w(rows)
        viewpoint = Viewpoint(
            center_w,
            self._coarse_views(center_w, toward_w) if views is None else views,
            self.pixels[rows],
            toward_w=toward_w,
            known_depth=self.hits.of(rows).known_depth(),
            occluded=occluded,
            truth_scale=self._plan.options.truth_scale if views is None else 1,
        )
        return self._plan.finished(viewpoint)

    def _coarse_views(self, center_w: Array, toward_w: Array) -> tuple[View, ...]:
        """Return faces that hold rays, or one view where that is cheaper."""
        plan = self._plan
        faces = self._faces.views(center_w, faces_hit(toward_w, np.eye(3)))
        if plan.shared or plan.options.seams != "keep" or not plan.sets_views:
            return faces
        rays = toward_w / np.linalg.norm(toward_w, axis=1, keepdims=True)
        R_w_c, half = looking(rays, rays.mean(axis=0), plan.pose.R_w_c[:, 1])
        pose = Pose(center_w, R_w_c)
        price = Price(*plan.options.capture_ms)
        if half.max() > STEEPEST:
            return faces
        view = holding_view(plan, pose, half, plan.edge / 2)
        if view is None or price.of(1, pixels_of([view])) >= price.of(len(faces), pixels_of(faces)):
            return faces
        return (view,)

    def toward_w(self, rows: Ints, reach: Array | None = None) -> Array:
        """Return (N, 3) from the centre of each ray of ``rows`` (N,) to a point of it, ``reach`` (N,) metres
        along it; None: what it meets."""
        reach = self.hits.reach[rows] if reach is None else reach
        far = np.where(np.isfinite(reach), reach, FAR_M)[:, None]
        points_w = self.origins_w[rows] + far * self.directions_w[rows]
        return np.asarray(points_w - self.centers_w[self.shell_of[rows]])
