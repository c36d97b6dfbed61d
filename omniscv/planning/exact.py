"""What strategies share that capture every pixel from its own optical centre: faces or strips there."""

from abc import abstractmethod
from collections.abc import Callable

import numpy as np

from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.planning.base import FoundDepth, Round, Rounds, Strategy, Task, Viewpoint
from omniscv.planning.cube_faces import ALL_FACES, FACE_BORDER_PX, CubeFaces, faces_hit
from omniscv.planning.depth_marching import march
from omniscv.planning.depth_shell import DepthShell
from omniscv.planning.strip_views import straight, strip_size, strip_views
from omniscv.planning.viewpoints import Groups, RayGroup
from omniscv.planning.visibility import look_around, occluded
from omniscv.sources.base import View

_SHARED_M = 0.05
"""What rays meet that start nearer to their viewpoint, its own captures bound well enough."""
_MEAN_OF_A_FACE = float(np.sqrt(6 / np.pi))
"""Pixels per radian of a 90 degree face on the mean, against its middle: edge^2 pixels see 4 pi / 6 sr."""
_STRIP_BORDER_PX = 2
"""The filter support beyond a ray's pixel, at least: a strip's rays run through its middle."""


def face_viewpoints(
    task: Task, groups: Groups, around: DepthShell | None, *, whole: bool = False
) -> tuple[Viewpoint, ...]:
    """Return the viewpoints of groups of pixels: the faces that their rays hit, or whole cube maps."""
    faces = CubeFaces(task, task.edge, task.border(FACE_BORDER_PX))

    def views(center_w: Array, group: RayGroup) -> tuple[View, ...]:
        if whole:
            return faces.views(center_w, ALL_FACES)
        hit = [faces_hit(directions, task.pose.R_w_c) for directions in group.parts()]
        return faces.views(center_w, np.any(hit, axis=0))

    return _serving(task, groups, around, views)


def strip_viewpoints(task: Task, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
    """Return the viewpoints of groups of pixels, whose views hold just their rays; faces where none do.

    Rays on a great circle, as of a panorama's column, run through the middle of a row of pixels. Others are
    sampled as finely as faces sample on average. Recordings may hold those as coarse as faces in the middle.
    """
    if not groups:
        return ()
    rays_w = {id(group): group.directions @ task.pose.R_w_c.T for group in groups}
    middle_px = task.edge / 2
    sampled = (1.0,) if straight([*rays_w.values()], middle_px) else (_MEAN_OF_A_FACE, 1.0)
    found = [_strips(task, groups, around, rays_w, finer * middle_px) for finer in sampled[:1]]
    if task.recorded is not None:
        found += [_strips(task, groups, around, rays_w, finer * middle_px) for finer in sampled[1:]]
    held = (each for each in found if task.available([view for group in each for view in group.views]))
    return next(held, found[0])


def _strips(
    task: Task, groups: Groups, around: DepthShell | None, rays_w: dict[int, Array], focal_px: float
) -> tuple[Viewpoint, ...]:
    spanned = focal_px * task.rays.typical_step  # by a pixel, which ``area`` averages
    border_px = task.border(max(_STRIP_BORDER_PX, 1 + int(np.ceil(spanned / 2))))
    size = strip_size([*rays_w.values()], focal_px, border_px, task.capabilities)
    faces = CubeFaces(task, task.edge, border_px)

    def views(center_w: Array, group: RayGroup) -> tuple[View, ...]:
        strips = strip_views(center_w, rays_w[id(group)], focal_px, border_px, size)
        return strips or faces.views(center_w, faces_hit(group.directions, task.pose.R_w_c))

    return _serving(task, groups, around, views)


def cheapest_viewpoints(task: Task, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
    """Return the viewpoints of groups of pixels with the fewest pixels captured that the source can do.

    Strips where it can set size and field of view, and, if it is a recording, holds them; else faces.
    """
    if task.sets_views:
        strips = strip_viewpoints(task, groups, around)
        if task.available([view for each in strips for view in each.views]):
            return strips
    return face_viewpoints(task, groups, around)


def _serving(
    task: Task,
    groups: Groups,
    around: DepthShell | None,
    views: Callable[[Array, RayGroup], tuple[View, ...]],
) -> tuple[Viewpoint, ...]:
    found = []
    for group in groups:
        center_w = task.pose.to_world(group.center_c)
        hidden, check = occluded(around, center_w, group), _check(task, group, around)
        found.append(Viewpoint(center_w, views(center_w, group), group.pixels, check=check, occluded=hidden))
    return tuple(found)


def _check(task: Task, group: RayGroup, around: DepthShell | None) -> FoundDepth | None:
    """What the camera's position shows of rays that share a centre far from their own origins."""
    origins = task.rays.origins
    if around is None or origins is None:
        return None
    own_c = origins.reshape(-1, 3)[group.pixels]
    if np.abs(own_c - group.center_c).max() <= _SHARED_M:
        return None
    return march(around, task.pose.to_world(own_c), group.directions @ task.pose.R_w_c.T).found()


class Exact(Strategy):
    """One round of viewpoints, after that in which occluded centres are found."""

    @abstractmethod
    def viewpoints(self, task: Task, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
        """Return the viewpoints of groups of pixels."""

    def rounds(self, task: Task) -> Rounds:
        if task.scattered:
            wanted = (
                "expected 'auto', 'adaptive' or a number of viewpoints for a camera whose every pixel has"
            )
            raise ArgumentError(f"strategy: {wanted} an optical centre of its own, got {self.name!r}")
        groups = task.groups()
        around = yield from look_around(task, groups)
        yield Round(self.viewpoints(task, groups, around))
