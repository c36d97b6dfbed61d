"""The plan of a strategy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from omniscv.cameras import Camera
from omniscv.captures.source import Capabilities
from omniscv.captures.view import View
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.plan import sampling
from omniscv.plan.base import Plan, Station
from omniscv.plan.cube import cube_views, faces_hit
from omniscv.plan.recorded import RecordedFaces

STRATEGIES = ("auto", "cube", "faces")

BORDER_PX = 4
"""What the widest filter reaches beyond a ray's place, and one for good measure."""


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
            that rays hit; ``auto``: the cheapest that the source can do.
        viewpoints: optical centres of a non-central camera; one per column or ring if not given.
        face_size: edge of a 90 degree face in px; ``auto``: see :mod:`omniscv.plan.sampling`.
        border_px: how much wider faces are captured on every side; chosen if not given.
        recorded: the views that a recorded source holds: their face size and border are used.

    Raises:
        ArgumentError: an unknown strategy, or a face size or border out of range.
    """
    if strategy not in STRATEGIES:
        raise ArgumentError(f"strategy: expected one of {', '.join(STRATEGIES)}; got {strategy!r}")
    edge = sampling.face_size(camera) if face_size == "auto" else face_size
    if not isinstance(edge, int) or not 1 <= edge <= sampling.LARGEST:
        raise ArgumentError(f"face_size: expected 'auto' or 1 to {sampling.LARGEST} px, got {face_size!r}")
    wide = capabilities.can_set_fov and capabilities.can_set_size
    border = (BORDER_PX if wide else 0) if border_px is None else border_px
    held = RecordedFaces(recorded) if recorded is not None else None

    def views(center_w: Array) -> tuple[View, ...]:
        if held is not None:
            return held.views(center_w, edge, border)
        return cube_views(center_w, edge, border)

    return Plan(camera, pose, strategy, _stations(camera, pose, viewpoints, strategy, views), border)


def _stations(
    camera: Camera,
    pose: Pose,
    viewpoints: int | None,
    strategy: str,
    views: Callable[[Array], tuple[View, ...]],
) -> tuple[Station, ...]:
    grouped = camera.viewpoints(viewpoints)
    order = np.argsort(grouped.index, axis=None, kind="stable")
    index = grouped.index.ravel()[order]
    starts = np.searchsorted(index, np.arange(len(grouped.centers) + 1))
    directions = camera.unproject().directions.reshape(-1, 3)
    stations = []
    for k, center_c in enumerate(grouped.centers):
        pixels = np.sort(order[starts[k] : starts[k + 1]])
        if pixels.size == 0:
            continue
        center_w = pose.to_world(center_c)
        chosen = views(center_w)
        if strategy != "cube":
            hit = faces_hit(directions[pixels] @ pose.R_w_c.T)
            chosen = tuple(view for view, wanted in zip(chosen, hit, strict=True) if wanted)
        stations.append(Station(center_w, chosen, pixels))
    return tuple(stations)
