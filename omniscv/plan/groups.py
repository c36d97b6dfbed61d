"""The pixels of a camera, grouped by the optical centre that they share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera, Rays
from omniscv.geometry import Array


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
    return camera.unproject()


@lru_cache(maxsize=2)
def pixel_groups(camera: Camera, viewpoints: int | None) -> tuple[Group, ...]:
    """The valid pixels by optical centre; centres that serve none are left out.

    Args:
        camera: the model.
        viewpoints: how many centres a non-central camera is given; one per column or ring if None.
    """
    shared = camera.viewpoints(viewpoints)
    directions = rays_of(camera).directions.reshape(-1, 3)
    order = np.argsort(shared.index, axis=None, kind="stable")
    starts = np.searchsorted(shared.index.ravel()[order], np.arange(len(shared.centers) + 1))
    return tuple(
        Group(center_c, order[start:end], directions[order[start:end]])
        for center_c, start, end in zip(shared.centers, starts[:-1], starts[1:], strict=True)
        if end > start
    )
