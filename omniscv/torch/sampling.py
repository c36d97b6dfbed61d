"""Sampling: for each ray the view that sees it, and the value there.

On a processor the kernels of :mod:`omniscv.compose` sample, on other devices those of
:mod:`omniscv.torch.kernels`. Values are sampled as omniscv composes them.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from omniscv.arguments import shown
from omniscv.cameras import Camera
from omniscv.compose.atlas import FILTER_SUPPORT_PX, Atlas
from omniscv.compose.samplers import SAMPLE, Sampler
from omniscv.depth.depth_pictures import DepthPictures
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.precision import Precision
from omniscv.modalities import Interpolation
from omniscv.planning import ImageRays
from omniscv.sources import View

_BEYOND = 1.0 + 1e-9  # of a view's half size: rays on its edge are in it

Pictures = Sequence[NDArray[Any]]
"""(h, w) or (h, w, C) pixels of each view."""


def check_central(camera: object) -> None:
    """Raise ArgumentError unless a camera has a single optical centre."""
    if not isinstance(camera, Camera):
        raise ArgumentError(f"camera: expected a Camera, got {shown(camera)}")
    if not camera.central:
        wanted = f"expected a camera with a single optical centre, got {camera.name}"
        raise ArgumentError(f"camera: {wanted}; render it with omniscv.render")


@lru_cache(maxsize=4)
def _directions(camera: Camera, device: torch.device) -> Tensor:
    """Return (3, N) float64, the rays of a camera's pixels, camera frame; NaN if not valid."""
    directions = camera.unproject().directions.reshape(-1, 3)
    return torch.from_numpy(np.array(directions.T, order="C")).to(device)


@lru_cache(maxsize=4)
def _projections(views: tuple[View, ...], device: torch.device) -> Tensor:
    """Return (V, 6) float64: fx, fy, cx and cy from the picture's middle, half its width and height; px."""
    half = np.array([views[0].width, views[0].height]) / 2
    rows = np.empty((len(views), 6))
    for number, view in enumerate(views):
        rows[number, :2] = view.projection[:2]
        rows[number, 2:4] = view.projection[2:] - half
        rows[number, 4:] = half
    return torch.tensor(rows, device=device)


class DeviceLookup:
    """The views and points of a central camera's N rays in B orientations, found on a device.

    Args:
        camera: central.
        views: which share their centre and size.
        R_w_c: (B, 3, 3) camera to world.
        device: which has float64 and Triton.

    Attributes:
        shape: B and N.
        arrays: (B, N) int16 the view, -1 if none sees the ray; x, y float32 px in it, pixel centres at .5.
        unseen: how many valid rays no view sees, in all orientations.
    """

    def __init__(self, camera: Camera, views: tuple[View, ...], R_w_c: Array, device: torch.device) -> None:
        from omniscv.torch import kernels

        directions = _directions(camera, device)
        self.shape = len(R_w_c), directions.shape[1]
        self.arrays = [
            torch.empty(self.shape, dtype=torch.int16, device=device),
            torch.empty(self.shape, dtype=torch.float32, device=device),
            torch.empty(self.shape, dtype=torch.float32, device=device),
        ]
        self.unseen = torch.zeros((), dtype=torch.int32, device=device)
        R_d_w = np.array([view.pose.R_w_c.T for view in views])
        turns = torch.from_numpy(R_d_w @ R_w_c[:, None]).to(device)
        arguments = directions, turns, _projections(views, device), *self.arrays, self.unseen
        constants = kernels.OF_LOOK_UP | {"VIEWS": len(views), "BEYOND": _BEYOND}
        self.launch(kernels.look_up, *arguments, sizes=(), **constants)

    def launch(self, kernel: Any, *arguments: Any, sizes: tuple[int, ...], **constants: Any) -> None:
        """Run a kernel for all rays.

        Args:
            kernel: of :mod:`omniscv.torch.kernels`.
            arguments: its first ones; the numbers of rays and of images follow them.
            sizes: its last ones.
            constants: by name, that it is compiled with.
        """
        images, count = self.shape
        grid = (images * -(-count // constants["SIZE"]),)
        with torch.cuda.device_of(self.unseen):  # else Triton would launch on the current device
            kernel[grid](*arguments, count, images, *sizes, **constants)


class DeviceTiles:
    """The pixels of a modality in all views, sampled by a :class:`DeviceLookup`.

    Args:
        kind: how values between pixels are found.
        views: which share their centre and size.
        faces: the pixels of each view.
        device: which has float64 and Triton.

    Attributes:
        tensor: that holds them: stacked views, or an atlas of views that are blended, bilinear and as they
            are, such as sRGB in 8 bits.
    """

    def __init__(
        self, kind: Interpolation, views: Sequence[View], faces: Pictures, device: torch.device
    ) -> None:
        self._kind = kind
        self._flat = faces[0].ndim == 2
        pixels = np.stack(faces)
        self._channels = 1 if self._flat else pixels.shape[3]
        if kind == "blended":
            border = min(min(view.width, view.height) / 2 - view.focal_px for view in views)
            atlas = Atlas(views, range(1), FILTER_SUPPORT_PX if border < FILTER_SUPPORT_PX else 0)
            pixels = np.array(atlas.picture(faces))
            if not self._flat:
                more = (1 << (self._channels - 1).bit_length()) - self._channels  # read as one word
                pixels = np.pad(pixels, ((0, 0), (0, 0), (0, more)))
            self._of_views = torch.from_numpy(atlas.levels[0].corners.astype(np.int32)).to(device)
        else:
            self._of_views = torch.tensor([v.projection for v in views], dtype=torch.float64, device=device)
        self.tensor = torch.from_numpy(pixels.view(np.uint8) if pixels.dtype == bool else pixels).to(device)

    def sample(self, lookup: DeviceLookup) -> Tensor:
        """Return (B, N) or (B, C, N) values, whole numbers of maps as int64; 0 if no view sees the ray."""
        from omniscv.torch import kernels

        (batch, count) = lookup.shape
        dtype = self.tensor.dtype
        channels = self._channels
        whole = not dtype.is_floating_point
        kind = torch.int64 if self._flat and whole else dtype
        out = torch.empty((batch, channels, count), dtype=kind, device=self.tensor.device)
        arguments = (self.tensor, self._of_views, *lookup.arrays, out)
        shape = self.tensor.shape
        if self._kind == "blended":
            step = 1 if self._flat else shape[2]
            constants = kernels.OPTIONS | {"CHANNELS": channels, "STEP": step, "ROUND": whole}
            lookup.launch(kernels.blend, *arguments, sizes=(shape[1],), **constants)
        else:
            constants = kernels.OPTIONS | {"CHANNELS": channels, "ALONG": self._kind == "surface"}
            lookup.launch(kernels.take, *arguments, sizes=(shape[2], shape[1]), **constants)
        return out[:, 0] if self._flat else out


class ProcessorLookup:
    """The views and points of a camera's rays in B orientations, found by the kernels of composition.

    Args:
        camera: central.
        views: which share their centre and size.
        R_w_c: (B, 3, 3) camera to world.

    Attributes:
        views: as given.
        samplers: one for each orientation.
        unseen: how many valid rays no view sees, in all orientations.
    """

    def __init__(self, camera: Camera, views: tuple[View, ...], R_w_c: Array) -> None:
        self.views = views
        rays = _rays_of(camera)
        self.samplers = [Sampler(rays.blocks, R, views) for R in R_w_c]
        self.unseen = sum(sampler.unseen for sampler in self.samplers)


class ProcessorTiles:
    """The pixels of a modality in all views, sampled by a :class:`ProcessorLookup`.

    Args:
        interpolation: how values between pixels are found.
        views: which share their centre and size.
        faces: the pixels of each view.

    Attributes:
        tensor: the stacked pixels of all views.
    """

    def __init__(self, interpolation: Interpolation, views: Sequence[View], faces: Pictures) -> None:
        stack: Any = np.stack(faces)
        self._interpolation = interpolation
        self._stack = stack
        self.tensor = torch.from_numpy(stack)
        if interpolation == "surface":
            self._depth = DepthPictures.of(stack, views, Precision(), stack.size)

    def sample(self, lookup: ProcessorLookup) -> Tensor:
        """Return what :meth:`DeviceTiles.sample` does."""
        kind = self._interpolation
        stack = self._stack
        filter = "bilinear" if kind == "blended" else "nearest"
        values = []
        for sampler in lookup.samplers:
            if kind == "surface":
                values.append(sampler.sample_depth("nearest", self._depth, None).distance)
            else:
                values.append(SAMPLE[kind](sampler, filter, stack))
        found = torch.from_numpy(np.stack(values))
        if found.ndim == 3:
            return found.movedim(-1, 1).contiguous()
        return found if found.dtype.is_floating_point else found.long()


@lru_cache(maxsize=4)
def _rays_of(camera: Camera) -> ImageRays:
    return ImageRays(camera)
