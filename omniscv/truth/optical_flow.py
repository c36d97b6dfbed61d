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
from omniscv.parallel import side_by_side

Mask = NDArray[np.bool_]
Wrap = Literal["shortest", "classic"]
"""Of an image whose sides meet: ``shortest``, the way across the seam where it is shorter, horizontal flow in
[-W/2, W/2); ``classic``, the difference of the columns."""

INVALID, VALID, AT_INFINITY, OCCLUDED = range(4)
"""What a pixel of :attr:`Flow.mask` may be: its flow is not known; known; that of the sky, which only turns;
known, but the second image shows something nearer there."""

_ENDLESS_M = 1e12
"""Metres to points at infinity: optical centres a metre apart see them less than 1e-11 rad apart."""

_PART_PX = 1 << 14
"""Pixels that are worked on together, in the processor's cache."""


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
    if labels is not None:
        seen &= (labels > 0) | np.isposinf(depth0)
    height, width = depth0.shape
    found = Flow(
        np.full((height, width, 2), np.nan), np.zeros((height, width), np.uint8),
        np.full((height, width, 3), np.nan),
    )  # fmt: skip
    nearer = None if depth1 is None else _Nearer(camera1, depth1, settings)
    moving = _Moving(pose0, pose1, motions)

    def part(rows: slice) -> None:
        mine = seen[rows]
        names = None if labels is None else labels[rows][mine]
        depth = depth0[rows][mine].astype(np.float64)
        points_c1, scene = moving(depth, rays0.directions[rows][mine], rays0.origins[rows][mine], names)
        target, known = camera1.project(points_c1)
        mask = np.where(known, np.where(np.isposinf(depth), AT_INFINITY, VALID), INVALID)
        if nearer is not None:
            mask[known] = np.where(nearer(target[known], points_c1[known]), OCCLUDED, mask[known])
        row, column = np.nonzero(mine)
        target -= np.column_stack([column, row + rows.start]) + 0.5
        if settings["wrap"] == "shortest" and camera1.wraps:
            half = camera1.width / 2
            target[:, 0] = (target[:, 0] + half) % camera1.width - half
        found.pixels[rows][mine], found.mask[rows][mine], found.scene[rows][mine] = target, mask, scene

    step = max(1, _PART_PX // width)
    side_by_side(part, [slice(row, row + step) for row in range(0, height, step)])
    return found


def motion(before: Pose, after: Pose) -> Pose:
    """Return how an object moved, from its pose before and after: ``p_w1 = motion.to_world(p_w0)``."""
    return after @ before.inverse()


def _settings(options: FlowOptions) -> FlowOptions:
    found: FlowOptions = {"wrap": "shortest", "tolerance_m": 0.02, "tolerance_rel": 0.01}
    for name in options:
        one_of("options", name, found)
    found |= options
    one_of("wrap", found["wrap"], get_args(Wrap))
    number("tolerance_m", found["tolerance_m"], least=0)
    number("tolerance_rel", found["tolerance_rel"], least=0)
    return found


class _Moving:
    """From points of the first camera to the second one's, while objects move.

    Args:
        pose0, pose1: of the cameras.
        motions: by label.
    """

    def __init__(self, pose0: Pose, pose1: Pose, motions: Mapping[int, Pose | None]) -> None:
        self._pose0, self._pose1, self._motions = pose0, pose1, motions
        self._T_c1_c0 = pose1.inverse() @ pose0

    def __call__(
        self, depth: Array, directions: Array, origins: Array, labels: NDArray[Any] | None
    ) -> tuple[Array, Array]:
        """Return points (N, 3) of the second camera's frame, and how they moved (N, 3) in the world, metres.

        Where that is not known, both are NaN; points at infinity do not move, and have NaN too.
        """
        endless = np.isposinf(depth)
        points_c0 = directions * np.where(endless, _ENDLESS_M, depth)[:, None]
        points_c0 += origins
        points_c1 = points_c0 @ self._T_c1_c0.rotation.T
        points_c1 += self._T_c1_c0.position
        scene = np.zeros_like(points_c0)
        if endless.any():
            points_c1[endless] = _ENDLESS_M * (directions[endless] @ self._T_c1_c0.rotation.T)
            scene[endless] = np.nan
        for label, motion in self._motions.items():
            mine = labels == label
            if motion is None:
                points_c1[mine] = scene[mine] = np.nan
            else:
                points_w = self._pose0.to_world(points_c0[mine])
                moved_w = motion.to_world(points_w)
                points_c1[mine], scene[mine] = self._pose1.to_camera(moved_w), moved_w - points_w
        return points_c1, scene


class _Nearer:
    """Which points the second image has something nearer for.

    Args:
        camera1: of the image.
        depth1: (H1, W1) metres.
        settings: the tolerances.

    Raises:
        ArgumentError: a depth of another size than the camera's.
    """

    def __init__(self, camera1: Camera, depth1: NDArray[Any], settings: FlowOptions) -> None:
        if depth1.shape != (camera1.height, camera1.width):
            wanted = f"expected the size of the camera, {camera1.height, camera1.width}"
            raise ArgumentError(f"depth1: {wanted}, got {depth1.shape}")
        self._camera, self._settings = camera1, settings
        self._closeness = 1 / np.where(depth1 > 0, depth1, np.inf).astype(np.float64)

    def __call__(self, pixels: Array, points_c1: Array) -> Mask:
        """(N,) bool of points (N, 3), camera frame, and the pixels (N, 2) that see them."""
        origins = 0.0 if self._camera.central else self._camera.unproject(pixels).origins
        distance = np.linalg.norm(points_c1 - origins, axis=-1)
        tolerance = np.maximum(self._settings["tolerance_m"], self._settings["tolerance_rel"] * distance)
        return np.asarray(distance - self._depth_at(pixels) > tolerance)

    def _depth_at(self, pixels: Array) -> Array:
        """(N,) the farthest that depth may be at pixels: of the nearest pixel, or between the four around.

        Between pixels 1 / depth is linear on a plane, so that a slanted floor does not hide itself; at the
        border of a nearer object the mixture means nothing, and the nearest pixel decides. Pixels outside the
        field of view hide nothing.
        """
        column, row = np.floor(pixels).astype(np.int64).T
        left, top = np.floor(pixels - 0.5).astype(np.int64).T
        across, down = (pixels - 0.5).T - (left, top)
        upper = self._at(left, top) * (1 - across) + self._at(left + 1, top) * across
        lower = self._at(left, top + 1) * (1 - across) + self._at(left + 1, top + 1) * across
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.minimum(self._at(column, row), upper * (1 - down) + lower * down))

    def _at(self, column: NDArray[Any], row: NDArray[Any]) -> Array:
        height, width = self._closeness.shape
        column = column % width if self._camera.wraps else column.clip(0, width - 1)
        return np.asarray(self._closeness[row.clip(0, height - 1), column])
