"""What mirrors of revolution have in common when a perspective camera looks at them along the axis.

The camera stands at the origin and looks along +z at the mirror. Everything happens in the plane
through the axis that holds the pixel: a radius ``r`` (distance from the image's centre over the
focal length) gives a ray that leaves the axis at height ``z_r`` and the angle ``phi`` from +z. A model
says how radius and ray belong together; azimuth, image circle and viewpoints are the same for all.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from omniscv.cameras.base import Array, Mask, Viewpoints, polar
from omniscv.cameras.radial import CircleCamera


class MeridianRays(NamedTuple):
    """Rays in the half-plane of their azimuth: ``(0, z_r) + s (sin_phi, cos_phi)`` in (rho, z)."""

    z_r: Array
    sin_phi: Array
    cos_phi: Array


class NoncentralMirror(CircleCamera):
    """A mirror of revolution under a perspective camera.

    Rays. ``origins`` are the optical centres, where the line of the ray meets the axis: within the
    mirror, or before it for rays that nearly graze a ball. The light that makes the pixel comes in along
    the line outside the mirror, up to its surface; so ``project`` finds no pixel for points within the
    mirror, and for a point outside it exactly the pixel where the mirror shows it.
    """

    central = False

    def _default_focal(self) -> float:
        return self.width / 2

    # -- what a model says ----------------------------------------------------------------------

    @abstractmethod
    def _reflect(self, r: Array) -> MeridianRays:
        """The rays of normalised radii 0 <= r <= edge; NaN where there is none."""

    @abstractmethod
    def _radius_seeing(self, rho: Array, z: Array) -> Array:
        """The normalised radius whose ray comes from a point at rho >= 0; NaN where there is none."""

    # -- common to all --------------------------------------------------------------------------

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask]:
        r_px, cos_a, sin_a = polar(pixels, self.center)
        z_r, sin_phi, cos_phi = self._reflect(np.minimum(r_px / self.focal, self._edge()))
        directions = np.stack([sin_phi * cos_a, sin_phi * sin_a, cos_phi], axis=-1)
        origins = np.zeros_like(directions)
        origins[..., 2] = z_r
        return origins, directions, (r_px <= self._reach_px) & np.isfinite(cos_phi)

    def _project(self, points: Array) -> tuple[Array, Mask]:
        rho, cos_a, sin_a = polar(points[..., :2], np.zeros(2))
        return self._place(self._radius_seeing(rho, points[..., 2]), cos_a, sin_a)

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """One centre per ring of a pixel's width, or at most ``count`` in equal steps of height.

        Ring k holds the pixels with k <= r < k + 1; with ``count`` the rings are as wide as an equal
        step of ``z_r``, so that no pixel is displaced by more than half a step, and steps that hold no
        pixel are left out. A shared centre is midway between the lowest and the highest of its pixels.
        Rings of a pixel's width are off by half of what ``z_r`` changes over a pixel, little in most of
        the image (0.3 mm for a mirror 0.3 m away, 256 px) but centimetres in the last ring of a ball
        seen to its edge. There ``z_r`` comes back down, so that an equal step may hold two rings.
        """
        if count is not None:
            count = self._whole_number("count", count, "viewpoints")
        rays = self.unproject()
        height = rays.origins[rays.valid][:, 2]
        ring = np.floor(polar(self.pixels()[rays.valid], self.center)[0])
        if count is not None and count < len(np.unique(ring)):
            step = max(np.ptp(height) / count, np.finfo(np.float64).tiny)
            ring = np.minimum(np.floor((height - height.min()) / step), count - 1)
        used, group = np.unique(ring, return_inverse=True)
        lowest, highest = np.full(len(used), np.inf), np.full(len(used), -np.inf)
        np.minimum.at(lowest, group, height)
        np.maximum.at(highest, group, height)
        centers = np.zeros((len(used), 3))
        centers[:, 2] = (lowest + highest) / 2
        index = np.full(rays.valid.shape, -1, dtype=np.int32)
        index[rays.valid] = group
        return Viewpoints(centers, index)
