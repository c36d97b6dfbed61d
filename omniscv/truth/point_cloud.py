"""Points that images see: from depth along rays to the world."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number
from omniscv.cameras import Rays
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.parallel import side_by_side

_CELL_BITS = 21  # three of them in 63 bits
_PART_PX = 1 << 14  # pixels that are worked on together, in the processor's cache


@dataclass(frozen=True, eq=False)
class Points:
    """Points in the world, and what is known of each.

    Attributes:
        positions_w: (N, 3) float64 metres, world frame.
        distances: (N,) float64 metres from the optical centre that saw them.
        values: by layer, (N, ...) in the layer's type; ``normals`` in the world frame.
    """

    positions_w: Array
    distances: Array
    values: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.positions_w)

    def only(self, chosen: NDArray[Any]) -> Points:
        """Return some of the points, by (N,) bool or by index."""
        values = {name: each[chosen] for name, each in self.values.items()}
        return Points(self.positions_w[chosen], self.distances[chosen], values)


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
        layers: (H, W, ...) what else is known of the pixels, such as ``lit``, ``labels``; ``normals`` are in
            the camera frame.
        unsure: (H, W), pixels to leave out.

    Raises:
        ArgumentError: arrays of different sizes.
    """
    layers = dict(layers or {})
    for name, each in {"rays": rays.valid, **layers}.items():
        if each.shape[:2] != depth.shape:
            raise ArgumentError(f"{name}: expected the size of depth, {depth.shape}, got {each.shape[:2]}")
    seen = rays.valid & np.isfinite(depth) & (depth > 0)
    if unsure is not None:
        seen &= ~unsure

    def part(rows: slice) -> Points:
        mine = seen[rows]
        distances = depth[rows][mine].astype(np.float64)
        points_c = distances[:, None] * rays.directions[rows][mine] + rays.origins[rows][mine]
        values = {name: each[rows][mine] for name, each in layers.items()}
        if "normals" in values:
            values["normals"] = values["normals"] @ pose.R_w_c.T.astype(values["normals"].dtype)
        return Points(pose.to_world(points_c), distances, values)

    step = max(1, _PART_PX // depth.shape[1])
    return _joined(side_by_side(part, [slice(row, row + step) for row in range(0, len(depth), step)]))


def merged(clouds: Iterable[Points], voxel_m: float) -> Points:
    """Return the points of several images, one in each cube of a grid: the one seen from nearest.

    Clouds are taken one after the other, so that no more is in memory than the result and one of them. Of
    points seen from equally near, the first stays. What only some clouds know is left out.

    Args:
        clouds: at least one.
        voxel_m: edge of the cubes, metres; their middles are at its multiples.

    Raises:
        ArgumentError: no cloud, an edge not above 0, or one so small that the grid has more than 2^21 cubes
            along an axis.
    """
    voxel_m = number("voxel", voxel_m, above=0)
    found: Points | None = None
    for cloud in clouds:
        found = _thinned(cloud if found is None else _joined([found, cloud]), voxel_m)
    if found is None:
        raise ArgumentError("clouds: expected at least one, got none")
    return found


def _joined(parts: Sequence[Points]) -> Points:
    known = set.intersection(*(set(part.values) for part in parts))
    return Points(
        np.concatenate([part.positions_w for part in parts]),
        np.concatenate([part.distances for part in parts]),
        {name: np.concatenate([part.values[name] for part in parts]) for name in sorted(known)},
    )


def _thinned(cloud: Points, voxel_m: float) -> Points:
    """The nearest point of each cube, in the order of the cloud."""
    cells = np.floor(cloud.positions_w / voxel_m + 0.5)  # walls at round numbers are within cubes
    limit = 1 << (_CELL_BITS - 1)
    if len(cells) and not np.abs(cells).max() < limit:
        far = np.abs(cloud.positions_w).max()
        raise ArgumentError(f"voxel: expected at least {far / (limit - 1):.3g} m for points {far:.3g} m away")
    x, y, z = (cells.astype(np.int64) + limit).T
    cell = (x << 2 * _CELL_BITS) | (y << _CELL_BITS) | z
    order = np.lexsort((cloud.distances, cell))
    first = np.ones(len(order), dtype=bool)
    first[1:] = cell[order[1:]] != cell[order[:-1]]
    return cloud.only(np.sort(order[first]))
