"""Sampling on a device: for each ray the view that sees it, and the value there.

On a processor the kernels of :mod:`omniscv.compose` sample. On other devices PyTorch does: its lookup follows
:mod:`omniscv.compose.ray_lookup`, in float64 and in the same order of operations, so that both agree to the
bit. Values are sampled as omniscv composes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from omniscv.arguments import shown
from omniscv.cameras import Camera
from omniscv.compose.atlas import FILTER_SUPPORT_PX, Atlas
from omniscv.compose.samplers import SAMPLE, CpuSampler
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.surfaces import Precision
from omniscv.modalities import Interpolation
from omniscv.planning import ImageRays
from omniscv.sources import View

_BEYOND = 1.0 + 1e-9  # of a view's half size: rays on its edge are in it

Pictures = Sequence[NDArray[Any]]
"""(h, w) or (h, w, C) pixels of each view."""

_OUTSIDE = -2.0
"""A normalised coordinate for which ``grid_sample`` returns 0."""


def check_central(camera: object) -> None:
    """Raise ArgumentError unless a camera has a single optical centre."""
    if not isinstance(camera, Camera):
        raise ArgumentError(f"camera: expected a Camera, got {shown(camera)}")
    if not camera.central:
        raise ArgumentError(
            f"camera: expected a camera with a single optical centre, got {camera.name}; render it with "
            "omniscv.render"
        )


@dataclass(frozen=True, eq=False)
class Lookup:
    """The views and pixels of the rays of B orientations, N each.

    Attributes:
        views: all of one size.
        view: (B, N) int64, -1 if no view sees the ray.
        x, y: (B, N) float32 px in that view; pixel centres lie at .5.
    """

    views: tuple[View, ...]
    view: Tensor
    x: Tensor
    y: Tensor

    def unseen(self, valid: Tensor) -> int:
        """Return how many valid rays (H, W) no view sees, in all orientations."""
        return int(((self.view < 0) & valid.reshape(1, -1)).sum())

    @cached_property
    def index(self) -> Tensor:
        """(B, N) int64, the view; 0 if no view sees the ray."""
        return self.view.clamp(min=0)

    @cached_property
    def pixel(self) -> Tensor:
        """(B, N) int64, flat index of the ray's pixel in the stacked views."""
        width, height = self.views[0].width, self.views[0].height
        column = self.x.floor().clamp(0, width - 1).long()
        row = self.y.floor().clamp(0, height - 1).long()
        return (self.index * height + row) * width + column

    @cached_property
    def length(self) -> Tensor:
        """(B, N) float64, metres along the ray for a metre of planar depth."""
        projections = torch.tensor([view.projection for view in self.views], dtype=torch.float64)
        fx, fy, cx, cy = projections.to(self.x.device)[self.index].unbind(-1)
        u, v = (self.x.double() - cx) / fx, (self.y.double() - cy) / fy
        return torch.sqrt(1.0 + u * u + v * v)


def look_up(directions: Tensor, views: Sequence[View], R_w_d: Sequence[Array]) -> Lookup:
    """Return the views and pixels of rays from the views' common centre.

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
        fx, fy, cx, cy = view.projection
        u = fx * (R[:, 0, 0] * a + R[:, 0, 1] * b + R[:, 0, 2] * c) / z + (cx - half_width)
        v = fy * (R[:, 1, 0] * a + R[:, 1, 1] * b + R[:, 1, 2] * c) / z + (cy - half_height)
        off = torch.maximum(u.abs() / half_width, v.abs() / half_height)
        better = (z > 0) & (off < best)
        best, which = torch.where(better, off, best), torch.where(better, k, which)
        x, y = torch.where(better, u, x), torch.where(better, v, y)
    return Lookup(tuple(views), which, (x + half_width).float(), (y + half_height).float())


@lru_cache(maxsize=4)
def directions_of(camera: Camera, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return (3, N) the rays of a camera's pixels, camera frame, NaN if not valid, and (H, W) bool valid."""
    rays = camera.unproject()
    directions = np.array(rays.directions.reshape(-1, 3).T, order="C")
    return torch.from_numpy(directions).to(device), torch.from_numpy(np.array(rays.valid)).to(device)


class Blended:
    """The pixels of a modality in all views, blended as they are, such as sRGB in 8 bits; bilinear.

    Attributes:
        tensor: that holds them.
    """

    def __init__(self, views: Sequence[View], faces: Pictures, device: torch.device) -> None:
        border = min(min(view.width, view.height) / 2 - view.focal_px for view in views)
        atlas = Atlas(views, range(1), FILTER_SUPPORT_PX if border < FILTER_SUPPORT_PX else 0)
        picture = atlas.picture([face.reshape(*face.shape[:2], -1) for face in faces])
        planes = np.array(np.moveaxis(picture, -1, 0), np.float32)
        self._dtype, self._flat = torch.from_numpy(np.zeros(0, faces[0].dtype)).dtype, faces[0].ndim == 2
        self._corners = torch.from_numpy(np.array(atlas.levels[0].corners, np.float64)).to(device)
        self.tensor = torch.from_numpy(planes)[None].to(device)

    def sample(self, lookup: Lookup) -> Tensor:
        """Return (B, N) or (B, N, C) values; 0 if no view sees the ray."""
        size = torch.tensor(self.tensor.shape[:1:-1], dtype=torch.float64, device=self.tensor.device)
        at = torch.stack([lookup.x, lookup.y], dim=-1) + self._corners[lookup.index]
        grid = (2 * at / size - 1).float()
        grid = torch.where(lookup.view[..., None] < 0, _OUTSIDE, grid)
        values = grid_sample(self.tensor, grid[None], align_corners=False)[0].movedim(0, -1)
        if not self._dtype.is_floating_point:
            values = values.round().to(self._dtype)
        return values[..., 0] if self._flat else values


class Nearest:
    """The value of the ray's pixel, never blended."""

    def __init__(self, views: Sequence[View], faces: Pictures, device: torch.device) -> None:
        stack = np.stack(faces)
        stack = stack.astype(np.int32) if stack.dtype == np.uint16 else stack
        self.tensor = torch.from_numpy(stack.reshape(-1, *stack.shape[3:])).to(device)

    def sample(self, lookup: Lookup) -> Tensor:
        """Return (B, N) or (B, N, C) values; 0 if no view sees the ray."""
        values = self.tensor[lookup.pixel]
        seen = (lookup.view >= 0).reshape(*lookup.view.shape, *[1] * (values.ndim - 2))
        return torch.where(seen, values, torch.zeros((), dtype=values.dtype, device=values.device))


class Depth(Nearest):
    """Metres along the ray, from the planar depth of its pixel; +inf for no surface."""

    def sample(self, lookup: Lookup) -> Tensor:
        planar = self.tensor[lookup.pixel].double()
        return torch.where(lookup.view >= 0, planar * lookup.length, 0.0).float()


TILES: dict[Interpolation, type[Blended | Nearest]] = {
    "blended": Blended,
    "nearest": Nearest,
    "surface": Depth,
    "direction": Nearest,
}
"""By interpolation of a modality, how its pixels are sampled."""


class ProcessorLookup:
    """The views and pixels of a camera's rays in B orientations, found by the kernels of composition."""

    def __init__(self, camera: Camera, views: tuple[View, ...], R_w_c: Sequence[Array]) -> None:
        self.views, rays = views, _rays_of(camera)
        self.samplers = [CpuSampler(rays.blocks, R, views) for R in R_w_c]

    def unseen(self, valid: Tensor) -> int:
        """Return how many valid rays no view sees, in all orientations."""
        return sum(sampler.unseen for sampler in self.samplers)


class ProcessorTiles:
    """The pixels of a modality in all views, sampled by a :class:`ProcessorLookup`."""

    def __init__(self, interpolation: Interpolation, faces: Pictures) -> None:
        stack: Any = np.stack(faces)
        self._interpolation, self._stack, self.tensor = interpolation, stack, torch.from_numpy(stack)

    def sample(self, lookup: ProcessorLookup) -> Tensor:
        """Return (B, N) or (B, N, C) values; 0 if no view sees the ray."""
        kind, stack = self._interpolation, self._stack
        filter = "bilinear" if kind == "blended" else "nearest"
        values = [
            sampler.sample_depth("nearest", stack, Precision(), None).distance
            if kind == "surface"
            else SAMPLE[kind](sampler, filter, stack)
            for sampler in lookup.samplers
        ]
        return torch.from_numpy(np.stack(values))


@lru_cache(maxsize=4)
def _rays_of(camera: Camera) -> ImageRays:
    return ImageRays(camera)
