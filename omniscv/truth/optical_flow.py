"""Optical flow and scene flow between two images, exact: from depth, rays and poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, TypedDict, Unpack, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number, one_of
from omniscv.cameras import Camera, Rays
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose

Mask = NDArray[np.bool_]
Wrap = Literal["shortest", "classic"]
"""Of an image whose sides meet: ``shortest``, the way across the seam where it is shorter, horizontal flow in
[-W/2, W/2); ``classic``, the difference of the columns."""

INVALID, VALID, AT_INFINITY, OCCLUDED = range(4)
"""What a pixel of :attr:`Flow.mask` may be: its flow is not known; known; that of the sky, which only turns;
known, but the second image shows something nearer there."""

_ENDLESS_M = 1e12
"""Metres to points at infinity: optical centres a metre apart see them less than 1e-11 rad apart."""


class FlowOptions(TypedDict, total=False):
    """How flow is derived.

    Attributes:
        wrap: default ``shortest``.
        tolerance_m, tolerance_rel: how much nearer, in metres or as a share of the distance, whichever is
            more, the second depth must be for a point to be occluded; 0.02 and 0.01.
    """

    wrap: Wrap
    tolerance_m: float
    tolerance_rel: float


@dataclass(frozen=True, eq=False)
class Flow:
    """Where the pixels of one image go in another one.

    Attributes:
        pixels: (H, W, 2) float64 px, from a pixel's centre to where its point is seen; NaN where not known.
        mask: (H, W) uint8, ``INVALID``, ``VALID``, ``AT_INFINITY`` or ``OCCLUDED``.
        scene: (H, W, 3) float64 metres that the points move, world frame; exactly 0 where nothing moves, NaN
            where there is no point.
    """

    pixels: Array
    mask: NDArray[np.uint8]
    scene: Array


def flow(
    depth0: NDArray[np.floating[Any]],
    rays0: Rays,
    pose0: Pose,
    camera1: Camera,
    pose1: Pose,
    depth1: NDArray[np.floating[Any]] | None = None,
    labels: NDArray[np.integer[Any]] | None = None,
    motions: Mapping[int, Pose | None] = MappingProxyType({}),
    **options: Unpack[FlowOptions],
) -> Flow:
    """Return the flow from an image to another one, of any two cameras.

    A pixel's point is ``X = o + D d`` in the world, moves to ``X'`` with its object, and is seen at
    ``project(X')`` of the second camera. Points at infinity only turn with the cameras.

    Args:
        depth0: (H, W) metres along the rays of the first image; +inf is infinity; 0 has no flow.
        rays0: (H, W), of its pixels' centres, camera frame.
        pose0, pose1: of the cameras.
        camera1: of the second image.
        depth1: (H1, W1) of the second image; without it nothing is known to be occluded.
        labels: (H, W) of the first image; surfaces of label 0 have no flow.
        motions: by label, the motion of a rigid object between the images, ``p_w1 = motion.to_world(p_w0)``;
            None where it is not known. Objects that are not named stay where they are.
        options: see :class:`FlowOptions`.

    Raises:
        ArgumentError: arrays of different sizes, motions without labels, or an unknown option.
    """
    settings = _settings(options)
    if motions and labels is None:
        raise ArgumentError("motions: expected labels with them, got none")
    for name, each in (("rays0", rays0.valid), ("labels", labels)):
        if each is not None and each.shape != depth0.shape:
            raise ArgumentError(f"{name}: expected the size of depth0, {depth0.shape}, got {each.shape}")
    seen = rays0.valid & (depth0 > 0)
    sky = np.isposinf(depth0)
    if labels is not None:
        seen &= sky | (labels > 0)
    X_w = np.full((*depth0.shape, 3), np.nan)
    surface = seen & ~sky
    X_w[surface] = pose0.to_world(
        rays0.origins[surface] + depth0[surface, None].astype(np.float64) * rays0.directions[surface]
    )
    scene = _moves(X_w, labels, motions)
    seen &= sky | np.isfinite(scene[..., 0])
    X_c1 = pose1.to_camera(X_w + scene)
    endless = seen & sky
    X_c1[endless] = (rays0.directions[endless] @ pose0.R_w_c.T) @ pose1.R_w_c * _ENDLESS_M
    target, mask = np.full((*depth0.shape, 2), np.nan), np.zeros(depth0.shape, np.uint8)
    target[seen], projected = camera1.project(X_c1[seen])
    seen[seen] = projected
    mask[seen] = np.where(sky[seen], AT_INFINITY, VALID)
    if depth1 is not None:
        hidden = _hidden(target[seen], X_c1[seen], sky[seen], camera1, depth1, settings)
        mask[seen] = np.where(hidden, OCCLUDED, mask[seen])
    return Flow(_differences(target, camera1, settings["wrap"]), mask, scene)


def motion(before: Pose, after: Pose) -> Pose:
    """Return how an object moved, from its pose before and after: ``p_w1 = motion.to_world(p_w0)``."""
    R = after.rotation @ before.rotation.T
    return Pose(after.position - R @ before.position, R)


def _settings(options: FlowOptions) -> FlowOptions:
    found: FlowOptions = {"wrap": "shortest", "tolerance_m": 0.02, "tolerance_rel": 0.01}
    for name in options:
        one_of("options", name, found)
    found |= options
    one_of("wrap", found["wrap"], get_args(Wrap))
    number("tolerance_m", found["tolerance_m"], least=0)
    number("tolerance_rel", found["tolerance_rel"], least=0)
    return found


def _moves(X_w: Array, labels: NDArray[Any] | None, motions: Mapping[int, Pose | None]) -> Array:
    """(H, W, 3) metres that points move; NaN where there is no point, or it is not known."""
    scene = np.where(np.isnan(X_w), np.nan, 0.0)
    for label, moved in motions.items():
        mine = labels == label
        scene[mine] = np.nan if moved is None else moved.to_world(X_w[mine]) - X_w[mine]
    return scene


def _differences(target: Array, camera1: Camera, wrap: Wrap) -> Array:
    """From the pixels' centres to where they go."""
    height, width = target.shape[:2]
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    moved: Array = target - np.stack([u, v], axis=-1)
    if wrap == "shortest" and camera1.wraps:
        half = camera1.width / 2
        moved[..., 0] = (moved[..., 0] + half) % camera1.width - half
    return moved


def _hidden(
    pixels: Array, X_c1: Array, sky: Mask, camera1: Camera, depth1: NDArray[Any], settings: FlowOptions
) -> Mask:
    """(N,) which points (N, 3), seen at pixels (N, 2), the second depth has something nearer for."""
    if depth1.shape != (camera1.height, camera1.width):
        raise ArgumentError(
            f"depth1: expected the size of the camera, {camera1.height, camera1.width}, got {depth1.shape}"
        )
    origins = 0.0 if camera1.central else camera1.unproject(pixels).origins
    distance = np.where(sky, np.inf, np.linalg.norm(X_c1 - origins, axis=-1))
    tolerance = np.maximum(settings["tolerance_m"], settings["tolerance_rel"] * distance)
    nearer = _depth_at(pixels, depth1, camera1.wraps)
    with np.errstate(invalid="ignore"):
        return np.where(sky, np.isfinite(nearer), distance - nearer > tolerance)


def _depth_at(pixels: Array, depth: NDArray[Any], wraps: bool) -> Array:
    """(N,) the farthest that depth may be at pixels (N, 2): of the nearest pixel, or between the four around.

    Between pixels 1 / depth is linear on a plane, so that a slanted floor does not hide itself; at the border
    of a nearer object the mixture means nothing, and the nearest pixel decides. Pixels outside the field of
    view hide nothing.
    """
    height, width = depth.shape
    closeness = 1 / np.where(depth > 0, depth, np.inf).astype(np.float64)

    def at(column: NDArray[Any], row: NDArray[Any]) -> Array:
        column = column % width if wraps else column.clip(0, width - 1)
        return np.asarray(closeness[row.clip(0, height - 1), column])

    column, row = (np.floor(each).astype(np.int64) for each in pixels.T)
    left, top = (np.floor(each - 0.5).astype(np.int64) for each in pixels.T)
    across, down = pixels[:, 0] - 0.5 - left, pixels[:, 1] - 0.5 - top
    upper = at(left, top) * (1 - across) + at(left + 1, top) * across
    lower = at(left, top + 1) * (1 - across) + at(left + 1, top + 1) * across
    with np.errstate(divide="ignore"):
        return np.asarray(1 / np.minimum(at(column, row), upper * (1 - down) + lower * down))
