"""Point clouds of images, from depth along rays to the world."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number
from omniscv.cameras import Camera, Lidar, Rays, RollingShutter
from omniscv.compose.layers import MARKS
from omniscv.compose.pictures import uint8_colors
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import R_LEVEL, Array, Pose
from omniscv.parallel import row_blocks

_VALUES = ("normals", "lit", "labels", "classes")
_CELL_BITS = 21  # of a cube's index along an axis: three fit into 63 bits


@dataclass(frozen=True, eq=False)
class Points:
    """Points in the world with the values of layers.

    Attributes:
        positions_w: (N, 3) float64 metres, world frame.
        distances: (N,) float64 metres from their optical centre.
        values: by layer, (N, ...) in the layer's type; ``normals`` in the world frame.
    """

    positions_w: Array
    distances: Array
    values: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.positions_w)

    def select(self, index: NDArray[Any]) -> Points:
        """Return some of the points, by (N,) bool or by their indices."""
        values = {}
        for name, array in self.values.items():
            values[name] = array[index]
        return Points(self.positions_w[index], self.distances[index], values)


def points(
    depth: NDArray[np.floating[Any]],
    rays: Rays,
    pose: Pose,
    layers: Mapping[str, NDArray[Any]] | None = None,
    unsure: NDArray[np.bool_] | None = None,
) -> Points:
    """Return the points of the pixels with finite depth, row by row.

    Args:
        depth: (H, W) metres along the rays; pixels of 0, +inf or NaN have no point.
        rays: (H, W), of the pixels' centres, camera frame.
        pose: of the camera.
        layers: (H, W, ...) further layers of the image, such as ``lit``, ``labels``; ``normals`` are in the
            camera frame.
        unsure: (H, W), pixels to leave out.

    Raises:
        ArgumentError: arrays of different sizes.
    """
    layers = dict(layers or {})
    for name, array in {"rays": rays.valid, **layers}.items():
        if array.shape[:2] != depth.shape:
            raise ArgumentError(f"{name}: expected the size of depth, {depth.shape}, got {array.shape[:2]}")
    seen = rays.valid & np.isfinite(depth) & (depth > 0)
    if unsure is not None:
        seen &= ~unsure

    def of_rows(rows: slice) -> Points:
        shown = seen[rows]
        distances = depth[rows][shown].astype(np.float64)
        points_c = distances[:, None] * rays.directions[rows][shown] + rays.origins[rows][shown]
        values = {}
        for name, array in layers.items():
            values[name] = array[rows][shown]
        if "normals" in values:
            values["normals"] = values["normals"] @ pose.R_w_c.T.astype(values["normals"].dtype)
        return Points(pose.to_world(points_c), distances, values)

    return _join(row_blocks(of_rows, *depth.shape))


def points_of(frame: Frame, rays: Rays, max_relative: float | None = None) -> Points:
    """Return the points of a frame with depth, with its normals, colours, labels, classes and doubt.

    Args:
        frame: of a dataset.
        rays: of its camera's pixel centres, camera frame.
        max_relative: points are left out as :func:`inexact` says; None: none are.
    """
    layers = {}
    for name in _VALUES:
        if name in frame.files:
            layers[name] = frame.layer(name)
    layers |= _doubt(frame)
    if "lit" in layers:
        layers["lit"] = uint8_colors(layers["lit"])
    left_out = [frame.layer("unsure")] if "unsure" in frame.files else []
    if max_relative is not None:
        left_out.append(inexact(frame, max_relative))
    unsure = np.any(left_out, axis=0) if left_out else None
    return points(frame.layer("depth"), rays, frame.pose, layers, unsure)


def lidar_of(camera: Camera) -> Lidar | None:
    """Return the scanner that a camera is, at rest or while it moves; None for others."""
    base = camera.base if isinstance(camera, RollingShutter) else camera
    return base if isinstance(base, Lidar) else None


def sweep(frame: Frame, max_relative: float | None = None, intensity: bool = False) -> NDArray[Any]:
    """Return the point of each pixel as its sensor measures it, at rest or while it moves.

    Args:
        frame: of a dataset, with depth.
        max_relative: points are left out as :func:`inexact` says.
        intensity: add ``intensity``, which is no measurement: the mean of a pixel's colours, in place of the
            albedo, times the cosine of the angle of incidence; 0 to 1.

    Returns:
        (H, W) with the fields ``x y z`` (float32 metres: X ahead, Y left, Z up of the sensor when it fired;
        NaN without a point), ``ring`` and ``time`` (seconds from the frame's) of a ``lidar``, and ``label``,
        ``class`` and ``doubt`` (uint8: 1 where the label or depth may be wrong) if the frame has them.

    Raises:
        ArgumentError: the frame has no depth; or no colours or normals, for an intensity.
    """
    lidar = lidar_of(frame.camera)
    depth = frame.layer("depth")
    rays = (lidar or frame.camera).unproject()
    seen = rays.valid & np.isfinite(depth) & (depth > 0)
    if "unsure" in frame.files:
        seen &= ~frame.layer("unsure")
    if max_relative is not None:
        seen &= ~inexact(frame, max_relative)
    distances = np.where(seen, depth.astype(np.float64), 0)  # where nothing is seen it may be infinite
    points = (rays.origins + distances[..., None] * rays.directions) @ R_LEVEL.T
    columns: dict[str, NDArray[Any]] = {}
    for index, axis in enumerate("xyz"):
        columns[axis] = np.where(seen, points[..., index], np.nan).astype(np.float32)
    if intensity:
        cosines = np.abs((frame.layer("normals") * frame.camera.unproject().directions).sum(axis=-1))
        albedo = uint8_colors(frame.layer("lit")).mean(axis=-1) / 255
        columns["intensity"] = np.nan_to_num(albedo * cosines).astype(np.float32)
    if lidar is not None:
        columns["ring"] = np.broadcast_to(lidar.rings[:, None], depth.shape)
        moving = frame.camera if isinstance(frame.camera, RollingShutter) else lidar
        columns["time"] = moving.seconds().astype(np.float32)
    for name, layer in frame.layers("labels", "classes").items():
        columns[{"labels": "label", "classes": "class"}[name]] = layer
    for name, layer in _doubt(frame).items():
        columns[name] = layer.view(np.uint8)
    table = np.empty(depth.shape, [(name, column.dtype.str) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table


def _doubt(frame: Frame) -> dict[str, NDArray[Any]]:
    """Return the layer ``doubt`` by its name; nothing where the frame has no marks and no bounds."""
    known = {*MARKS, "depth_error"} & {*frame.files, *frame.blank}
    return {"doubt": frame.layer("doubt")} if known else {}


def inexact(frame: Frame, max_relative: float) -> NDArray[np.bool_]:
    """Return (H, W) whether the bound on the error of depth is a larger part of it than ``max_relative``.

    If the ``frame`` has no bounds, no pixel is inexact.
    """
    depth = frame.layer("depth")
    if "depth_error" not in frame.files:
        return np.zeros(depth.shape, np.bool_)
    with np.errstate(invalid="ignore"):
        return np.asarray(frame.layer("depth_error") > max_relative * depth)


def merged(clouds: Iterable[Points], voxel_m: float) -> Points:
    """Return the points of several images, one in each cube of a grid: the one nearest to its optical centre.

    Clouds are merged as they come, so memory holds about twice the result. Of equally near points, the first
    stays. Layers that only some clouds have are left out. The grid is counted from the first point, so clouds
    may lie anywhere, as in UTM.

    Args:
        clouds: at least one.
        voxel_m: edge of the cubes, metres; their middles are at multiples of it.

    Raises:
        ArgumentError: no cloud, an edge not above 0, or one so small that the grid has more than 2^21 cubes
            along an axis.
    """
    voxel_m = number("voxel", voxel_m, above=0)
    pending: list[Points] = []
    origin: Array | None = None  # the cube of the first point
    for cloud in clouds:
        if origin is None and len(cloud):
            origin = _cells(cloud.positions_w[0], voxel_m)
        pending.append(cloud if origin is None else _thin(cloud, voxel_m, origin))
        if origin is not None and sum(map(len, pending[1:])) > len(pending[0]):
            pending = [_thin(_join(pending), voxel_m, origin)]
    if not pending:
        raise ArgumentError("clouds: expected at least one, got none")
    return pending[0] if origin is None else _thin(_join(pending), voxel_m, origin)


def _join(clouds: Sequence[Points]) -> Points:
    """Return the points of clouds as one, with the layers that all of them have."""
    layers = set(clouds[0].values)
    for cloud in clouds:
        layers &= cloud.values.keys()
    values = {}
    for name in sorted(layers):
        values[name] = np.concatenate([cloud.values[name] for cloud in clouds])
    positions_w = np.concatenate([cloud.positions_w for cloud in clouds])
    return Points(positions_w, np.concatenate([cloud.distances for cloud in clouds]), values)


def _cells(positions_w: Array, voxel_m: float) -> Array:
    """Return the cubes (..., 3) of positions; walls at round coordinates lie inside cubes."""
    return np.asarray(np.floor(positions_w / voxel_m + 0.5))


def _thin(cloud: Points, voxel_m: float, origin: Array) -> Points:
    """The nearest point of each cube, in the order of the cloud; cubes are counted from that of an origin."""
    cells = _cells(cloud.positions_w, voxel_m) - origin
    limit = 1 << (_CELL_BITS - 1)
    if len(cells) and not np.abs(cells).max() < limit:
        far = np.abs(cells).max() * voxel_m
        wanted = f"at least {far / (limit - 1):.3g} m for points {far:.3g} m apart"
        raise ArgumentError(f"voxel: expected {wanted}, got {voxel_m:.3g}")
    x, y, z = (cells.astype(np.int64) + limit).T
    cell = (x << 2 * _CELL_BITS) | (y << _CELL_BITS) | z
    order = np.lexsort((cloud.distances, cell))
    first = np.ones(len(order), dtype=bool)
    first[1:] = cell[order[1:]] != cell[order[:-1]]
    return cloud.select(np.sort(order[first]))
