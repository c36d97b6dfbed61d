"""The truth ``flow``: optical flow and scene flow between two images, from depth, rays and poses."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import flag, number, one_of, whole_number
from omniscv.cameras import Camera, Rays
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.parallel import row_blocks
from omniscv.records import checked, nested, record, word
from omniscv.render_options import Tolerance
from omniscv.truth.registry import Truth, register

Mask = NDArray[np.bool_]
Wrap = Literal["shortest", "classic"]
"""Horizontal flow in a panorama: ``shortest``, across the seam where that is shorter, in [-W/2, W/2);
``classic``, the difference of the columns."""

INVALID, VALID, AT_INFINITY, OCCLUDED = range(4)
"""Values of :attr:`Flow.mask`: flow unknown; known; of a point at infinity, which only turns; known, but the
second image shows something nearer there."""

_INFINITY_M = 1e12
"""Metres to points at infinity: seen from optical centres a metre apart, they turn by less than 1e-11 rad."""


@dataclass(frozen=True, eq=False)
class Flow:
    """The flow from one image to another.

    Attributes:
        pixels: (H, W, 2) float64 px, from a pixel's centre to its point in the other image; NaN if unknown.
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
    *,
    wrap: Wrap = "shortest",
    tolerance_m: float = 0.02,
    tolerance_rel: float = 0.01,
) -> Flow:
    """Return the flow from an image to another one, of any two cameras.

    A pixel's point ``X = o + D d`` of the world moves to ``X'`` with its object, and appears at
    ``project(X')`` in the second image. Points at infinity only turn with the cameras.

    Args:
        depth0: (H, W) metres along the rays of the first image; +inf is infinity; 0 has no flow.
        rays0: (H, W), of the first image's pixel centres, camera frame.
        pose0: of the first image's camera, world frame.
        camera1: of the second image.
        pose1: of that camera, world frame.
        depth1: (H1, W1) of the second image; without it no point counts as occluded.
        labels: (H, W) of the first image; surfaces of label 0 have no flow.
        motions: by label, the motion of a rigid object between the images, ``p_w1 = motion.to_world(p_w0)``;
            None if it is unknown. Other objects do not move.
        wrap: see :data:`Wrap`.
        tolerance_m: metres. A point is occluded if the second depth is nearer by more than this, and by more
            than ``tolerance_rel``.
        tolerance_rel: a share of the distance.

    Raises:
        ArgumentError: arrays of different sizes, motions without labels, or a wrong option.
    """
    one_of("wrap", wrap, get_args(Wrap))
    allowed_m = number("tolerance_m", tolerance_m, least=0)
    tolerance = Tolerance(allowed_m, number("tolerance_rel", tolerance_rel, least=0))
    _check(depth0, rays0, labels, motions)
    seen = _pixels_with_flow(depth0, rays0, labels)
    height, width = depth0.shape
    result = Flow(
        pixels=np.full((height, width, 2), np.nan),
        mask=np.zeros((height, width), np.uint8),
        scene=np.full((height, width, 3), np.nan),
    )
    occlusion = None if depth1 is None else _Occlusion(camera1, depth1, tolerance)

    def fill(rows: slice) -> None:
        """Write the flow of some rows of the first image into ``result``."""
        shown = seen[rows]
        objects = None if labels is None else labels[rows][shown]
        depth = depth0[rows][shown].astype(np.float64)
        directions = rays0.directions[rows][shown]
        origins = rays0.origins[rows][shown]
        points_c1, scene = _move(pose0, pose1, motions, depth, directions, origins, objects)
        target, known = camera1.project(points_c1)
        mask = np.where(known, np.where(np.isposinf(depth), AT_INFINITY, VALID), INVALID)
        if occlusion is not None:
            is_occluded = occlusion(target[known], points_c1[known])
            mask[known] = np.where(is_occluded, OCCLUDED, mask[known])
        row, column = np.nonzero(shown)
        displacement = target - (np.column_stack([column, row + rows.start]) + 0.5)
        if wrap == "shortest" and camera1.wraps:
            displacement[:, 0] = _shortest(displacement[:, 0], camera1.width)
        result.pixels[rows][shown] = displacement
        result.mask[rows][shown] = mask
        result.scene[rows][shown] = scene

    row_blocks(fill, height, width)
    return result


def _pixels_with_flow(depth0: NDArray[Any], rays0: Rays, labels: NDArray[Any] | None) -> NDArray[np.bool_]:
    """Return where (H, W) the first image has a ray and a depth; a surface also needs a label, if given."""
    has_depth = rays0.valid & (depth0 > 0)
    if labels is None:
        return has_depth
    return has_depth & ((labels > 0) | np.isposinf(depth0))


def _check(
    depth0: NDArray[Any], rays0: Rays, labels: NDArray[Any] | None, motions: Mapping[int, Pose | None]
) -> None:
    """Raise ArgumentError for motions without labels, and arrays of another size than the depth."""
    if motions and labels is None:
        raise ArgumentError("motions: expected labels with them, got none")
    for name, array in (("rays0", rays0.valid), ("labels", labels)):
        if array is not None and array.shape != depth0.shape:
            raise ArgumentError(f"{name}: expected the size of depth0, {depth0.shape}, got {array.shape}")


def _shortest(across: Array, width: int) -> Array:
    """Return horizontal flow in a panorama, px, across its seam where that is shorter."""
    half = width / 2
    return (across + half) % width - half


def motion(before: Pose, after: Pose) -> Pose:
    """Return how an object moved, by its poses ``before`` and ``after``: ``p_w1 = motion.to_world(p_w0)``."""
    return after @ before.inverse()


def _move(
    pose0: Pose,
    pose1: Pose,
    motions: Mapping[int, Pose | None],
    depth: Array,
    directions: Array,
    origins: Array,
    labels: NDArray[Any] | None,
) -> tuple[Array, Array]:
    """Return points (N, 3) in the second camera's frame, and their motion (N, 3) in the world, metres; NaN of
    an unknown motion, and the motion of points at infinity."""
    T_c1_c0 = pose1.inverse() @ pose0
    infinite = np.isposinf(depth)
    points_c0 = directions * np.where(infinite, _INFINITY_M, depth)[:, None]
    points_c0 += origins
    points_c1 = points_c0 @ T_c1_c0.rotation.T
    points_c1 += T_c1_c0.position
    scene = np.zeros_like(points_c0)
    if infinite.any():
        points_c1[infinite] = _INFINITY_M * (directions[infinite] @ T_c1_c0.rotation.T)
        scene[infinite] = np.nan
    for label, motion in motions.items():
        is_object = labels == label
        if motion is None:
            points_c1[is_object] = np.nan
            scene[is_object] = np.nan
        else:
            points_w = pose0.to_world(points_c0[is_object])
            moved_w = motion.to_world(points_w)
            points_c1[is_object] = pose1.to_camera(moved_w)
            scene[is_object] = moved_w - points_w
    return points_c1, scene


class _Occlusion:
    """Which points are occluded in the second image, whose depth (H1, W1) is nearer there."""

    def __init__(self, camera1: Camera, depth1: NDArray[Any], tolerance: Tolerance) -> None:
        if depth1.shape != (camera1.height, camera1.width):
            size = camera1.height, camera1.width
            raise ArgumentError(f"depth1: expected the size of the camera, {size}, got {depth1.shape}")
        self._camera = camera1
        self._tolerance = tolerance
        self._inverse = 1 / np.where(depth1 > 0, depth1, np.inf).astype(np.float64)

    def __call__(self, pixels: Array, points_c1: Array) -> Mask:
        """Return (N,) bool of points (N, 3), camera frame, that project to pixels (N, 2)."""
        origins = 0.0 if self._camera.central else self._camera.unproject(pixels).origins
        distance = np.linalg.norm(points_c1 - origins, axis=-1)
        tolerance = np.maximum(self._tolerance.abs_m, self._tolerance.rel * distance)
        return np.asarray(distance - self._depth_at(pixels) > tolerance)

    def _depth_at(self, pixels: Array) -> Array:
        """Return (N,) the larger of the nearest pixel's depth and the depth interpolated between four pixels.

        1 / depth is linear on a plane, so a slanted floor does not hide itself. At the border of a nearer
        object the nearest pixel decides. Pixels outside the field of view hide nothing.
        """
        column, row = np.floor(pixels).astype(np.int64).T
        left, top = np.floor(pixels - 0.5).astype(np.int64).T
        across, down = (pixels - 0.5).T - (left, top)
        upper = self._at(left, top) * (1 - across) + self._at(left + 1, top) * across
        lower = self._at(left, top + 1) * (1 - across) + self._at(left + 1, top + 1) * across
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.minimum(self._at(column, row), upper * (1 - down) + lower * down))

    def _at(self, column: NDArray[Any], row: NDArray[Any]) -> Array:
        height, width = self._inverse.shape
        column = column % width if self._camera.wraps else column.clip(0, width - 1)
        return np.asarray(self._inverse[row.clip(0, height - 1), column])


# -- the truth ------------------------------------------------------------------------------------------


@record
class FlowOptions:
    """Options of the truth ``flow``, and of the format that writes it."""

    gap: int = checked(whole_number, default=1, help="number of frames from a frame to the other one")
    wrap: Wrap = word(
        Wrap,
        default="shortest",
        help="shortest: across the seam of a panorama if that is shorter; classic: difference of columns",
    )
    backward: bool = checked(flag, default=False, help="flow to the frame before, too: STEM.backward.*")
    scene: bool = checked(flag, default=False, help="scene flow, too: STEM.sceneflow.exr, metres, world")
    kitti: bool = checked(flag, default=False, help="KITTI's 16-bit PNG, too, for flow below 512 px")
    tolerance: Tolerance = checked(
        nested(Tolerance), default=Tolerance(), help="by which a nearer depth occludes a point"
    )


register(Truth("flow", None, needs=("depth",), keys=("tolerance",), options=FlowOptions, format="flow"))
