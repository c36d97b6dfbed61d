"""The plan of a strategy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.captures.source import Capabilities
from omniscv.captures.view import View
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.plan import sampling
from omniscv.plan.base import Plan, Station
from omniscv.plan.cube import Face, chosen, faces_hit
from omniscv.plan.groups import Group, pixel_groups
from omniscv.plan.recorded import RecordedFaces
from omniscv.plan.strips import strip_size, strip_views

STRATEGIES = ("auto", "cube", "faces", "strips", "reproject", "adaptive")
FEW = ("reproject", "adaptive")
"""Strategies that capture from fewer optical centres than the image has."""

FEW_CENTERS = 8
"""How many those begin with."""

FACE_BORDER_PX = 4
"""What the widest filter reaches beyond a ray's place, and two for good measure."""

PROBE_EDGE = 64
"""Pixels of a face that only tells walls from open space."""

STRIP_BORDER_PX = 2
"""What the widest filter reaches beyond a ray's place: a strip's rays run through its middle."""


def make_plan(
    camera: Camera,
    pose: Pose,
    capabilities: Capabilities,
    *,
    strategy: str = "auto",
    viewpoints: int | None = None,
    face_size: int | str = "auto",
    border_px: int | None = None,
    recorded: Sequence[View] | None = None,
) -> Plan:
    """The views that an image needs.

    Args:
        camera, pose: what is rendered.
        capabilities: what the source can do.
        strategy: ``cube``: six faces at every optical centre, as in the paper; ``faces``: only those
            that rays hit; ``strips``: views turned and narrowed to the rays of each centre; ``reproject``:
            faces at a few centres, through whose depth rays are followed; ``adaptive``: the same, with more
            centres where rays are lost (both: :mod:`omniscv.compose.reproject`); ``auto``: the
            cheapest that the source can do, ``strips`` where there are several centres, ``faces`` at one.
        viewpoints: optical centres of a non-central camera; one per column or ring if not given, and
            ``FEW_CENTERS`` to begin with for ``reproject`` and ``adaptive``.
        face_size: edge of a 90 degree face in px; ``auto``: see :mod:`omniscv.plan.sampling`.
        border_px: how much wider views are captured on every side; chosen if not given.
        recorded: the views that a recorded source holds; faces of other sizes than the wanted ones are
            taken from it.

    Raises:
        ArgumentError: an unknown strategy, one that the source cannot do, or a size out of range.
    """
    if strategy not in STRATEGIES:
        raise ArgumentError(f"strategy: expected one of {', '.join(STRATEGIES)}; got {strategy!r}")
    edge = sampling.face_size(camera) if face_size == "auto" else face_size
    if not isinstance(edge, int) or not 1 <= edge <= sampling.LARGEST:
        raise ArgumentError(f"face_size: expected 'auto' or 1 to {sampling.LARGEST} px, got {face_size!r}")
    if border_px is not None and border_px < 0:
        raise ArgumentError(f"border_px: expected a whole number of pixels >= 0, got {border_px!r}")
    free = capabilities.can_set_size and capabilities.can_set_fov
    if strategy == "strips" and not free:
        raise ArgumentError("strategy: strips need a source that can set size and field of view; use 'faces'")
    few = strategy in FEW and not camera.central
    groups = pixel_groups(camera, FEW_CENTERS if few and viewpoints is None else viewpoints)
    probe = _probe(pose, capabilities, recorded) if len(groups) > 1 else None
    if strategy == "strips" or (strategy == "auto" and free and len(groups) > 1):
        border = STRIP_BORDER_PX if border_px is None else border_px
        stations = _strips(groups, pose, edge, border, capabilities.min_size)
        plan = Plan(camera, pose, "strips", stations, border, probe)
        if strategy == "strips" or recorded is None or set(plan.views()) <= set(recorded):
            return plan
    face = Face.on(capabilities, edge, FACE_BORDER_PX if border_px is None else border_px)
    if few and len(groups) > 1:
        return _few(camera, pose, groups, _views(face, recorded), strategy, face.border_px, probe)
    stations = _faces(groups, pose, _views(face, recorded), every=strategy == "cube")
    return Plan(camera, pose, "cube" if strategy == "cube" else "faces", stations, face.border_px, probe)


def _probe(pose: Pose, capabilities: Capabilities, recorded: Sequence[View] | None) -> Station | None:
    """Six small views at the camera's own position; None where a record lacks them."""
    views = _views(Face.on(capabilities, PROBE_EDGE, 0), recorded)(pose.t_w_c)
    if recorded is not None and not set(views) <= set(recorded):
        return None
    return Station(pose.t_w_c, views, np.zeros(0, np.int64))


def _few(
    camera: Camera,
    pose: Pose,
    groups: Sequence[Group],
    views: Callable[[Array], tuple[View, ...]],
    strategy: str,
    border_px: int,
    probe: Station | None,
) -> Plan:
    """At each centre all faces that any of the camera's rays hits: a ray may be looked up at any centre."""
    hit = np.any([faces_hit(group.directions, pose.R_w_c) for group in groups], axis=0)

    def station(center_w: Array, pixels: NDArray[np.int64]) -> Station:
        return Station(center_w, chosen(views(center_w), hit), pixels)

    stations = tuple(station(pose.to_world(group.center_c), group.pixels) for group in groups)
    none = np.zeros(0, np.int64)
    more = (lambda center_w: station(center_w, none)) if strategy == "adaptive" else None
    return Plan(camera, pose, strategy, stations, border_px, probe, more)


def _views(face: Face, recorded: Sequence[View] | None) -> Callable[[Array], tuple[View, ...]]:
    if recorded is None:
        return face.views
    held = RecordedFaces(recorded)
    return lambda center_w: held.views(center_w, face)


def _faces(
    groups: Sequence[Group], pose: Pose, views: Callable[[Array], tuple[View, ...]], every: bool
) -> tuple[Station, ...]:
    stations = []
    for group in groups:
        center_w = pose.to_world(group.center_c)
        taken = views(center_w)
        if not every:
            taken = chosen(taken, faces_hit(group.directions, pose.R_w_c))
        stations.append(Station(center_w, taken, group.pixels))
    return tuple(stations)


def _strips(
    groups: Sequence[Group], pose: Pose, edge: int, border_px: int, min_size: int
) -> tuple[Station, ...]:
    """Strips at every centre; where rays fit none, as those of a whole sphere do, faces."""
    if not groups:
        return ()
    focal_px = edge / 2
    rays_w = [group.directions @ pose.R_w_c.T for group in groups]
    size = strip_size(rays_w, focal_px, border_px, min_size)
    face = Face.of(edge, border_px)
    stations = []
    for group, rays in zip(groups, rays_w, strict=True):
        center_w = pose.to_world(group.center_c)
        views = strip_views(center_w, rays, focal_px, border_px, size)
        if views is None:
            views = chosen(face.views(center_w), faces_hit(group.directions, pose.R_w_c))
        stations.append(Station(center_w, views, group.pixels))
    return tuple(stations)
