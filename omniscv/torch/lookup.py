"""The ray lookup on a device: for each ray the view that sees it, and the pixel there.

The rule is that of :mod:`omniscv.compose.ray_lookup`, in float64 and in the same order of operations, so that
both agree to the bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import torch
from torch import Tensor

from omniscv.cameras import Camera
from omniscv.geometry import Array
from omniscv.sources import View

_BEYOND = 1.0 + 1e-9  # of a view's half size: a ray on its very edge is seen


@dataclass(frozen=True, eq=False)
class Lookup:
    """Where the rays of B orientations lie, N each.

    Attributes:
        views: all of one size.
        view: (B, N) int64, -1 where no view sees the ray.
        x, y: (B, N) float32 px in that view; pixel centres lie at .5.
    """

    views: tuple[View, ...]
    view: Tensor
    x: Tensor
    y: Tensor

    @cached_property
    def own(self) -> Tensor:
        """(B, N) int64, the view; 0 where no view sees the ray."""
        return self.view.clamp(min=0)

    @cached_property
    def pixel(self) -> Tensor:
        """(B, N) int64, flat index of the pixel that a ray lies in, in views that are stacked."""
        width, height = self.views[0].width, self.views[0].height
        column = self.x.floor().clamp(0, width - 1).long()
        row = self.y.floor().clamp(0, height - 1).long()
        return (self.own * height + row) * width + column

    @cached_property
    def length(self) -> Tensor:
        """(B, N) float64, metres along the ray for a metre of planar depth."""
        width, height = self.views[0].width, self.views[0].height
        focal = torch.tensor([view.focal_px for view in self.views], dtype=torch.float64)
        focal = focal.to(self.x.device)[self.own]
        u, v = (self.x.double() - width / 2) / focal, (self.y.double() - height / 2) / focal
        return torch.sqrt(1.0 + u * u + v * v)


def look_up(directions: Tensor, views: Sequence[View], R_w_d: Sequence[Array]) -> Lookup:
    """Return the views and the pixels that serve rays from the views' common centre.

    Args:
        directions: (3, N) float64, any length; NaN rays get view -1.
        views: at least one; they share their centre and size.
        R_w_d: B times (3, 3), from the frame of the directions to the world.
    """
    R_v_d = np.array([[view.pose.R_w_c.T @ R for view in views] for R in R_w_d])
    turned = torch.from_numpy(R_v_d).to(directions.device)[..., None]
    half_width, half_height = views[0].width / 2, views[0].height / 2
    shape = len(R_w_d), directions.shape[1]
    best = directions.new_full(shape, _BEYOND)
    which = torch.full(shape, -1, dtype=torch.int64, device=directions.device)
    x, y = torch.zeros_like(best), torch.zeros_like(best)
    a, b, c = directions
    for k, view in enumerate(views):
        R = turned[:, k]
        z = R[:, 2, 0] * a + R[:, 2, 1] * b + R[:, 2, 2] * c
        u = view.focal_px * (R[:, 0, 0] * a + R[:, 0, 1] * b + R[:, 0, 2] * c) / z
        v = view.focal_px * (R[:, 1, 0] * a + R[:, 1, 1] * b + R[:, 1, 2] * c) / z
        off = torch.maximum(u.abs() / half_width, v.abs() / half_height)
        better = (z > 0) & (off < best)
        best, which = torch.where(better, off, best), torch.where(better, k, which)
        x, y = torch.where(better, u, x), torch.where(better, v, y)
    return Lookup(tuple(views), which, (x + half_width).float(), (y + half_height).float())


@lru_cache(maxsize=4)
def directions_of(camera: Camera, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return (3, N) the rays of a camera's pixels, camera frame, NaN where not valid, and (H, W) bool
    whether they are; kept for the cameras that were used last."""
    rays = camera.unproject()
    directions = np.array(rays.directions.reshape(-1, 3).T, order="C")
    return torch.from_numpy(directions).to(device), torch.from_numpy(np.array(rays.valid)).to(device)
