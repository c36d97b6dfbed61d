"""Lenses in closed form: spheres or an ellipsoid seen from an eccentric centre, division, field of view."""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import number, numbers
from omniscv.cameras.base import Array
from omniscv.cameras.distortion import Distortion
from omniscv.cameras.lens_parameters import Parameters
from omniscv.cameras.radial import BEFORE_TURN, FocalLens, Meridian
from omniscv.cameras.registry import register
from omniscv.geometry.arrays import ROUNDING


@register
class DoubleSphere(FocalLens):
    """Two unit spheres, ``xi`` apart: of the point at (rho, z) off the axis and along it, 1 away,
    ``k = xi + z``, ``n = alpha sqrt(rho^2 + k^2) + (1 - alpha) k``, ``u = cx + fx (x + skew y) / n``.

    Parameters: ``fx``, ``fy`` px; ``cx``, ``cy`` px (default: the middle; pixel centres at +0.5);
    ``xi`` in (-1, 1] and ``alpha`` in [0, 1], no unit; ``skew``; ``fov_deg`` <= 360, an optional limit.
    Domain: ``k > -w sqrt(rho^2 + k^2)`` with w = alpha / (1 - alpha), or (1 - alpha) / alpha for alpha > 0.5,
    where n turns back: that is ``z > -w sqrt(1 - xi^2 s) - xi s``, s = 1 - w^2, and in the image
    ``r^2 <= 1 / (2 alpha - 1)``. The limit w2 that was published with the model is another one.
    Source: Usenko, Demmel and Cremers 2018, eq. 40 to 50; the domain is derived here.
    """

    name = "double-sphere"
    typical: ClassVar = {"xi": -0.2, "alpha": 0.6, "fov_deg": 195}
    typical_focal = 0.31
    lens = Parameters.of("fx fy | cx cy | skew xi alpha")

    def __init__(self, *size: Any, xi: float, alpha: float, **lens: Any) -> None:
        self.xi = number("xi", xi, above=-1, most=1)
        self.alpha = number("alpha", alpha, least=0, most=1)
        self._w, s, self._fold = _second_limit(self.alpha)
        t = _to_first_sphere(np.array(np.sqrt(s)), np.array(-self._w), self.xi)
        self._theta_end = float(np.arctan2(t * np.sqrt(s), -t * self._w - self.xi))
        self._r_end = self._fold or np.inf
        if self.xi == 1 and self.alpha > 0:  # seen from its surface the first sphere fills a half space
            self._r_end = float(np.nextafter(1 / self.alpha, 0))
        super().__init__(*size, **lens)

    def _meridian(self, r: Array) -> Meridian:
        height = _height(r, self.alpha, self._fold)
        t = _to_first_sphere(r, height, self.xi)
        return Meridian(t * r, t * height - self.xi)

    def _radius(self, across: Array, along: Array) -> Array:
        k = _sum(self.xi, across, along)
        d = np.hypot(across, k)
        # For xi near 1 the angle does not separate the end of the domain from straight back.
        r = _over(across, self.alpha * d + (1 - self.alpha) * k)
        return np.where((k >= -(self._w + ROUNDING) * d) & (d > 0), r, np.nan)  # d = 0: xi = 1, straight back


@register
class ExtendedUnified(FocalLens):
    """The ellipsoid ``beta (x^2 + y^2) + z^2 = 1`` seen from a point on its axis (EUCM):
    ``n = alpha sqrt(beta (x^2 + y^2) + z^2) + (1 - alpha) z``, ``u = cx + fx (x + skew y) / n``.

    Parameters: ``fx``, ``fy`` px; ``cx``, ``cy`` px (default: the middle; pixel centres at +0.5);
    ``alpha`` in [0, 1] and ``beta`` > 0, no unit; ``skew``; ``fov_deg`` <= 360, an optional limit.
    Domain: ``z > -w sqrt(beta (x^2 + y^2) + z^2)`` with w = alpha / (1 - alpha), or (1 - alpha) / alpha for
    alpha > 0.5, where n turns back; in the image ``r^2 <= 1 / (beta (2 alpha - 1))``.
    Source: Khomutenko, Garcia and Martinet 2016.
    """

    name = "extended-unified"
    typical: ClassVar = {"alpha": 0.62, "beta": 1.1, "fov_deg": 185}
    typical_focal = 0.33
    lens = Parameters.of("fx fy | cx cy | skew alpha beta")

    def __init__(self, *size: Any, alpha: float, beta: float, **lens: Any) -> None:
        self.alpha = number("alpha", alpha, least=0, most=1)
        self.beta = number("beta", beta, above=0)
        self._stretch = float(np.sqrt(self.beta))
        self._w, s, self._fold = _second_limit(self.alpha)
        self._theta_end = float(np.arctan2(np.sqrt(s), -self._w * self._stretch))
        self._r_end = self._fold / self._stretch if self._fold else np.inf
        super().__init__(*size, **lens)

    def _meridian(self, r: Array) -> Meridian:
        height = _height(self._stretch * r, self.alpha, self._fold)
        distance = np.hypot(r, height)
        return Meridian(r / distance, height / distance)

    def _radius(self, across: Array, along: Array) -> Array:
        d = np.hypot(self._stretch * across, along)
        # For huge beta the angle does not separate the end of the domain from straight back.
        r = _over(across, self.alpha * d + (1 - self.alpha) * along)
        return np.where(along >= -(self._w + ROUNDING) * d, r, np.nan)


@register
class Unified(FocalLens):
    """The unit sphere seen from ``xi`` behind its centre, then distortion (Mei's model): ``x = X / (Z + xi)``
    of the direction (X, Y, Z), ``x' = x (1 + k1 r2 + k2 r2^2) + 2 p1 x y + p2 (r2 + 2 x^2)``, likewise y'
    with p1 and p2 exchanged, ``u = cx + fx (x' + skew y')``, ``v = cy + fy y'``.

    Parameters: ``fx``, ``fy`` px; ``cx``, ``cy`` px (default: the middle; pixel centres at +0.5);
    ``xi`` > -1; ``distortion`` = (k1, k2, p1, p2); ``skew``: OpenCV's K[0, 1] over fx; ``fov_deg`` <= 360,
    an optional limit. Domain: ``Z > -xi``, for xi > 1 ``Z > -1 / xi``; and the disc of (x, y) within which
    the distortion turns back nowhere.
    Source: Mei and Rives 2007; with fx = -eta f the mirrors of OmniSCV, which look back, along -z.
    """

    name = "unified"
    typical: ClassVar = {"xi": 0.95, "distortion": (-0.08, 0.01, 5e-4, -3e-4), "fov_deg": 185}
    typical_focal = 0.57
    lens = Parameters.of("fx fy | cx cy | skew xi distortion=k1,k2,p1,p2")

    def __init__(
        self, *size: Any, xi: float, distortion: ArrayLike = (0.0, 0.0, 0.0, 0.0), **lens: Any
    ) -> None:
        self.xi = number("xi", xi, above=-1)
        self.distortion = numbers("distortion", distortion, (4,))
        self._one_less_xi_squared = (1 - self.xi) * (1 + self.xi)
        sine = np.sqrt(abs(self._one_less_xi_squared))
        cosine = -1.0 if self.xi > 1 else -self.xi
        self._theta_end = float(np.arctan2(sine, cosine))
        self._fold = float(1 / np.sqrt(-self._one_less_xi_squared)) if self.xi > 1 else 0.0
        self._r_end = self._fold or np.inf
        if self.distortion.any():
            self._distortion = Distortion(np.append(self.distortion, np.zeros(8)))
        super().__init__(*size, **lens)

    def _meridian(self, r: Array) -> Meridian:
        if self._fold:
            part = np.minimum(r / self._fold, 1.0)
            root = np.sqrt((1 - part) * (1 + part))
        else:
            root = np.sqrt(1 + self._one_less_xi_squared * r * r)
        if self.xi < 0:  # as below, without cancellation
            scale = self._one_less_xi_squared / (root - self.xi)
        else:
            scale = (self.xi + root) / (r * r + 1)
        return Meridian(r * scale, (root - self.xi * r * r) / (r * r + 1))

    def _radius(self, across: Array, along: Array) -> Array:
        return _over(across, _sum(self.xi, across, along))


@register
class Division(FocalLens):
    """One parameter for the strongest lenses: the ray of (x, y) = ((u - cx) / focal, (v - cy) / focal) is
    ``(x, y, 1 + k r2)``, ``r2 = x^2 + y^2``; ahead of the camera ``X / Z = x / (1 + k r2)``.

    Parameters: ``focal`` px; ``cx``, ``cy`` px (default: the middle; pixel centres at +0.5); ``k``, below 0
    for barrel distortion; ``fov_deg`` <= 360, an optional limit.
    Domain: for k > 0, r <= 1 / sqrt(k), where the ray turns back; for k < 0 every pixel, those with
    r > 1 / sqrt(-k) beyond 90 degrees, and every direction but straight back; for k = 0 as ``pinhole``.
    Source: Fitzgibbon 2001.
    """

    name = "division"
    typical: ClassVar = {"k": -0.3}
    typical_focal = 0.3
    lens = Parameters.of("focal | cx cy | k")

    def __init__(
        self,
        width: int,
        height: int,
        focal: float,
        cx: float | None = None,
        cy: float | None = None,
        k: float = 0.0,
        fov_deg: float | None = None,
    ) -> None:
        self.focal = number("focal", focal, above=0)
        self.k = number("k", k)
        if self.k >= 0:
            self._theta_end = float(np.arctan2(1.0, 2 * np.sqrt(self.k)))
        if self.k > 0:
            self._r_end = BEFORE_TURN * float(1 / np.sqrt(self.k))
        super().__init__(width, height, self.focal, self.focal, cx, cy, 0.0, fov_deg)

    def _meridian(self, r: Array) -> Meridian:
        height = 1 + self.k * r * r
        distance = np.hypot(r, height)
        return Meridian(r / distance, height / distance)

    def _radius(self, across: Array, along: Array) -> Array:
        # The smaller root of k across r^2 - along r + across = 0, without cancellation.
        root = np.sqrt(np.maximum(along * along - 4 * self.k * across * across, 0.0))
        ahead = 2 * across / (along + root)
        back = (along - root) / (2 * self.k * across) if self.k else np.full_like(across, np.nan)
        return np.where(along >= 0, ahead, back)


@register
class FieldOfView(FocalLens):
    """A lens by one angle (FOV, ATAN): ``r = atan2(2 tan(omega / 2) sin(theta), cos(theta)) / omega``, theta
    from +z, ``u = cx + fx (x + skew y)``, (x, y) = r (cos a, sin a), a the azimuth.

    Parameters: ``fx``, ``fy`` px; ``cx``, ``cy`` px (default: the middle; pixel centres at +0.5); ``omega``
    in (0, pi), rad; ``skew``; ``fov_deg`` <= 360, an optional limit.
    Domain: r <= pi / omega; the source has angles below 90 degrees, r < pi / (2 omega).
    Source: Devernay and Faugeras 2001.
    """

    name = "field-of-view"
    typical: ClassVar = {"omega": 1.0}
    typical_focal = 0.35
    lens = Parameters.of("fx fy | cx cy | skew omega")

    def __init__(self, *size: Any, omega: float, **lens: Any) -> None:
        self.omega = number("omega", omega, above=0, below=float(np.pi))
        self._stretch = 2 * float(np.tan(self.omega / 2))
        self._r_end = np.pi / self.omega
        super().__init__(*size, **lens)

    def _meridian(self, r: Array) -> Meridian:
        across = np.sin(self.omega * r)
        along = self._stretch * np.cos(self.omega * r)
        distance = np.hypot(across, along)
        return Meridian(across / distance, along / distance)

    def _radius(self, across: Array, along: Array) -> Array:
        return np.arctan2(self._stretch * across, along) / self.omega


def _second_limit(alpha: float) -> tuple[float, float, float]:
    """Return w of the limit ``z > -w d``, 1 - w^2, and the radius where n turns back, 0 if it does not."""
    if alpha <= 0.5:
        w = alpha / (1 - alpha)
        return w, (1 - 2 * alpha) / (1 - alpha) ** 2, 0.0
    return (1 - alpha) / alpha, (2 * alpha - 1) / alpha**2, float(1 / np.sqrt(2 * alpha - 1))


def _height(r: Array, alpha: float, fold: float) -> Array:
    """Return z over n of the ray at radius r."""
    if not fold:
        root = np.sqrt(1 + (1 - 2 * alpha) * r * r)
    else:
        part = np.minimum(r / fold, 1.0)
        root = np.sqrt((1 - part) * (1 + part))
    if alpha > 0.75:  # as below, without cancellation for alpha near 1
        return np.asarray((alpha * root - (1 - alpha)) / (2 * alpha - 1))
    return np.asarray((1 - alpha * r) * (1 + alpha * r) / (alpha * root + 1 - alpha))


def _to_first_sphere(across: Array, along: Array, xi: float) -> Array:
    """Return t > 0 with ``t (across, along)`` from the second sphere's centre on the first sphere."""
    less = (1 - xi) * (1 + xi)
    distance = np.sqrt(along * along + less * across * across)
    # Two forms: each is free of cancellation on its side.
    near = less / (distance - along * xi)
    far = (along * xi + distance) / (along * along + across * across)
    return np.where(along * xi < 0, near, far)


def _sum(xi: float, across: Array, along: Array) -> Array:
    """Return xi + along, without cancellation for rays far back and xi near 1, or ahead and xi near -1."""
    back = (xi - 1) + across * across / (1 - along)
    ahead = (xi + 1) - across * across / (1 + along)
    middle = np.where(along > 0.5, ahead, xi + along)
    return np.where(along < -0.5, back, middle)


def _over(across: Array, n: Array) -> Array:
    """Return the radius across / n; NaN for n <= 0, beyond the domain."""
    return np.where(n > 0, across / n, np.nan)
