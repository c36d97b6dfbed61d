"""Lines in space that fit their image best, in pixels.

A pixel's distance from a line's image is, to first order, the incidence of its ray with the line over the
length of that incidence's gradient in the image (Sampson's distance). It needs nothing of a camera but its
rays, so that it is the same for panoramas and mirrors.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from omniscv.cameras import Camera
from omniscv.evaluate.lines import plucker
from omniscv.geometry.pose import Array

_STEP_PX = 0.05  # of the differences that are the gradient
_ROBUST_PX = 0.3


class ObservedLine:
    """Pixels that show a line.

    Args:
        camera: what sees them.
        pixels: (N, 2) px, each with a ray, also half a step beside it.

    Attributes:
        pixels: as given, those with rays.
        origins, directions: (N, 3) of their rays, camera frame.
        rows: (N, 6) of their rays: :func:`omniscv.evaluate.lines.plucker.incidence`.
        gradients: (N, 2, 6) the derivatives of the rows by the pixel.
    """

    def __init__(self, camera: Camera, pixels: Array) -> None:
        steps = _STEP_PX * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
        rays = camera.unproject(pixels[:, None] + steps)
        seen = rays.valid.all(axis=1)
        rows = plucker.incidence(rays.origins, rays.directions)[seen]
        self.pixels, self.rows = pixels[seen], rows[:, 0]
        self.origins, self.directions = rays.origins[seen, 0], rays.directions[seen, 0]
        self.gradients = (rows[:, 1::2] - rows[:, 2::2]) / (2 * _STEP_PX)  # (N, 2, 6)

    def distances_px(self, line: Array) -> Array:
        """Return (N,) px, signed, of the pixels from the image of a line (6,)."""
        return np.asarray(self.rows @ line / np.linalg.norm(self.gradients @ line, axis=-1))

    def rms_px(self, line: Array) -> float:
        """Return the root of the mean square of :meth:`distances_px`."""
        return float(np.sqrt((self.distances_px(line) ** 2).mean()))

    def refined(self, line: Array, turns: Array) -> Array:
        """Return the line (6,) near another one whose image fits the pixels best.

        Args:
            line: (6,) of unit direction.
            turns: (K, 3) orthonormal, across the direction: where it may turn; two if it is free, one if it
                is level, none if it is known.
        """
        moved = self.moves(line, turns)

        def residuals(x: Array) -> Array:
            return self.distances_px(moved(x))

        robust: dict[str, Any] = {"loss": "soft_l1", "f_scale": _ROBUST_PX}
        found = least_squares(residuals, np.zeros(2 + len(turns)), x_scale="jac", xtol=1e-12, **robust)
        return moved(found.x)

    def moves(self, line: Array, turns: Array) -> Callable[[Array], Array]:
        """Return how a line is moved by (2 + K,) numbers: metres across it where the pixels see it, and
        tangents of its turns. Args as of :meth:`refined`."""
        middle = plucker.nearest_to_rays(line, self.origins, self.directions).mean(axis=0)
        across = np.linalg.svd(line[None, :3])[2][1:]

        def moved(x: Array) -> Array:
            return plucker.through(middle + x[:2] @ across, line[:3] + x[2:] @ turns)

        return moved
