"""Mirrors of revolution under a perspective camera that looks at them along the axis.

The camera is at the origin and looks along +z at the mirror. In the half-plane through the axis and the pixel
a radius ``r`` (distance from the image's centre divided by the focal length) gives a ray that meets the axis
at height ``z_r`` at the angle ``phi`` from +z.
"""

from typing import Any, ClassVar

import numpy as np

from omniscv.arguments import number, optional_number, whole_number
from omniscv.cameras.base import FARTHEST, Array, Viewpoints, polar
from omniscv.cameras.distortion import increasing_root
from omniscv.cameras.radial import CircleCamera, Meridian
from omniscv.cameras.registry import register
from omniscv.geometry.arrays import ROUNDING

_BLOCK = 1 << 14  # points per block: its arrays fit the processor's cache


class NoncentralMirror(CircleCamera):
    """A mirror of revolution under a perspective camera.

    Rays: ``origins`` are the optical centres, where the line of a ray meets the axis: inside the mirror, or
    in front of it for rays that nearly graze a ball. Light arrives along the line from outside, up to the
    mirror's surface. So ``project`` finds no pixel for points inside the mirror, and for a point outside it
    the pixel where the mirror shows it.
    """

    central = False
    typical_pitch_deg = 90.0

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """Return one centre per ring of a pixel's width, or at most ``count`` in equal steps of height.

        Ring k holds the pixels with k <= r < k + 1. With ``count`` the centre of a pixel moves by at most
        half a step of ``z_r``; steps without pixels are left out. A shared centre is midway between the
        lowest and the highest of its pixels: off by half of the change of ``z_r`` over a pixel, which is
        centimetres in the last ring of a ball seen to its edge.
        """
        rays = self.unproject()
        height = rays.origins[rays.valid][:, 2]
        ring = np.floor(polar(self.pixels()[rays.valid], self.center)[0])
        if count is not None and whole_number("count", count, "viewpoints") < len(np.unique(ring)):
            step = max(np.ptp(height) / count, np.finfo(np.float64).tiny)
            ring = np.minimum(np.floor((height - height.min()) / step), count - 1)
        used, group = np.unique(ring, return_inverse=True)
        lowest = np.full(len(used), np.inf)
        highest = np.full(len(used), -np.inf)
        np.minimum.at(lowest, group, height)
        np.maximum.at(highest, group, height)
        centers = np.zeros((len(used), 3))
        centers[:, 2] = (lowest + highest) / 2
        index = np.full(rays.valid.shape, -1, dtype=np.int32)
        index[rays.valid] = group
        return Viewpoints(centers, index)


@register
class NoncentralSphericalMirror(NoncentralMirror):
    """A perspective camera that looks at a mirror ball.

    With the camera ray at alpha from the axis, ``tan alpha = r``, and the angle of incidence i,
    ``sin i = Z sin alpha``, ``Z = Z_s / R_s``, ``Z_s = Z_m + R_s``: the ray goes off at
    ``phi = pi - 2i + alpha`` from +z and crosses the axis at ``Z_r = Z_s (1 - sin alpha / sin(2i - alpha))``.
    This is the paper's zeta, delta, epsilon without their 0/0 at r = 0; its gamma >= 0 is i <= 90 deg.
    Parameters: ``mirror_radius`` R_s > 0 and ``distance`` Z_m > 0 to the ball's nearest point, metres;
    ``focal`` px (default width / 2) or ``fov_deg``, twice the angle from -z of the last ray.
    Domain: ``r <= 1 / sqrt(Z^2 - 1)``, where the camera's ray grazes the ball.
    Source: OmniSCV, eq. of the spherical mirror (Agrawal and Ramalingam 2013); ``project`` solves
    Alhazen's problem.
    """

    name = "noncentral-spherical-mirror"
    typical: ClassVar = {"mirror_radius": 0.3, "distance": 0.3, "fov_deg": 280}

    def __init__(
        self, width: int, height: int, *, mirror_radius: float, distance: float, **circle: Any
    ) -> None:
        self.mirror_radius = number("mirror_radius", mirror_radius, above=0, most=FARTHEST)
        self.distance = number("distance", distance, least=1 / FARTHEST, most=FARTHEST)
        self._z_s = self.distance + self.mirror_radius
        # Z^2 - 1 as a product: exact for a camera close to the ball.
        beyond = np.sqrt(self.distance * (self.distance + 2 * self.mirror_radius))
        self._edge = float(self.mirror_radius / beyond)
        super().__init__(width, height, **circle)

    def _meridian(self, t: Array) -> Meridian:
        ratio = self._z_s / self.mirror_radius
        part = t / self._edge
        cos_alpha = 1 / np.hypot(1.0, t)
        sin_alpha = t * cos_alpha
        cos_i = np.sqrt((1 - part) * (1 + part)) * cos_alpha
        # sin(2i - alpha) / sin(alpha) - 1 >= 0, without cancellation.
        excess = 2 * cos_i / (self._edge**2 * (ratio * cos_alpha + cos_i))
        across = sin_alpha * (1 + excess)
        along = -((2 * cos_i**2 - 1) * cos_alpha + 2 * ratio * sin_alpha**2 * cos_i)
        return Meridian(across, along, self._z_s * excess / (1 + excess))

    def _radius_seeing(self, rho: Array, z: Array) -> Array:
        from_ball = np.hypot(rho, self._z_s - z)
        closeness = self.mirror_radius / from_ball
        point = self._reflection_point((self._z_s - z) / from_ball, rho / from_ball, closeness)
        if self.mirror_radius <= 1e3 * self.distance:
            return self._radius_of(point)
        # Points this close to so large a ball are lost in rounding.
        return np.where(closeness <= 1 - 1e-10, self._radius_of(point), np.nan)

    def _radius_of_fov(self, fov_deg: float) -> float:
        limit = 360 - 2 * float(np.degrees(np.arcsin(self.mirror_radius / self._z_s)))
        fov_deg = number("fov_deg", fov_deg, above=0, most=limit)
        half = np.radians(np.array([fov_deg / 2]))  # the direction of a point at infinity
        t = self._reflection_point(np.cos(half), np.sin(half), np.zeros(1))
        return float(self._radius_of(t)[0])

    def _radius_of(self, t: Array) -> Array:
        """Return the radius at which the camera sees the ball's point ``2 atan t`` from the nearest one."""
        depth = self.distance * (1 + t**2) + 2 * self.mirror_radius * t**2
        return np.asarray(2 * self.mirror_radius * t / depth)

    def _reflection_point(self, cos_psi: Array, sin_psi: Array, closeness: Array) -> Array:
        """Return t = tan(beta / 2) of the ball's point at which a point is reflected; NaN if it is not seen.

        From the ball's centre the point is at psi from the camera and the reflection at beta; ``closeness``
        is the ball's radius divided by the point's distance. Equal angles of incidence mean ``sin(beta)
        (cos(psi - beta) - closeness) = sin(psi - beta) (cos(beta) - R_s / Z_s)``, a quartic in t with one
        root between 0 and psi; the camera sees it up to the grazing ring.
        """
        t = np.full(cos_psi.shape, np.nan)
        flat = (cos_psi.ravel(), sin_psi.ravel(), closeness.ravel())
        m = self.distance / self._z_s
        grazing = np.sqrt(m / (2 - m))
        for start in range(0, t.size, _BLOCK):
            block = slice(start, start + _BLOCK)
            p, q, k = (values[block] for values in flat)
            limit = np.where(p > 0, np.minimum(grazing, q / (1 + p)), grazing)
            above_horizon = (p - k) + 2 * q * limit - (p + k) * limit**2 >= -ROUNDING
            seen = above_horizon & (k <= 1 + ROUNDING)
            p = p[seen]
            q = q[seen]
            k = np.minimum(k[seen], 1.0)
            quartic = (-m * q, 2 * (p * (1 + m) - k), 6 * q, -2 * (p * (3 - m) + k), -(2 - m) * q)
            t.reshape(-1)[block][seen] = increasing_root(
                lambda t, c0, c1, c2, c3, c4: (((c4 * t + c3) * t + c2) * t + c1) * t + c0,
                np.zeros_like(q), limit[seen], *quartic,
            )  # fmt: skip
        return t


@register
class NoncentralConicalMirror(NoncentralMirror):
    """A perspective camera that looks at the tip of a cone.

    ``R_c = Z_m sin 2tau``, ``Z_c = Z_m (1 - cos 2tau)``, ``cot phi = (1 + r tan 2tau) / (tan 2tau - r)``,
    ``Z_r = Z_c + R_c cot phi``; origin ``(0, 0, Z_r)``, direction ``(sin phi cos a, sin phi sin a, cos phi)``
    at azimuth a.
    Parameters: ``half_angle_deg`` tau between axis and surface, 0 < tau < 90; ``distance`` Z_m > 0 from
    the camera to the tip, metres; ``focal`` px (default width / 2) or ``fov_deg``, twice the angle from
    -z of the last ray; ``mirror_radius`` of the cone's rim, metres, infinite if not given.
    Domain: 0 < r < tan tau (beyond, the cone is missed; the tip itself has no normal), r up to the rim.
    Source: OmniSCV, table of Z_r and cot phi. Multiplied by cos 2tau here: nothing special at 45 degrees.
    """

    name = "noncentral-conical-mirror"
    typical: ClassVar = {"half_angle_deg": 55.0, "distance": 0.3}

    def __init__(
        self,
        width: int,
        height: int,
        *,
        half_angle_deg: float,
        distance: float,
        mirror_radius: float | None = None,
        **circle: Any,
    ) -> None:
        self.half_angle_deg = number("half_angle_deg", half_angle_deg, above=0, below=90)
        self.distance = number("distance", distance, above=0, most=FARTHEST)
        self.mirror_radius = optional_number("mirror_radius", mirror_radius, above=0)
        # cos as the sine of the complement: radians of nearly 90 degrees have lost digits.
        sin, cos = np.sin(np.radians([self.half_angle_deg, 90 - self.half_angle_deg])).tolist()
        self._sin = sin
        self._cos = cos
        self._sin2 = 2 * sin * cos
        self._cos2 = (cos - sin) * (cos + sin)
        rim = self.mirror_radius
        if rim is None:
            self._edge = float(np.nextafter(sin / cos, 0))
        else:
            self._edge = float(rim * sin / (self.distance * sin + rim * cos))
        super().__init__(width, height, **circle)

    def _meridian(self, t: Array) -> Meridian:
        r = np.where(t > 0, t, np.nan)
        across = self._sin2 - r * self._cos2
        along = self._cos2 + r * self._sin2
        length = np.hypot(1.0, r)  # of (across, along), too
        return Meridian(across / length, along / length, self.distance * (1 + r / across))

    def _radius_seeing(self, rho: Array, z: Array) -> Array:
        """Project the point's mirror image in the cone's side."""
        h = z - self.distance
        x_image = h * self._sin2 - rho * self._cos2
        z_image = h * self._cos2 + rho * self._sin2 + self.distance
        outside = rho * self._cos - h * self._sin >= -ROUNDING * (rho + np.abs(h))
        seen = outside & (rho > 0) & (x_image > 0) & (z_image > 0)
        return np.where(seen, x_image / z_image, np.nan)

    def _radius_of_fov(self, fov_deg: float) -> float:
        """Accept angles between 360 - 4 tau, at the tip, and 360 - 2 tau, along the cone's side."""
        tip = 360 - 4 * self.half_angle_deg
        side = 360 - 2 * self.half_angle_deg
        fov_deg = number("fov_deg", fov_deg, above=tip, below=side)
        return float(np.tan(np.radians((fov_deg - tip) / 2)))
