"""Captures of one optical centre as tensors, and how they are sampled: as omniscv composes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from omniscv.compose.atlas import FILTER_SUPPORT_PX, Atlas
from omniscv.modalities import Interpolation
from omniscv.sources import View
from omniscv.torch.lookup import Lookup

Pictures = Sequence[NDArray[Any]]
"""(h, w) or (h, w, C) pixels of each view."""

_OUTSIDE = -2.0
"""A normalised coordinate where ``grid_sample`` finds nothing but 0."""


class Tiles(Protocol):
    """The pixels of one modality in all views.

    Attributes:
        tensor: that holds them.
    """

    tensor: Tensor

    def __init__(self, views: Sequence[View], faces: Pictures, device: torch.device) -> None: ...

    def sample(self, lookup: Lookup) -> Tensor:
        """Return (B, N) or (B, N, C) values; 0 where no view sees the ray."""


class Blended:
    """Values between pixels are bilinear, of the captured values as they are: of sRGB in 8 bits where a
    server sends that. Beyond a view's edge lies the gutter of :mod:`omniscv.compose.atlas`."""

    def __init__(self, views: Sequence[View], faces: Pictures, device: torch.device) -> None:
        border = min(min(view.width, view.height) / 2 - view.focal_px for view in views)
        atlas = Atlas(views, range(1), FILTER_SUPPORT_PX if border < FILTER_SUPPORT_PX else 0)
        picture = atlas.picture([face.reshape(*face.shape[:2], -1) for face in faces])
        planes = np.array(np.moveaxis(picture, -1, 0), np.float32)
        self._dtype, self._flat = torch.from_numpy(np.zeros(0, faces[0].dtype)).dtype, faces[0].ndim == 2
        self._corners = torch.from_numpy(np.array(atlas.levels[0].corners, np.float64)).to(device)
        self.tensor = torch.from_numpy(planes)[None].to(device)

    def sample(self, lookup: Lookup) -> Tensor:
        size = torch.tensor(self.tensor.shape[:1:-1], dtype=torch.float64, device=self.tensor.device)
        at = torch.stack([lookup.x, lookup.y], dim=-1) + self._corners[lookup.own]
        grid = (2 * at / size - 1).float()
        grid = torch.where(lookup.view[..., None] < 0, _OUTSIDE, grid)
        found = grid_sample(self.tensor, grid[None], align_corners=False)[0].movedim(0, -1)
        if not self._dtype.is_floating_point:
            found = found.round().to(self._dtype)
        return found[..., 0] if self._flat else found


class Nearest:
    """The value of the pixel that a ray lies in, never blended."""

    def __init__(self, views: Sequence[View], faces: Pictures, device: torch.device) -> None:
        stack = np.stack(faces)
        stack = stack.astype(np.int32) if stack.dtype == np.uint16 else stack
        self.tensor = torch.from_numpy(stack.reshape(-1, *stack.shape[3:])).to(device)

    def sample(self, lookup: Lookup) -> Tensor:
        found = self.tensor[lookup.pixel]
        seen = (lookup.view >= 0).reshape(*lookup.view.shape, *[1] * (found.ndim - 2))
        return torch.where(seen, found, torch.zeros((), dtype=found.dtype, device=found.device))


class Depth(Nearest):
    """Metres along the ray, of the planar depth of the pixel that it lies in; +inf no surface."""

    def sample(self, lookup: Lookup) -> Tensor:
        planar = self.tensor[lookup.pixel].double()
        return torch.where(lookup.view >= 0, planar * lookup.length, 0.0).float()


TILES: dict[Interpolation, type[Tiles]] = {
    "blended": Blended,
    "nearest": Nearest,
    "surface": Depth,
    "direction": Nearest,
}
"""How kinds of modalities are held and sampled."""
