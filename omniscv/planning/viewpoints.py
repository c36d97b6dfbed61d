"""Viewpoints at the optical centres of pixels: a single view, faces, strips, whole cubes.

A non-central camera's centres lie up to metres from its position: in a small room some are beyond a wall or
inside a cupboard. Engines render from there, too. So small depth pictures are captured at the camera's
position first, and the pixels of centres behind their surfaces are flagged.
"""

from collections import defaultdict
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from omniscv import modalities
from omniscv.depth.depth_shell import DepthShell, depth_shell, distances
from omniscv.depth.hits import Hits
from omniscv.depth.ray_marching import march
from omniscv.errors import MissingCaptureError
from omniscv.geometry import Array, Pose
from omniscv.geometry.arrays import Ints, Mask
from omniscv.planning.plan import Plan
from omniscv.planning.rays import Groups, RayGroup
from omniscv.planning.rounds import Captures, Round, Viewpoint
from omniscv.planning.views import (
    ALL_FACES,
    FACE_BORDER_PX,
    LEAST_HALF,
    STEEPEST,
    CubeFaces,
    faces_hit,
    holding_view,
    straight,
    strip_size,
    strip_views,
)
from omniscv.render_options import LARGEST_FACE_PX
from omniscv.sources.base import View
from omniscv.sources.recorded_views import RecordedViews, finest

SAME_M = 1e-9
"""Optical centres nearer to each other than this are one."""
_SHARED = 0.05
"""Distance from a viewpoint, relative to the nearest surface's, within which its own captures bound the depth
of rays well enough."""
MEAN_OF_A_FACE = float(np.sqrt(6 / np.pi))
"""Pixels per radian of a 90 degree face on the mean, against its middle: edge^2 pixels see 4 pi / 6 sr."""
_STRIP_BORDER_PX = 2
"""The filter support beyond a ray's pixel, at least: a strip's rays run through its middle."""
_NARROWEST = 1e-12  # tangent: a view of a single ray
_TO_A_CENTER_PX = 0.5 - 1e-4
"""From the edge of a view to the outermost centres of its pixels: beyond them nothing is interpolated."""
_OCCLUDED_PX = 64
"""px of a face that shows where optical centres are occluded."""
_SEARCHED_PX = _OCCLUDED_PX + 1
"""The same of a search from centres that the options give: odd, as faces of other captures hardly are."""


def edges_around(plan: Plan, *, searched: bool = False) -> tuple[int, ...]:
    """Return the sizes, px, of faces of depth at the camera's position: the one to capture first.

    A recording may have one of the others. They are small where each pixel is captured from its own optical
    centre. Where pixels share the centres that the options give, they also show what rays meet, and are as
    fine as the image needs. A search from these centres captures a size of its own, by which a recording
    tells that it was made by one.

    Args:
        plan: the image.
        searched: whether what rays meet is searched from the centres.
    """
    if plan.options.viewpoints is None:
        return (_OCCLUDED_PX,)
    fine = max(plan.edge, _OCCLUDED_PX)
    if not searched:
        return fine, _OCCLUDED_PX
    if plan.recorded is None or holds_search(plan):
        return (_searched_px(plan),)
    return _OCCLUDED_PX, fine


def holds_search(plan: Plan) -> bool:
    """Return whether a plan's recording holds what a search from given centres captures at the camera's
    position."""
    views = _views_around(replace(plan, recorded=None), _searched_px(plan))
    return plan.recorded is not None and plan.recorded.hold(views)


def _searched_px(plan: Plan) -> int:
    """Return the size of faces at the camera's position that a search captures, and nothing else does."""
    return _SEARCHED_PX if plan.edge != _SEARCHED_PX else _SEARCHED_PX + 2


def _views_around(plan: Plan, edge: int) -> tuple[View, ...]:
    """Return the six faces of ``edge`` px at the camera's position; of a recording the most like them."""
    return CubeFaces(plan, edge, 0).views(plan.pose.t_w_c, ALL_FACES)


def capture_around(
    plan: Plan, groups: Groups, edges: Sequence[int]
) -> Generator[Round, Captures | None, DepthShell | None]:
    """Yield a round of depth pictures at the camera's position, and return the captured depth.

    None where every ray starts at one centre, where a recording has no such pictures, and where nothing is
    captured.

    Args:
        plan: the image.
        groups: its pixels by optical centre.
        edges: the sizes of faces, px, the one to prefer first.
    """
    if len(groups) < 2 and (plan.rays.origins is None or len(plan.rays.own_viewpoints.centers) < 2):
        return None
    sizes = [_views_around(plan, edge) for edge in edges]
    views = next(filter(plan.available, sizes), None)
    if views is None:
        return None
    center_w = plan.pose.t_w_c
    kept = yield Round((Viewpoint(center_w, views, np.zeros(0, np.int64), modes=("depth",), keep=True),))
    return None if kept is None else depth_shell(center_w, kept[0]["depth"])


def occlusion(around: DepthShell, points_w: Array) -> tuple[Mask, Mask]:
    """Return which points are visible from where depth was captured, and which are occluded, (N,) each.

    Points near an edge may be neither.

    Args:
        around: the captured depth.
        points_w: (N, 3) world frame, metres.
    """
    toward = points_w - around.center_w
    away = np.linalg.norm(toward, axis=-1)
    least, most = distances(around, toward)
    return (away == 0) | (away < least), (away > 0) & (away > most)


def face_viewpoints(
    plan: Plan, groups: Groups, around: DepthShell | None, *, whole: bool = False
) -> tuple[Viewpoint, ...]:
    """Return the viewpoints of groups of pixels: the faces that their rays hit, or whole cube maps.

    Args:
        plan: the image.
        groups: its pixels, or some of them, by optical centre.
        around: depth captured at the camera's position; None: centres are not checked for occlusion.
        whole: take all six faces.
    """
    faces = CubeFaces(plan, plan.edge, plan.border(FACE_BORDER_PX))

    def views(center_w: Array, group: RayGroup) -> tuple[View, ...]:
        if whole:
            return faces.views(center_w, ALL_FACES)
        hit = [faces_hit(directions, plan.pose.R_w_c) for directions in group.blocks()]
        return faces.views(center_w, np.any(hit, axis=0))

    planned = _viewpoints(plan, groups, around, views)
    if whole or plan.recorded is None or plan.rays.origins is not None or _is_available(plan, planned):
        return planned
    return tuple(_recorded_viewpoints(plan, plan.recorded, groups[0])) or planned


def _recorded_viewpoints(plan: Plan, recorded: RecordedViews, group: RayGroup) -> Iterator[Viewpoint]:
    """Yield a viewpoint for each view at a central camera's position that a recording holds and that serves
    rays best; none if it holds none there in one of the modes.

    Raises:
        MissingCaptureError: no view sees some rays, and the options do not leave them blank.
    """
    center_w = plan.pose.to_world(group.center_c)
    modes_of: dict[tuple[View, ...], list[str]] = defaultdict(list)
    for mode in plan.modes or ("lit",):
        modes_of[recorded.at(center_w, modalities.get(mode).captured_as or mode)].append(mode)
    if not all(modes_of):
        return
    unseen, unsure = np.zeros((2, len(group.pixels)), np.bool_)
    serving: dict[tuple[View, ...], Ints] = {}
    for views in modes_of:
        serving[views], edge_px = _serving_views(plan, views, group)
        unseen |= serving[views] < 0
        unsure |= edge_px < _TO_A_CENTER_PX
    if unseen.all() or (unseen.any() and plan.options.unseen == "refuse"):
        at = np.round(center_w, 6).tolist()
        share = f"{100 * unseen.mean():.3g} %"
        advice = "render with unseen='blank' (unseen: blank in a job) for the image of what is seen"
        expected = f"expected recorded views at {at} m to see all rays, but {share} are seen by none"
        raise MissingCaptureError(expected, None, advice)
    for views, modes in modes_of.items():
        for k in np.unique(serving[views][~unseen]):
            mine = ~unseen & (serving[views] == k)
            only = tuple(modes) if len(modes_of) > 1 else None
            view = views[k]
            yield Viewpoint(view.pose.t_w_c, (view,), group.pixels[mine], only, unsure=unsure[mine])


def _serving_views(plan: Plan, views: tuple[View, ...], group: RayGroup) -> tuple[Ints, Array]:
    """Return the view that serves each ray of a group best, -1 for none, and px from there to its edge."""
    numbers = []
    edges_px = []
    for directions in group.blocks():
        valid = directions[~np.isnan(directions[:, 0])]
        number, edge_px = finest(views, valid @ plan.pose.R_w_c.T)
        numbers.append(number)
        edges_px.append(edge_px)
    return np.concatenate(numbers), np.concatenate(edges_px)


def strip_viewpoints(plan: Plan, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
    """Return the viewpoints of groups of pixels, whose views hold just their rays; faces where none do.

    Rays on a great circle, as of a panorama's column, run through the middle of a row of pixels. Others are
    sampled as finely as faces sample on average. Recordings may hold narrower views than engines take.
    The arguments ``plan``, ``groups`` and ``around`` are as of :func:`face_viewpoints`.
    """
    if not groups:
        return ()
    rays_w = {id(group): group.directions @ plan.pose.R_w_c.T for group in groups}
    focal_px = plan.edge / 2
    if not straight([*rays_w.values()], focal_px):
        focal_px *= MEAN_OF_A_FACE
    spanned_px = focal_px * plan.rays.typical_step  # by a pixel, which ``area`` averages
    border_px = plan.border(max(_STRIP_BORDER_PX, 1 + int(np.ceil(spanned_px / 2))))
    faces = CubeFaces(plan, plan.edge, border_px)

    def planned(least_half: float) -> tuple[Viewpoint, ...]:
        size = strip_size([*rays_w.values()], focal_px, border_px, plan.capabilities, least_half)

        def views(center_w: Array, group: RayGroup) -> tuple[View, ...]:
            strips = strip_views(center_w, rays_w[id(group)], focal_px, border_px, size)
            return strips or faces.views(center_w, faces_hit(group.directions, plan.pose.R_w_c))

        return _viewpoints(plan, groups, around, views)

    first = planned(LEAST_HALF)
    if _is_available(plan, first):
        return first
    narrower = planned(0.0)
    return narrower if _is_available(plan, narrower) else first


def _is_available(plan: Plan, viewpoints: tuple[Viewpoint, ...]) -> bool:
    views: list[View] = []
    for viewpoint in viewpoints:
        views += viewpoint.views
    return plan.available(views)


def cheapest_viewpoints(plan: Plan, groups: Groups, around: DepthShell | None) -> tuple[Viewpoint, ...]:
    """Return the viewpoints of groups of pixels with the fewest captured pixels: strips where the source can
    set size and field of view, and holds them if it is a recording; else faces."""
    if plan.sets_views:
        strips = strip_viewpoints(plan, groups, around)
        if _is_available(plan, strips):
            return strips
    return face_viewpoints(plan, groups, around)


def _viewpoints(
    plan: Plan,
    groups: Groups,
    around: DepthShell | None,
    views: Callable[[Array, RayGroup], tuple[View, ...]],
) -> tuple[Viewpoint, ...]:
    """Return a viewpoint for each group; ``views(center_w, group)`` are captured there."""
    viewpoints = []
    for group in groups:
        center_w = plan.pose.to_world(group.center_c)
        claims = _claims(plan, group, around)
        viewpoints.append(Viewpoint(center_w, views(center_w, group), group.pixels, **claims))
    return tuple(viewpoints)


def _claims(plan: Plan, group: RayGroup, around: DepthShell | None) -> dict[str, Any]:
    """Return the fields of Viewpoint that depth around the camera decides, for rays that share a centre."""
    if plan.rays.origins is None:
        return {}
    origins_w = plan.origins_w(group.pixels)
    center_w = plan.pose.to_world(group.center_c)
    shared_m = float(np.abs(origins_w - center_w).max())
    nearest_m = 1.0
    if around is not None:
        nearest_m = around.least - float(np.linalg.norm(center_w - around.center_w))
    claims: dict[str, Any] = {}
    if shared_m > max(_SHARED * nearest_m, SAME_M):
        claims["check"] = Hits.unknown(len(origins_w))
        if around is not None:
            claims["check"] = march(around, origins_w, plan.directions_w(group.pixels))
    if around is not None:
        visible, claims["occluded"] = occlusion(around, origins_w)
        if shared_m > SAME_M and "check" not in claims:
            claims["unsure"] = ~(visible & occlusion(around, center_w[None])[0])
    return claims


def single_viewpoint(plan: Plan, group: RayGroup) -> Viewpoint | None:
    """Return the viewpoint of all pixels with one view, turned and narrowed to their rays; None where no view
    holds them, the source cannot set size and field of view, or is a recording without the view."""
    R_c_v, half, focal_px = plan.rays.holding_view
    if not plan.sets_views or half.max() > STEEPEST:
        return None
    if plan.options.face_size != "auto":
        focal_px = plan.edge / 2
    focal_px = min(focal_px, LARGEST_FACE_PX / 2 / max(half.max(), _NARROWEST))
    pose = Pose(plan.pose.to_world(group.center_c), plan.pose.R_w_c @ R_c_v)
    view = holding_view(plan, pose, half, focal_px)
    return Viewpoint(pose.t_w_c, (view,), group.pixels) if view else None
