"""Lenses by a polynomial, on the branch where it increases, and the polynomial's inverse there."""

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike

from omniscv.arguments import number, numbers, optional_number
from omniscv.cameras.base import Array, CentralCamera, Mask, polar, turned_about_axis
from omniscv.cameras.radial import ROUNDING
from omniscv.cameras.registry import register
from omniscv.errors import ArgumentError

_MOST_COEFFICIENTS = 64  # finding the roots takes the cube of them
_BLOCK = 1 << 14  # values solved together: their arrays stay in the processor's cache


@register
class Scaramuzza(CentralCamera):
    """A camera of revolution by a polynomial: the ray of (u'', v'') is ``(u'', v'', -f(rho))``,
    ``f(rho) = a0 + a1 rho + ... + aN rho^N``, ``rho = |(u'', v'')|`` px.

    ``u = u_0 + c u'' + d v''``, ``v = v_0 + e u'' + v''``.
    Parameters: ``coefficients`` a0..aN with a0 < 0; ``affine`` = (c, d, e), (1, 0, 0) if not given;
    ``fov_deg`` <= 360, an optional limit.
    Domain: the branch on which the ray turns away from +z as rho grows, ``rho f'(rho) > f(rho)``;
    beyond it two pixels would see one ray, and they are invalid.
    Source: OmniSCV, Scaramuzza; Scaramuzza et al. 2006.
    """

    name = "scaramuzza"
    _farthest_off = 1e-5  # a steep polynomial may turn the ray to and fro within a rounding

    def __init__(
        self,
        width: int,
        height: int,
        coefficients: ArrayLike,
        affine: ArrayLike = (1.0, 0.0, 0.0),
        fov_deg: float | None = None,
        center: ArrayLike | None = None,
    ) -> None:
        super().__init__(width, height, center)
        self.coefficients = numbers("coefficients", coefficients, (None,))
        if len(self.coefficients) > _MOST_COEFFICIENTS:
            got = f"{len(self.coefficients)}"
            raise ArgumentError(f"coefficients: expected at most {_MOST_COEFFICIENTS} numbers, got {got}")
        number("coefficients[0]", self.coefficients[0], below=0)
        self.affine = numbers("affine", affine, (3,))
        c, d, e = self.affine
        self._A = np.array([[c, d], [e, 1.0]])
        self.fov_deg = optional_number("fov_deg", fov_deg, above=0, most=360)
        self._slope = polyder(self.coefficients) if len(self.coefficients) > 1 else np.zeros(1)
        turning = _first_positive_root((np.arange(len(self.coefficients)) - 1) * self.coefficients)
        corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], dtype=np.float64)
        if c != d * e:
            farthest = np.hypot(*np.linalg.solve(self._A, (corners - self.center).T)).max()
        if c == d * e or not np.isfinite(farthest):
            raise ArgumentError(
                f"affine: expected c - d e further from 0, got (c, d, e) = {self.affine.tolist()}"
            )
        self._rho_end = float(min(turning, farthest))
        if self.fov_deg is not None:
            half = np.radians(self.fov_deg) / 2
            if self._theta(np.array(self._rho_end)) > half:
                self._rho_end = float(self._rho_of(np.array([half]))[0])
        self._theta_end = float(self._theta(np.array(self._rho_end)))

    @classmethod
    def example(cls, width: int = 512) -> Self:
        powers = (width / 384) ** (1.0 - np.arange(5))
        return cls(width, width, [-122.0, 0.0, 0.0021, -3e-6, 1.2e-8] * powers, fov_deg=190)

    @cached_property
    def _unresolved_px(self) -> float:
        # Where f changes sign the ray turns by f' / rho; rho is not less than |a0| over the greatest f'.
        greatest = polyval(self._rho_end, np.abs(self._slope))
        return np.inf if greatest * greatest > -1e3 * self.coefficients[0] else super()._unresolved_px

    def _theta(self, rho: Array) -> Array:
        return np.asarray(np.arctan2(rho, -polyval(rho, self.coefficients)))

    def _rho_of(self, theta: Array) -> Array:
        """The radius on the branch whose ray is theta off +z."""

        def slope(rho: Array) -> Array:
            f = polyval(rho, self.coefficients)
            return np.asarray((rho * polyval(rho, self._slope) - f) / (rho * rho + f * f))

        return _invert(self._theta, slope, self._rho_end, theta)

    def _directions(self, pixels: Array) -> tuple[Array, Mask]:
        uv = (pixels - self.center) @ np.linalg.inv(self._A).T
        rho = np.hypot(uv[..., 0], uv[..., 1])
        along = -polyval(rho, self.coefficients)
        length = np.hypot(rho, along)
        directions = np.concatenate([uv, along[..., None]], axis=-1) / length[..., None]
        return directions, (rho <= self._rho_end * (1 + ROUNDING)) & np.isfinite(along)

    def _project(self, points: Array) -> tuple[Array, Mask]:
        across, cos_a, sin_a = polar(points[..., :2])
        theta = np.arctan2(across, points[..., 2])
        seen = theta <= self._theta_end * (1 + ROUNDING)
        rho = self._rho_of(np.minimum(theta, self._theta_end))
        return self.center + np.stack([rho * cos_a, rho * sin_a], axis=-1) @ self._A.T, seen


@register
class KannalaBrandt(CentralCamera):
    """A lens by an odd polynomial: ``d(theta) = theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9``.

    ``u = cx + fx d(theta) cos a``, ``v = cy + fy d(theta) sin a``, theta from +z, a the azimuth.
    Parameters: ``fx``, ``fy`` px; ``cx``, ``cy`` px (default: the middle; pixel centres at +0.5, so
    OpenCV's cx + 0.5); ``k`` = (k1, k2, k3, k4); ``fov_deg`` <= 360, an optional limit.
    Domain: the branch on which d increases from theta = 0, at most to pi; pixels beyond its last value,
    and angles beyond its end, are invalid.
    Source: OmniSCV, Kannala-Brandt; Kannala and Brandt 2006.
    """

    name = "kannala-brandt"

    def __init__(
        self,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float | None = None,
        cy: float | None = None,
        k: ArrayLike = (0.0, 0.0, 0.0, 0.0),
        fov_deg: float | None = None,
    ) -> None:
        super().__init__(width, height)
        self.fx, self.fy = number("fx", fx, above=0), number("fy", fy, above=0)
        self.cx = number("cx", self.width / 2 if cx is None else cx)
        self.cy = number("cy", self.height / 2 if cy is None else cy)
        self.center = np.array([self.cx, self.cy])
        self.k = numbers("k", k, (4,))
        self.fov_deg = optional_number("fov_deg", fov_deg, above=0, most=360)
        self._d = np.zeros(10)
        self._d[1], self._d[3::2] = 1.0, self.k
        self._slope = polyder(self._d)
        # d' is even: its first root is the square root of one in theta^2.
        turning = np.sqrt(_first_positive_root(self._slope[::2]))
        limit = np.pi if self.fov_deg is None else np.radians(self.fov_deg) / 2
        self._theta_end = float(min(np.pi, turning, limit))
        self._d_end = float(polyval(self._theta_end, self._d))

    @classmethod
    def example(cls, width: int = 512) -> Self:
        focal = width * 122 / 384
        return cls(width, width, fx=focal, fy=focal, k=(0.02, -0.008, 0.002, -0.0004), fov_deg=185)

    def _directions(self, pixels: Array) -> tuple[Array, Mask]:
        focal = np.array([self.fx, self.fy])
        d, cos_a, sin_a = polar((pixels - self.center) / focal)
        seen = d <= self._d_end
        d_of, slope_of = partial(polyval, c=self._d), partial(polyval, c=self._slope)
        theta = _invert(d_of, slope_of, self._theta_end, np.where(seen, d, 0.0))
        return turned_about_axis(np.sin(theta), np.cos(theta), cos_a, sin_a), seen

    def _project(self, points: Array) -> tuple[Array, Mask]:
        across, cos_a, sin_a = polar(points[..., :2])
        theta = np.arctan2(across, points[..., 2])
        seen = theta <= self._theta_end * (1 + ROUNDING)
        rounding = self._pixel_rounding / min(self.fx, self.fy)
        d = polyval(np.minimum(theta, self._theta_end), self._d)
        d = np.minimum(d, min(self._d_end * (1 - 0.1 * ROUNDING), self._d_end - rounding))
        return self.center + np.stack([self.fx * d * cos_a, self.fy * d * sin_a], axis=-1), seen


def _first_positive_root(coefficients: ArrayLike) -> float:
    """The least x > 0 from which on ``c_0 + c_1 x + ...``, positive at 0, is negative; else infinity."""
    trimmed = np.trim_zeros(np.asarray(coefficients, dtype=np.float64), "b")
    if trimmed.size < 2:
        return np.inf
    constant, least = trimmed[0], 1e-300 * np.abs(trimmed).max()
    if abs(constant) < least:  # a root next to 0 stays next to 0, and its reciprocal finite
        trimmed = np.append(np.copysign(least, constant), trimmed[1:])
    # The least root is the greatest reciprocal, which the solver finds best. Roots that coincide come out
    # scattered in the complex plane; a crossing is next to the real part of one all the same. Coefficients
    # that are next to nothing have roots next to infinity, where all may overflow.
    roots = 1 / np.roots(trimmed).astype(np.complex128)
    near = np.sort(roots.real[np.isfinite(roots) & (roots.real > 0)])
    between = np.sqrt(near) * np.sqrt(np.append(near[1:], 4 * near[-1:]))
    # A root that the polynomial only touches is no crossing: the branch goes on.
    rounding = np.finfo(np.float64).eps * len(trimmed) * polyval(between, np.abs(trimmed))
    negative = np.flatnonzero(polyval(between, trimmed) < -rounding)
    if not negative.size:
        return np.inf
    first = negative[0]
    low, high = between[first - 1] if first else near[0] / 2, between[first]
    for _ in range(70):  # halves their ratio, from 1e300 to the last digit
        middle = np.sqrt(low) * np.sqrt(high)
        low, high = (low, middle) if polyval(middle, trimmed) < 0 else (middle, high)
    return float(low)


def _invert(
    function: Callable[[Array], Any], slope: Callable[[Array], Any], end: float, values: Array
) -> Array:
    """x in [0, end] with ``function(x) = value``, for a function that increases there; else an end."""
    # A table gives the start, Newton's steps the digits; where the slope vanishes, at the end of the branch,
    # the interval of the table is halved instead.
    x_table = np.linspace(0.0, end, 2048)
    y_table = np.maximum.accumulate(function(x_table))
    flat = values.ravel()
    result = np.empty(flat.shape)
    for start in range(0, flat.size, _BLOCK):
        y = flat[start : start + _BLOCK]
        cell = np.clip(np.searchsorted(y_table, y) - 1, 0, len(x_table) - 2)
        low, high = x_table[cell], x_table[cell + 1]
        x = np.clip(np.interp(y, y_table, x_table), low, high)
        for _ in range(3):
            gradient = slope(x)
            x = np.clip(x - (function(x) - y) / np.where(gradient > 0, gradient, np.inf), low, high)
        bad = np.flatnonzero(~(np.abs(function(x) - y) <= 4e-16 * (np.abs(y) + slope(x) * np.abs(x))))
        if bad.size:
            a, b, wanted = low[bad], high[bad], y[bad]
            for _ in range(60):
                middle = (a + b) / 2
                below = function(middle) < wanted
                a, b = np.where(below, middle, a), np.where(below, b, middle)
            x[bad] = (a + b) / 2
        result[start : start + _BLOCK] = x
    return result.reshape(values.shape)
