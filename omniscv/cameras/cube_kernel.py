"""The rays of a cube map's pixels; in a module of its own because numba is slow to load."""

from typing import Any

import numpy as np

from omniscv.cameras.radial import ROUNDING
from omniscv.compiled import njit

_INSIDE = 2e-15
"""What keeps a ray off a face's edge, that it be seen in the slot of its own pixel; of the face's half."""


@njit(cache=True, nogil=True)
def cast(
    pixels: Any, grid: Any, slot_px: Any, padding: int, equiangular: bool,
    face: Any, axes: Any, rays: Any, valid: Any,
) -> None:  # fmt: skip
    """Write the unit rays (N, 3) of pixels (N, 2), and which lie in a slot with a face."""
    row_px, edge = slot_px[1] + 2 * padding, 1 - _INSIDE
    a = np.empty(2)
    for i in range(pixels.shape[0]):
        row = min(max(np.floor(pixels[i, 1] / row_px), 0), grid[1] - 1)
        a[0], a[1] = pixels[i, 0] - padding, pixels[i, 1] - row * row_px - padding
        column = min(max(np.floor(a[0] / slot_px[0]), 0), grid[0] - 1)
        a[0] -= column * slot_px[0]
        for k in range(2):
            a[k] = 2 * a[k] / slot_px[k] - 1
            # Beyond a face's edges, in the padding, its plane goes on.
            if not (padding > 0 and abs(a[k]) > 1 + ROUNDING):
                a[k] = min(max(a[k], -edge), edge)
            if equiangular:
                a[k] = np.tan(np.pi / 4 * a[k])
        z = 1 / np.sqrt(1 + a[0] * a[0] + a[1] * a[1])
        slot = int(row * grid[0] + column)
        valid[i] = face[slot] >= 0
        for k in range(3):
            rays[i, k] = z * (axes[slot, k, 0] * a[0] + axes[slot, k, 1] * a[1] + axes[slot, k, 2])
