"""Cameras of revolution: lenses and mirrors by focal length within an image circle, and calibrated lenses.

A model relates the radius in the image, divided by the focal length, to the ray's angle from the axis. All of
them turn radii into rays in the half-plane of the azimuth, :class:`Meridian`, and then about the axis.
"""

from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import number, optional_number
from omniscv.cameras.base import (
    Array,
    Camera,
    CentralCamera,
    Mask,
    polar,
    refuse_focal_and_fov,
    sin_cos_of_half,
)
from omniscv.cameras.distortion import Distortion
from omniscv.geometry.arrays import ROUNDING

BEFORE_TURN = 1 - 1e-7
"""Fraction of the radius where rays turn back up to which float64 separates the rays of pixels to 1e-6 px."""
_BLOCK = 1 << 13  # pixels per block: its arrays fit the processor's cache


class Meridian(NamedTuple):
    """Rays in the half-plane (rho, z) of their azimuth: ``(0, z) + s (across, along)``."""

    across: Array
    along: Array
    z: Array | float = 0.0


def rays_about_axis(
    pixels: Array, find: Callable[[Array, Any], int], meridian: Callable[[Array], Meridian]
) -> tuple[Array, Array, Mask]:
    """Return unit directions (..., 3), heights z (...) where they leave the axis, and valid (...) of pixels.

    Args:
        pixels: (..., 2) px.
        find: writes indices, radii and azimuths of the pixels in the domain and returns their number, see
            ``camera_kernels.polar_within``.
        meridian: returns the rays of radii in the half-plane of their azimuth.
    """
    from omniscv.cameras import camera_kernels  # slow to load

    flat = np.require(pixels.reshape(-1, 2), requirements=("C", "W"))
    directions = np.empty((len(flat), 3))
    heights = np.zeros(len(flat))
    valid = np.zeros(len(flat), dtype=bool)
    inside = np.empty(_BLOCK, dtype=np.int64), *np.empty((3, _BLOCK))
    for start in range(0, len(flat), _BLOCK):
        block = slice(start, start + _BLOCK)
        count = find(flat[block], inside)
        index, r, cos_a, sin_a = inside
        index = index[:count]
        across, along, z = meridian(r[:count])
        camera_kernels.turn(
            index, across, along, cos_a[:count], sin_a[:count], directions[block], valid[block]
        )
        heights[block][index] = z
    shape = pixels.shape[:-1]
    return directions.reshape(*shape, 3), heights.reshape(shape), valid.reshape(shape)


class CircleCamera(Camera):
    """A camera of revolution about z with a focal length and an image circle.

    Domain: ``0 <= r <= min(width, height) / 2`` px, within that of the model.
    """

    _edge: float = np.inf  # the model's last normalised radius; set before this constructor
    _default_fov_deg: float | None = None  # if None, the default is a focal length of half the width

    def __init__(
        self,
        width: int,
        height: int,
        focal: float | None = None,
        fov_deg: float | None = None,
        center: ArrayLike | None = None,
    ) -> None:
        super().__init__(width, height, center)
        refuse_focal_and_fov(focal, fov_deg)
        circle = min(self.width, self.height) / 2
        if focal is None and fov_deg is None:
            fov_deg = self._default_fov_deg
        if fov_deg is not None:
            self.focal = float(np.divide(circle, self._radius_of_fov(fov_deg)))
        else:
            self.focal = number("focal", self.width / 2 if focal is None else focal, above=0)
        self._reach_px = min(circle, self.focal * self._edge)

    @abstractmethod
    def _radius_of_fov(self, fov_deg: float) -> float:
        """Return the normalised radius of the ray ``fov_deg / 2`` off the axis; check the angle."""

    @abstractmethod
    def _meridian(self, t: Array) -> Meridian:
        """Return the rays of normalised radii 0 <= t <= edge, directions unit; NaN if there is none."""

    @abstractmethod
    def _radius_seeing(self, rho: Array, z: Array) -> Array:
        """Return the normalised radius that sees a point at rho >= 0; NaN if there is none."""

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask]:
        from omniscv.cameras import camera_kernels  # slow to load

        center = tuple(self.center.tolist())
        plane = (1.0, 0.0, 0.0, 1.0, 1.0, 1.0)
        find = partial(camera_kernels.polar_within, center, plane, self._reach_px)

        def meridian(r_px: Array) -> Meridian:
            return self._meridian(np.minimum(r_px / self.focal, self._edge))

        directions, heights, valid = rays_about_axis(pixels, find, meridian)
        origins = np.zeros(directions.shape)
        if not self.central:
            origins[..., 2] = heights
        return origins, directions, valid

    def _project(self, points: Array) -> tuple[Array, Mask]:
        rho, cos_a, sin_a = polar(points[..., :2])
        r_px = self.focal * self._radius_seeing(rho, points[..., 2])
        seen = r_px <= self._reach_px * (1 + ROUNDING)  # False for NaN
        # Inside the edge by the rounding error, so that the returned pixel has a ray.
        last = min(self._reach_px * (1 - 0.1 * ROUNDING), self._reach_px - self._pixel_rounding)
        r_px = np.minimum(r_px, max(last, 0.0))
        return self.center + np.stack([r_px * cos_a, r_px * sin_a], axis=-1), seen


class RadialCamera(CircleCamera):
    """A central camera of revolution."""

    @abstractmethod
    def _radius(self, across: Array, along: Array) -> Array:
        """Return the normalised radius that sees a unit direction; NaN if there is none."""

    def _radius_seeing(self, rho: Array, z: Array) -> Array:
        length = np.hypot(rho, z)
        return self._radius(rho / length, z / length)


class Lens(CentralCamera):
    """A calibrated lens: radius by angle, then a distortion of the plane, if any, and a matrix.

    A point at the angle theta from +z and the azimuth a has the coordinates ``(r cos a, r sin a)`` in the
    plane, with the model's r(theta); the distortion moves them; the matrix and the centre make a pixel.
    Domain: angles up to ``_theta_end``, radii up to ``_r_end``; the limit ``fov_deg`` and the turn of the
    distortion reduce both.
    """

    _A: Array  # (2, 2) px: from the plane to the image
    _theta_end: float = np.pi
    _r_end: float = np.inf
    _distortion: Distortion | None = None

    def __init__(self, width: int, height: int, cx: float | None = None, cy: float | None = None) -> None:
        super().__init__(width, height)
        self.cx = number("cx", self.width / 2 if cx is None else cx)
        self.cy = number("cy", self.height / 2 if cy is None else cy)
        self.center = np.array([self.cx, self.cy])

    def _set_domain(self, fov_deg: float | None) -> None:
        """Set the end of the domain; the matrix and the model's parameters are already set."""
        self.fov_deg = optional_number("fov_deg", fov_deg, above=0, most=360)
        least = np.linalg.svd(self._A, compute_uv=False)[-1] if np.isfinite(self._A).all() else np.float64(0)
        self._rounding = float(self._pixel_rounding / least)  # cameras refuse infinity
        beyond = 2.0 * self._farthest_corner()
        if self.fov_deg is not None and np.radians(self.fov_deg) / 2 < self._theta_end:
            self._theta_end = float(np.radians(self.fov_deg) / 2)
            across, along = sin_cos_of_half(self.fov_deg)
            self._r_end = min(self._r_end, float(self._radius(np.array(across), np.array(along))))
        if self._distortion is None:
            self._r_end = min(self._r_end, beyond)
        else:
            self._r_end = self._distortion.set_domain(self._r_end, beyond, self._rounding)
            across, along, _ = self._meridian(np.array(self._r_end))
            self._theta_end = min(self._theta_end, float(np.arctan2(across, along)))

    def _farthest_corner(self) -> float:
        """Return the radius of the image's farthest corner in the plane; infinity for a singular matrix."""
        corners = np.array([[0, 0], [self.width, 0], [0, self.height], [self.width, self.height]])
        try:
            return float(np.hypot(*np.linalg.solve(self._A, (corners - self.center).T)).max())
        except np.linalg.LinAlgError:
            return np.inf

    @abstractmethod
    def _meridian(self, r: Array) -> Meridian:
        """Return the rays of radii 0 <= r <= ``_r_end`` in the plane; directions unit."""

    @abstractmethod
    def _radius(self, across: Array, along: Array) -> Array:
        """Return the radius in the plane of a unit direction within ``_theta_end``."""

    def _plane(self) -> tuple[float, ...]:
        """Return the map from a pixel's offset to the plane: see ``camera_kernels.in_plane``."""
        return (*np.linalg.inv(self._A).ravel().tolist(), 1.0, 1.0)

    def _directions(self, pixels: Array) -> tuple[Array, Mask]:
        from omniscv.cameras import camera_kernels  # slow to load

        center = tuple(self.center.tolist())
        plane = self._plane()
        if self._distortion is None:
            find = partial(camera_kernels.polar_within, center, plane, self._r_end)
        else:
            find = partial(camera_kernels.undistorted_within, center, plane, self._distortion.solver)
        directions, _, valid = rays_about_axis(pixels, find, self._meridian)
        return directions, valid

    def _project(self, points: Array) -> tuple[Array, Mask]:
        rho, cos_a, sin_a = polar(points[..., :2])
        z = points[..., 2]
        seen = np.arctan2(rho, z) <= self._theta_end * (1 + ROUNDING)
        distance = np.hypot(rho, z)
        r = self._radius(rho / distance, z / distance)
        # Inside the end by the rounding error, so that the returned pixel has a ray.
        r = np.minimum(r, max(min(self._r_end * (1 - 0.1 * ROUNDING), self._r_end - self._rounding), 0.0))
        plane = np.stack([r * cos_a, r * sin_a], axis=-1)
        if self._distortion is not None:
            plane = self._distortion.apply(plane)
        return self.center + plane @ self._A.T, seen & (r >= 0)


class FocalLens(Lens):
    """A calibrated lens with ``u = cx + fx (x + skew y)``, ``v = cy + fy y``, (x, y) in the plane."""

    def __init__(
        self,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float | None = None,
        cy: float | None = None,
        skew: float = 0.0,
        fov_deg: float | None = None,
    ) -> None:
        """Set size, matrix and domain; a model's own parameters are set before."""
        super().__init__(width, height, cx, cy)
        self.fx = number("fx", fx, above=0)
        self.fy = number("fy", fy, above=0)
        self.skew = number("skew", skew)
        self._A = np.array([[self.fx, self.fx * self.skew], [0.0, self.fy]])
        self._set_domain(fov_deg)

    def _plane(self) -> tuple[float, ...]:
        return (1.0, -self.fx * self.skew / self.fy, 0.0, 1.0, self.fx, self.fy)
