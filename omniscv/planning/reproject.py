"""Non-central images from few optical centres: every ray finds its point in depth captured elsewhere.

Rays are marched through the depth captured at the nearest centres until one certifies that all of the way
is free (:mod:`omniscv.planning.depth_marching`): the pixel is then looked up there, in the direction of the
point that the ray meets. What no depth map serves is captured exactly, from the ray's own centre.

Where it fails: objects thinner than a pixel of a capture, which a ray may pass unnoticed; mirrors, glass
and gloss, whose lit colour depends on the viewpoint; a rim of half a capture's pixel around silhouettes,
where the nearest pixel may show the other side; surfaces seen at a grazing angle by every centre.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array
from omniscv.planning.base import FoundDepth, Round, Rounds, Strategy, Task, Viewpoint
from omniscv.planning.cube_faces import FACE_BORDER_PX, CubeFaces, faces_hit
from omniscv.planning.depth_marching import Met, march
from omniscv.planning.depth_shell import DepthShell, depth_shell
from omniscv.planning.exact import cheapest_viewpoints, face_viewpoints
from omniscv.planning.viewpoints import Groups, ray_group
from omniscv.planning.visibility import look_around, visible
from omniscv.sources.base import Capture

INITIAL_VIEWPOINTS = 8
_DEFAULT_ERROR_PX = 0.5
_TRIES = 4
"""Through how many centres, nearest first, a ray is marched."""
_ON_SURFACE = 0.003
"""Of the reach: rays that end nearer to each other than this meet the same surface."""
_SAMPLED_RAYS = 20_000
_ON_THE_WAY = (0.0, 0.3, 0.6, 1.0, 2.0, 4.0)  # of the distance from a centre to the ray's origin
_FAR = 1e6  # metres: where the direction to a point of the sky is the ray's own


class Reproject(Strategy):
    """Capture depth at a few centres, and everything else where rays are then found."""

    name = "reproject"
    approximate = True
    max_rounds: ClassVar[int] = 1

    def rounds(self, task: Task) -> Rounds:
        groups = task.groups(None if task.rays.camera.central else INITIAL_VIEWPOINTS)
        around = yield from look_around(task, groups)
        if len(groups) < 2:
            yield Round(face_viewpoints(task, groups, around))
            return
        rays = MarchedRays(task, groups)
        centers_w = [task.pose.to_world(group.center_c) for group in groups]
        for _ in range(self.max_rounds):
            viewpoints = tuple(rays.depth_viewpoint(center_w) for center_w in centers_w)
            kept = yield Round(viewpoints)
            if kept is None:  # only a plan: as if every centre served a pixel
                known = FoundDepth(*np.zeros((5, 0)))
                yield Round(tuple(replace(v, modes=None, keep=False, found=known) for v in viewpoints))
                return
            rays.march([each["depth"] for each in kept])
            centers_w = self.next_centers(rays)
            if not centers_w:
                break
        yield Round((*rays.found(around), *rays.exact(around)))

    def next_centers(self, rays: MarchedRays) -> list[Array]:
        """Return where to capture depth next, (3,) world frame each."""
        return []


class MarchedRays:
    """The image's valid rays, in the world, and what is known of each.

    Attributes:
        origins_w, directions_w: (N, 3), unit directions.
        own: (N,) the row of the optical centre among the camera's own viewpoints.
        met: what each ray meets, as far as it is known.
    """

    def __init__(self, task: Task, groups: Groups) -> None:
        rays, origins = task.rays, task.rays.origins
        assert origins is not None
        self._task = task
        self._pixels = np.flatnonzero(rays.valid)
        self._directions_c = rays.directions.reshape(-1, 3)[self._pixels]
        self.origins_w = task.pose.to_world(origins.reshape(-1, 3)[self._pixels])
        self.directions_w = self._directions_c @ task.pose.R_w_c.T
        own = rays.own
        self.own, self._own_centers_c = own.index.ravel()[self._pixels].astype(np.int64), own.centers
        steps = rays.steps.ravel()[self._pixels]
        self._steps = np.where(steps > 0, steps, np.nanmedian(steps))  # unknown for a rim's single pixels
        count = len(self._pixels)
        self._shell_of = np.full(count, -1)
        self.met = Met.nothing(count)
        self._shells: list[DepthShell] = []
        self._faces = CubeFaces(task, task.edge, task.border(FACE_BORDER_PX))
        # A ray may be looked up at any centre: all faces that any of the camera's rays hits.
        hit = [faces_hit(group.directions, task.pose.R_w_c) for group in groups]
        centers_w = [task.pose.to_world(group.center_c) for group in groups]
        self._hit = np.any([*hit, *map(self._faces_on_the_way, centers_w)], axis=0)

    def depth_viewpoint(self, center_w: Array) -> Viewpoint:
        """Return a viewpoint whose depth is kept, and that serves no pixel yet."""
        views = self._faces.views(center_w, self._hit)
        return Viewpoint(center_w, views, np.zeros(0, np.int64), modes=("depth",), keep=True)

    def _faces_on_the_way(self, center_w: Array) -> NDArray[np.bool_]:
        """(6,) which faces of a centre see parts of the rays' way."""
        some = slice(None, None, max(1, len(self.origins_w) // _SAMPLED_RAYS))
        offset, directions_w = self.origins_w[some] - center_w, self.directions_w[some]
        away = np.linalg.norm(offset, axis=1, keepdims=True)
        ways = [faces_hit(offset + part * away * directions_w, np.eye(3)) for part in _ON_THE_WAY]
        return np.asarray(np.any(ways, axis=0))

    def march(self, depth: Sequence[Sequence[Capture]]) -> None:
        """March the rays that are not yet certified through the nearest centres, the new ones only."""
        first = len(self._shells)
        self._shells += [depth_shell(captures[0].view.pose.t_w_c, captures) for captures in depth]
        centers_w = np.array([shell.center_w for shell in self._shells])
        open_ = np.flatnonzero(~self.met.sure)
        x, y, z = (self.origins_w[open_].T[:, :, None] - centers_w.T[:, None]) ** 2
        away = x + y + z  # a sum over an axis of three takes twice as long
        nearest = np.argsort(away, axis=1, kind="stable")[:, :_TRIES]
        for rank in range(nearest.shape[1]):
            for number in range(first, len(self._shells)):
                mine = open_[(nearest[:, rank] == number) & ~self.met.sure[open_]]
                if len(mine):
                    self._march_through(number, mine)

    def _march_through(self, number: int, mine: NDArray[np.int64]) -> None:
        met = march(self._shells[number], self.origins_w[mine], self.directions_w[mine])
        limit = self._task.options.max_error_px
        behind = met.reach <= 0  # a hit counts only in front of the ray's origin
        error_px = met.direction_error / self._steps[mine]
        met.reach[behind] = np.nan
        wrong = ~(error_px <= (_DEFAULT_ERROR_PX if limit is None else limit)) | behind
        met.sure[wrong], met.hidden_from[wrong], met.hidden_to[wrong] = False, 0.0, np.inf
        self._join(mine, met)
        # A guess is better than none, and the nearer centre's is better than a farther one's.
        better = met.sure | (np.isnan(self.met.reach[mine]) & ~np.isnan(met.reach))
        chosen = mine[better]
        self._shell_of[chosen] = number
        for known, new in zip(self.met, met, strict=True):
            known[chosen] = new[better]

    def _join(self, mine: NDArray[np.int64], met: Met) -> None:
        """Certify rays that several centres together see all of, and let meet the same surface."""
        known = self.met.of(mine)
        with np.errstate(invalid="ignore"):
            same = (known.reach == met.reach) | (
                np.abs(known.reach - met.reach) <= known.error + met.error + _ON_SURFACE * known.reach
            )
        same &= ~met.sure & ~np.isnan(known.reach)
        self.met.hidden_from[mine[same]] = np.maximum(known.hidden_from, met.hidden_from)[same]
        self.met.hidden_to[mine[same]] = np.minimum(known.hidden_to, met.hidden_to)[same]
        together = mine[same]
        self.met.sure[together] = self.met.hidden_from[together] >= self.met.hidden_to[together]
        self.met.grazes[together] |= met.grazes[same]
        passed = mine[same & met.grazes]
        self.met.error[passed] = np.maximum(self.met.error[passed], met.error[same & met.grazes])

    def found(self, around: DepthShell | None) -> Iterator[Viewpoint]:
        """Yield the centres through which rays were found, with the faces that see the points."""
        occluded = None if around is None else ~visible(around, self.origins_w)
        for number, shell in enumerate(self._shells):
            mine = np.flatnonzero(self._shell_of == number)
            if not len(mine):
                continue
            met = self.met.of(mine)
            reach = np.where(np.isfinite(met.reach), met.reach, _FAR)[:, None]
            toward_w = self.origins_w[mine] + reach * self.directions_w[mine] - shell.center_w
            views = self._faces.views(shell.center_w, faces_hit(toward_w, np.eye(3)))
            hidden = None if occluded is None else occluded[mine]
            yield Viewpoint(
                shell.center_w,
                views,
                self._pixels[mine],
                toward_w=toward_w,
                found=met.found(),
                occluded=hidden,
            )

    def exact(self, around: DepthShell | None) -> tuple[Viewpoint, ...]:
        """Return the rays' own centres for those that no depth map serves."""
        lost = np.flatnonzero(self._shell_of < 0)
        order = lost[np.argsort(self.own[lost], kind="stable")]
        starts = np.flatnonzero(np.diff(self.own[order], prepend=-1))
        groups = [
            ray_group(self._own_centers_c[self.own[mine[0]]], self._pixels[mine], self._directions_c[mine])
            for mine in np.split(order, starts[1:])
            if len(mine)
        ]
        return cheapest_viewpoints(self._task, groups, around)
