"""What calibrated lenses have in common: a radius by angle, then distortion, focal lengths and skew.

A point at the angle theta from +z and the azimuth a has the place ``(r cos a, r sin a)`` in the plane, with
the model's own r(theta); distortion moves it there; the matrix and the principal point make it a pixel.
"""

from abc import abstractmethod
from typing import Any

import numpy as np

from omniscv.arguments import number, optional_number
from omniscv.cameras.base import Array, CentralCamera, Mask
from omniscv.cameras.distortion import Distortion
from omniscv.cameras.optics import polar, sin_cos_of_half
from omniscv.cameras.radial import ROUNDING, Meridian, rays_about_axis


class Lens(CentralCamera):
    """A camera of revolution about +z behind a matrix and, if there is one, a distortion.

    Domain. What the model has: angles up to ``_theta_end``, radii up to ``_r_end``; less where the field of
    view ``fov_deg`` is limited, or where the distortion turns back.
    """

    _A: Array  # (2, 2) px: from the plane to the image
    _theta_end: float = np.pi
    _r_end: float = np.inf
    _distortion: Distortion | None = None

    def _see_through(self, fov_deg: float | None) -> None:
        """End the domain; the matrix and the model's own numbers are already set."""
        self.fov_deg = optional_number("fov_deg", fov_deg, above=0, most=360)
        self._rounding = self._pixel_rounding / float(np.linalg.svd(self._A, compute_uv=False)[-1])
        beyond = 2.0 * self._farthest_corner()
        if self.fov_deg is not None and np.radians(self.fov_deg) / 2 < self._theta_end:
            self._theta_end = float(np.radians(self.fov_deg) / 2)
            across, along = sin_cos_of_half(self.fov_deg)
            self._r_end = min(self._r_end, float(self._radius(np.array(across), np.array(along))))
        if self._distortion is None:
            self._r_end = min(self._r_end, beyond)
        else:
            self._r_end = self._distortion.ending(self._r_end, beyond, self._rounding)
            across, along, _ = self._meridian(np.array(self._r_end))
            self._theta_end = min(self._theta_end, float(np.arctan2(across, along)))

    def _farthest_corner(self) -> float:
        """The radius in the plane of the image's farthest corner; infinity if the matrix is singular."""
        corners = np.array([[0, 0], [self.width, 0], [0, self.height], [self.width, self.height]])
        try:
            return float(np.hypot(*np.linalg.solve(self._A, (corners - self.center).T)).max())
        except np.linalg.LinAlgError:
            return np.inf

    @abstractmethod
    def _meridian(self, r: Array) -> Meridian:
        """The rays of radii 0 <= r <= ``_r_end`` in the plane; directions unit."""

    @abstractmethod
    def _radius(self, across: Array, along: Array) -> Array:
        """The radius in the plane of a unit direction within ``_theta_end``."""

    def _plane(self) -> tuple[float, ...]:
        """What takes a pixel's offset to the plane: see ``kernels.in_plane``."""
        return (*np.linalg.inv(self._A).ravel().tolist(), 1.0, 1.0)

    def _directions(self, pixels: Array) -> tuple[Array, Mask]:
        from omniscv.cameras import kernels  # slow to load

        center, plane = tuple(self.center.tolist()), self._plane()

        def find(some: Array, found: Any) -> int:
            if self._distortion is None:
                return int(kernels.polar_within(some, center, plane, self._r_end, found))
            return int(kernels.undistorted_within(some, center, plane, self._distortion.solver, found))

        directions, _, valid = rays_about_axis(pixels, find, self._meridian)
        return directions, valid

    def _project(self, points: Array) -> tuple[Array, Mask]:
        rho, cos_a, sin_a = polar(points[..., :2])
        z = points[..., 2]
        seen = np.arctan2(rho, z) <= self._theta_end * (1 + ROUNDING)
        distance = np.hypot(rho, z)
        r = self._radius(rho / distance, z / distance)
        # Inside the end by what rounding may add, so that the pixel that comes out is one that has a ray.
        r = np.minimum(r, max(min(self._r_end * (1 - 0.1 * ROUNDING), self._r_end - self._rounding), 0.0))
        plane = np.stack([r * cos_a, r * sin_a], axis=-1)
        if self._distortion is not None:
            plane = self._distortion.apply(plane)
        return self.center + plane @ self._A.T, seen & (r >= 0)


class FocalLens(Lens):
    """A lens by ``u = cx + fx (x + skew y)``, ``v = cy + fy y``, (x, y) in the plane."""

    def _see_through_focal(
        self, fx: float, fy: float, cx: float | None, cy: float | None, skew: float, fov_deg: float | None
    ) -> None:
        self.fx, self.fy = number("fx", fx, above=0), number("fy", fy, above=0)
        self.cx = number("cx", self.width / 2 if cx is None else cx)
        self.cy = number("cy", self.height / 2 if cy is None else cy)
        self.skew = number("skew", skew)
        self.center = np.array([self.cx, self.cy])
        self._A = np.array([[self.fx, self.fx * self.skew], [0.0, self.fy]])
        self._see_through(fov_deg)

    def _plane(self) -> tuple[float, ...]:
        return (1.0, -self.fx * self.skew / self.fy, 0.0, 1.0, self.fx, self.fy)
