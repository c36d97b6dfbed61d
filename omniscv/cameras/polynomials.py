"""Lenses by a polynomial, on the branch where it increases."""

from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike

from omniscv.arguments import number, numbers, one_of, optional_number, wrong
from omniscv.cameras.base import Array
from omniscv.cameras.distortion import Distortion, Increasing, first_positive_root, increasing_root
from omniscv.cameras.lens_parameters import Parameters
from omniscv.cameras.radial import BEFORE_TURN, FocalLens, Lens, Meridian
from omniscv.cameras.registry import register
from omniscv.errors import ArgumentError

Reference = Literal["angle-to-pixel", "pixel-to-angle"]

_MOST_COEFFICIENTS = 64  # finding roots takes the cube of their number
_CELLS = 2048  # of a table in which roots start
_BLOCK = 1 << 14  # values per block: its arrays fit the processor's cache


class AffineLens(Lens):
    """A lens with ``u = u_0 + c x + d y``, ``v = v_0 + e x + y``, (x, y) in the plane, here in px."""

    def _set_affine(self, name: str, affine: Array) -> float:
        """Set the matrix [[c, d], [e, 1]]; return the radius of the farthest corner in the plane."""
        c, d, e = affine.tolist()
        self._A = np.array([[c, d], [e, 1.0]])
        farthest = self._farthest_corner()
        if not np.isfinite(farthest):
            raise ArgumentError(f"{name}: expected c - d e further from 0, got (c, d, e) = {affine.tolist()}")
        return farthest


@register
class Scaramuzza(AffineLens):
    """A camera of revolution by a polynomial: the ray of (u'', v'') is ``(u'', v'', -f(rho))``,
    ``f(rho) = a0 + a1 rho + ... + aN rho^N``, ``rho = |(u'', v'')|`` px.

    ``u = u_0 + c u'' + d v''``, ``v = v_0 + e u'' + v''``.
    Parameters: ``coefficients`` a0..aN with a0 < 0; ``affine`` = (c, d, e), (1, 0, 0) if not given;
    ``fov_deg`` <= 360, an optional limit.
    Domain: the branch on which the ray turns away from +z as rho grows, ``rho f'(rho) > f(rho)``;
    pixels beyond it are invalid, because others see their rays.
    Source: OmniSCV, Scaramuzza; Scaramuzza et al. 2006.
    """

    name = "scaramuzza"
    lens = Parameters.of("| center=cx,cy | coefficients=a0..a19 affine=c,d,e")

    def __init__(
        self,
        width: int,
        height: int,
        coefficients: ArrayLike,
        affine: ArrayLike = (1.0, 0.0, 0.0),
        fov_deg: float | None = None,
        center: ArrayLike | None = None,
    ) -> None:
        super().__init__(width, height, *(() if center is None else numbers("center", center, (2,))))
        self.coefficients = _checked("coefficients", coefficients)
        number("coefficients[0]", self.coefficients[0], below=0)
        self.affine = numbers("affine", affine, (3,))
        corner = self._set_affine("affine", self.affine)
        turning = first_positive_root((np.arange(len(self.coefficients)) - 1) * self.coefficients)
        self._r_end = float(np.minimum(turning, 2 * corner))
        self._theta_end = float(self._theta(np.array(self._r_end)))
        self._set_domain(fov_deg)

    @classmethod
    def example(cls, width: int = 512) -> Self:
        powers = (width / 384) ** (1.0 - np.arange(5))
        return cls(width, width, [-122.0, 0.0, 0.0021, -3e-6, 1.2e-8] * powers, fov_deg=190)

    def _theta(self, rho: Array) -> Array:
        """Return the angles off the axis of radii (...), px."""
        return np.asarray(np.arctan2(rho, -polyval(rho, self.coefficients)))

    def _meridian(self, r: Array) -> Meridian:
        along = -polyval(r, self.coefficients)
        length = np.hypot(r, along)
        return Meridian(r / length, along / length)

    def _radius(self, across: Array, along: Array) -> Array:
        """Return the radii rho (...), px, that see unit directions; beyond the domain, the radius of its end.

        ``across`` (...) and ``along`` (...) are the parts of directions off the axis and along it, camera
        frame. Roots are found block by block, so that the arrays of one fit the processor's cache.
        """
        theta = np.minimum(np.arctan2(across, along), self._theta_end)
        angles = theta.ravel()
        radii = np.empty(theta.size)
        for start in range(0, angles.size, _BLOCK):
            block = slice(start, start + _BLOCK)
            radii[block] = self._radius_of(angles[block])
        return radii.reshape(theta.shape)

    def _radius_of(self, theta: Array) -> Array:
        """Return the radii, px, of angles (N,) off the axis; each root is sought in a cell of a table."""
        table = np.linspace(0.0, self._r_end, _CELLS)
        angles = np.maximum.accumulate(self._theta(table))
        cell = np.clip(np.searchsorted(angles, theta) - 1, 0, _CELLS - 2)

        def beyond(rho: Array, theta: Array) -> Array:
            return self._theta(rho) - theta

        return increasing_root(beyond, table[cell], table[cell + 1], theta)


class AngleLens(FocalLens):
    """A lens whose radius is a polynomial of the angle, up to where it turns back, at most pi."""

    _r_of_theta: Increasing

    def _end_where_it_turns(self, *odd: float) -> None:
        """Set the polynomial ``theta + odd[0] theta^3 + odd[1] theta^5 + ...``."""
        coefficients = np.zeros(2 * len(odd) + 2)
        coefficients[1::2] = (1.0, *odd)
        self._r_of_theta = Increasing(coefficients, np.pi)
        self._theta_end = self._r_of_theta.end
        self._r_end = self._r_of_theta.last

    def _meridian(self, r: Array) -> Meridian:
        theta = self._r_of_theta.inverse(r)
        return Meridian(np.sin(theta), np.cos(theta))

    def _radius(self, across: Array, along: Array) -> Array:
        return self._r_of_theta(np.minimum(np.arctan2(across, along), self._theta_end))


@register
class KannalaBrandt(AngleLens):
    """A lens by an odd polynomial: ``d(theta) = theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9``.

    ``u = cx + fx (x' + skew y')``, ``v = cy + fy y'``, (x', y') = d(theta) (cos a, sin a), theta from +z, a
    the azimuth. Parameters: ``fx``, ``fy`` px; ``cx``, ``cy`` px (default: the middle; pixel centres at +0.5,
    so OpenCV's cx + 0.5); ``k`` = (k1, k2, k3, k4); ``skew``, OpenCV's alpha, K[0, 1] over fx; ``fov_deg``
    <= 360, an optional limit.
    Domain: the branch on which d increases from theta = 0, at most to pi; pixels beyond its last value,
    and angles beyond its end, are invalid.
    Source: OmniSCV, Kannala-Brandt; Kannala and Brandt 2006.
    """

    name = "kannala-brandt"
    lens = Parameters.of("fx fy | cx cy | skew k=k1,k2,k3,k4")

    def __init__(self, *size: Any, k: ArrayLike = (0.0, 0.0, 0.0, 0.0), **lens: Any) -> None:
        self.k = numbers("k", k, (4,))
        self._end_where_it_turns(*self.k.tolist())
        super().__init__(*size, **lens)

    @classmethod
    def example(cls, width: int = 512) -> Self:
        focal = width * 122 / 384
        return cls(width, width, fx=focal, fy=focal, k=(0.02, -0.008, 0.002, -0.0004), fov_deg=185)


@register
class Fisheye624(AngleLens):
    """Project Aria's FISHEYE624: ``r(theta) = theta (1 + k0 theta^2 + ... + k5 theta^12)``, (x, y) =
    r (cos a, sin a), then tangential terms and a thin prism: ``u = cx + fx (x + p0 (2 x^2 + r2) + 2 p1 x y
    + s0 r2 + s1 r2^2)``, ``v = cy + fy (y + p1 (2 y^2 + r2) + 2 p0 x y + s2 r2 + s3 r2^2)``, r2 = x^2 + y^2.

    Parameters: ``fx``, ``fy`` px; ``cx``, ``cy`` px (default: the middle; pixel centres at +0.5, so Aria's
    cu + 0.5); ``k`` = (k0 .. k5); ``p`` = (p0, p1), OpenCV's (p2, p1); ``s`` = (s0 .. s3); ``skew`` of u as
    in ``kannala-brandt``; ``fov_deg`` <= 360, an optional limit: what Aria calibrates ends with its circle.
    Domain: theta up to where r turns back, at most pi, and the disc of (x, y) in which the distortion does
    not turn back.
    Source: projectaria_tools, FisheyeRadTanThinPrism, which is right up to 90 degrees.
    """

    name = "fisheye624"
    typical: ClassVar = {
        "k": (-0.03, 0.09, -0.06, 0.015, -0.002, 1e-4), "p": (2e-4, -4e-4), "s": (-3e-4, -1e-5, 6e-4, -2e-5),
        "fov_deg": 165,
    }  # fmt: skip
    typical_focal = 0.34
    lens = Parameters.of("fx fy | cx cy | skew k=k0,k1,k2,k3,k4,k5 p=p0,p1 s=s0,s1,s2,s3")

    def __init__(
        self,
        *size: Any,
        k: ArrayLike = (0.0,) * 6,
        p: ArrayLike = (0.0, 0.0),
        s: ArrayLike = (0.0,) * 4,
        **lens: Any,
    ) -> None:
        self.k = numbers("k", k, (6,))
        self.p = numbers("p", p, (2,))
        self.s = numbers("s", s, (4,))
        if self.p.any() or self.s.any():
            p0, p1 = self.p
            self._distortion = Distortion(np.array([0, 0, p1, p0, 0, 0, 0, 0, *self.s]))
        self._end_where_it_turns(*self.k.tolist())
        super().__init__(*size, **lens)


@register
class FTheta(AffineLens):
    """NVIDIA's f-theta lens: r = f(theta) px, theta from +z, or theta = g(r). The given polynomial is exact,
    and is inverted where it increases. ``(u, v) = (cx, cy) + [[c, d], [e, 1]] r (cos a, sin a)``.

    Parameters: ``cx``, ``cy`` px (default: the middle; pixel centres at +0.5); ``polynomial`` = (0, c1,
    c2 ...) of ``reference``: "angle-to-pixel", f (px per rad^n), or "pixel-to-angle", g (rad per px^n);
    ``linear`` = (c, d, e); ``max_angle_deg`` <= 180, an optional limit of theta; ``fov_deg`` <= 360, the
    same as a full angle.
    Domain: from 0 to where the polynomial turns back, theta <= pi.
    Source: NVIDIA NCore, sensor models; DriveWorks, dwFThetaCameraConfig.
    """

    name = "ftheta"
    lens = Parameters.of("| cx cy | polynomial=c0..c5 linear=lc,ld,le max_angle_deg=most")

    def __init__(
        self,
        *place: Any,
        polynomial: ArrayLike,
        reference: Reference = "angle-to-pixel",
        linear: ArrayLike = (1.0, 0.0, 0.0),
        max_angle_deg: float | None = None,
        fov_deg: float | None = None,
        **center: Any,
    ) -> None:
        super().__init__(*place, **center)
        self.reference: Reference = one_of("reference", reference, get_args(Reference))
        self.polynomial = _checked("polynomial", polynomial)
        if len(self.polynomial) < 2 or self.polynomial[0] != 0 or self.polynomial[1] <= 0:
            raise wrong("polynomial", "(0, c1, c2, ...) with c1 > 0", self.polynomial)
        self.linear = numbers("linear", linear, (3,))
        self.max_angle_deg = optional_number("max_angle_deg", max_angle_deg, above=0, most=180)
        corner = self._set_affine("linear", self.linear)
        most = np.pi if self.max_angle_deg is None else float(np.radians(self.max_angle_deg))
        self._by_angle = self.reference == "angle-to-pixel"
        if self._by_angle:
            self._branch = Increasing(self.polynomial, most)
            self._theta_end = self._branch.end
            self._r_end = self._branch.last
        else:
            self._branch = Increasing(self.polynomial, 2 * corner)
            self._r_end = BEFORE_TURN * self._branch.end
            self._theta_end = min(self._branch.last, most)
            if self._branch.last > most:
                self._r_end = float(self._branch.inverse(np.array(most)))
        self._set_domain(fov_deg)

    @classmethod
    def example(cls, width: int = 512) -> Self:
        scaled = width * np.array([0.0, 0.33, 0.0, -0.012, 0.002, -0.0012])
        return cls(width, width, polynomial=scaled, max_angle_deg=95)

    def _meridian(self, r: Array) -> Meridian:
        theta = self._branch.inverse(r) if self._by_angle else self._branch(r)
        return Meridian(np.sin(theta), np.cos(theta))

    def _radius(self, across: Array, along: Array) -> Array:
        theta = np.minimum(np.arctan2(across, along), self._theta_end)
        return self._branch(theta) if self._by_angle else self._branch.inverse(theta)


def _checked(name: str, polynomial: ArrayLike) -> Array:
    """Return the coefficients; ArgumentError for more than ``_MOST_COEFFICIENTS``."""
    coefficients = numbers(name, polynomial, (None,))
    if len(coefficients) > _MOST_COEFFICIENTS:
        raise ArgumentError(f"{name}: expected at most {_MOST_COEFFICIENTS} numbers, got {len(coefficients)}")
    return coefficients
