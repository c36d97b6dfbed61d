"""The pixels of a camera, grouped by the optical centre that they share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera, Rays
from omniscv.geometry import Array
from omniscv.parallel import blocks


@dataclass(frozen=True, eq=False)
class Group:
    """Pixels that share an optical centre.

    Attributes:
        center_c: (3,) camera frame, metres.
        pixels: (N,) int64 flat indices of valid pixels, row-major.
        directions: (N, 3) their unit rays, camera frame.
    """

    center_c: Array
    pixels: NDArray[np.int64]
    directions: Array


@lru_cache(maxsize=2)
def rays_of(camera: Camera) -> Rays:
    """Every pixel's ray; kept for the last two cameras, because a sequence asks again for each image."""
    return unproject(camera, camera.pixels())


def unproject(camera: Camera, pixels: Array) -> Rays:
    """The rays of (H, W, 2) pixels, rows shared out among the cores."""
    parts = blocks(lambda rows: camera.unproject(pixels[rows]), len(pixels), pixels[..., 0].size)
    return Rays(*(np.concatenate([getattr(p, f) for p in parts]) for f in ("origins", "directions", "valid")))


@lru_cache(maxsize=2)
def pixel_groups(camera: Camera, viewpoints: int | None) -> tuple[Group, ...]:
    """The valid pixels by optical centre; centres that serve none are left out.

    Args:
        camera: the model.
        viewpoints: how many centres a non-central camera is given; one per column or ring if None.
    """
    shared = camera.viewpoints(viewpoints)
    rays = rays_of(camera)
    directions = rays.directions.reshape(-1, 3)
    if len(shared.centers) == 1:
        pixels = np.flatnonzero(rays.valid)
        mine = directions if len(pixels) == len(directions) else directions[pixels]
        return (Group(shared.centers[0], pixels, mine),) if len(pixels) else ()
    order = np.argsort(shared.index, axis=None, kind="stable")
    starts = np.searchsorted(shared.index.ravel()[order], np.arange(len(shared.centers) + 1))
    return tuple(
        Group(center_c, order[start:end], directions[order[start:end]])
        for center_c, start, end in zip(shared.centers, starts[:-1], starts[1:], strict=True)
        if end > start
    )
