"""OpenCV's distortion of the plane; roots and inverses of increasing functions, such as its radial part."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike

from omniscv.cameras.base import Array

_CELLS = 1 << 11  # of the table of an inverse
_MOST_STEPS = 100  # of regula falsi


class Increasing:
    """``p(x) = c1 x + c2 x^2 + ...``, c1 > 0, from x = 0 to where it turns back, and its inverse there.

    Args:
        coefficients: (N,) 0, c1, c2 ...
        most: the largest x.

    Attributes:
        end: the last x.
        last: p there.
    """

    def __init__(self, coefficients: Array, most: float) -> None:
        self._coefficients = np.array(coefficients)
        slope = polyder(self._coefficients)
        # The slope of an odd polynomial is even: its first root is the square root of one in x^2.
        odd = not slope[1::2].any()
        turn = np.sqrt(first_positive_root(slope[::2])) if odd else first_positive_root(slope)
        self.end = float(np.minimum(turn, most))
        self.last = float(self(np.array(self.end)))
        x = np.linspace(0.0, self.end, 2 * _CELLS)
        y = np.maximum.accumulate(self(x))
        self._table = np.interp(np.linspace(0.0, self.last, _CELLS + 1), y, x)
        self._table.flags.writeable = self._coefficients.flags.writeable = False
        if not np.isfinite(self._table).all():
            self.end = self.last = np.nan  # cameras refuse it

    def __call__(self, x: Array) -> Array:
        return np.asarray(polyval(x, self._coefficients))

    def inverse(self, y: Array) -> Array:
        """Return the x of values 0 <= y <= ``last``."""
        from omniscv.cameras import camera_kernels  # slow to load

        x = np.empty(np.shape(y))
        camera_kernels.invert(np.ravel(y), self._coefficients, self._table, self.last, x.reshape(-1))
        return x


def first_positive_root(coefficients: ArrayLike) -> float:
    """Return the least x > 0 where ``c_0 + c_1 x + ...``, positive at 0, becomes negative; else infinity.

    NaN where a coefficient is too many times c_0 for float64; cameras refuse it.
    """
    trimmed = np.trim_zeros(np.asarray(coefficients, dtype=np.float64), "b")
    if trimmed.size < 2:
        return np.inf
    if not np.isfinite(trimmed / trimmed[0]).all():
        return np.nan
    # The least root is the greatest reciprocal, which the solver finds best. Coinciding roots come out
    # scattered in the complex plane; a crossing is next to the real part of one.
    roots = 1 / np.roots(trimmed).astype(np.complex128)
    near = np.sort(roots.real[np.isfinite(roots) & (roots.real > 0)])
    between = np.sqrt(near) * np.sqrt(np.append(near[1:], 4 * near[-1:]))
    # The polynomial does not cross a root that it only touches: the branch continues.
    rounding = np.finfo(np.float64).eps * len(trimmed) * polyval(between, np.abs(trimmed))
    negative = np.flatnonzero(polyval(between, trimmed) < -rounding)
    if not negative.size:
        return np.inf
    first = negative[0]
    low = between[first - 1] if first else near[0] / 2
    high = between[first]
    for _ in range(70):  # halves the ratio of the two, down to the last digit
        middle = np.sqrt(low) * np.sqrt(high)
        low, high = (low, middle) if polyval(middle, trimmed) < 0 else (middle, high)
    return float(low)


def increasing_root(value: Callable[..., Array], low: Array, high: Array, *others: Array) -> Array:
    """Return the roots (N,) of N functions of x that rise from negative to positive between two bounds.

    Where rounding hides the change of sign, it is the end next to it. Regula falsi: a step scales the value
    at the end that it keeps as Anderson and Björck do. Converged roots are set aside when they are the
    majority, so that a few slow ones cost little.

    Args:
        value: returns the values (M,) of functions at x (M,), with what ``others`` have for these.
        low: (N,) the lower bounds.
        high: (N,) the upper bounds.
        others: (N,) more arguments of the functions.
    """
    below = value(low, *others)
    above = value(high, *others)
    root = np.where(below > 0, low, high)
    index = np.flatnonzero((below <= 0) & (above >= 0))
    pending = [values[index] for values in (low, high, below, above, *others)]
    for _ in range(_MOST_STEPS):
        if not index.size:
            break
        low, high, below, above, *pending_others = pending
        with np.errstate(divide="ignore", invalid="ignore"):
            step = high - above * ((high - low) / (above - below))
            x = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
            y = value(x, *pending_others)
            rises = y < 0
            kept = 1 - y / np.where(rises, below, above)
        kept = np.where(kept > 0, kept, 0.5)
        moving = np.abs(x - root[index]) > 4e-16 * x
        root[index] = x
        pending = [
            np.where(rises, x, low),
            np.where(rises, high, x),
            np.where(rises, y, below * kept),
            np.where(rises, above * kept, y),
            *pending_others,
        ]
        if 2 * np.count_nonzero(moving) <= index.size:
            index = index[moving]
            pending = [values[moving] for values in pending]
    return root


_TABLE = 512  # cells of the table of undistorted radii


class Distortion:
    """``x'' = x c + 2 p1 x y + p2 (r2 + 2 x^2) + s1 r2 + s2 r2^2``,
    ``y'' = y c + p1 (r2 + 2 y^2) + 2 p2 x y + s3 r2 + s4 r2^2``, with ``r2 = x^2 + y^2`` and
    ``c = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)``.

    It is inverted in the largest disc about (0, 0) in which the symmetric part of its derivative is positive
    definite: there it is one to one. Without p and s the disc ends where r c turns back.

    Args:
        coefficients: (12,) k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4: OpenCV's order.
    """

    def __init__(self, coefficients: Array) -> None:
        k1, k2, p1, p2, k3, k4, k5, k6, *prism = coefficients.tolist()
        self._numerator = np.array([1, k1, k2, k3])
        self._denominator = np.array([1, k4, k5, k6])
        self._radial_only = not any((p1, p2, *prism))
        self.coefficients = (k1, k2, p1, p2, k3, k4, k5, k6, *prism)
        self.solver: tuple[Any, ...] = ()

    def apply(self, plane: Array) -> Array:
        """Return the distorted coordinates (..., 2) of undistorted ones (..., 2)."""
        from omniscv.cameras import camera_kernels  # slow to load

        distorted = np.empty(plane.shape)
        camera_kernels.distort_all(plane.reshape(-1, 2), self.coefficients, distorted.reshape(-1, 2))
        return distorted

    def set_domain(self, end: float, beyond: float, rounding: float) -> float:
        """Return the radius of the disc in which the distortion can be inverted, and prepare the solver.

        Args:
            end: the last radius of the model.
            beyond: a distorted radius beyond the image's corners.
            rounding: the rounding error of distorted coordinates.
        """
        from omniscv.cameras import camera_kernels  # slow to load

        turn = self._first_turn()
        if np.isnan(turn):
            return np.nan
        end = self._radius_reaching(min(end, turn), beyond)
        if not self._radial_only:
            end = float(camera_kernels.first_turn(self.coefficients, end))
        radii = np.linspace(0.0, end, _TABLE + 1)
        reached = self._radial(radii)
        last = float(reached[-1])
        table = np.interp(np.linspace(0.0, last, _TABLE + 1), reached, radii)
        table.flags.writeable = False
        farthest = float(camera_kernels.farthest_of_rim(self.coefficients, end))
        self.solver = (self.coefficients, end, last, farthest, 4 * rounding, table)
        return end if np.isfinite(table).all() and last > 0 else np.nan

    def _radial(self, r: Array) -> Array:
        """Return r c of radii (...)."""
        powers = (r * r)[..., None] ** np.arange(4)
        return np.asarray(r * (powers @ self._numerator) / (powers @ self._denominator))

    def _first_turn(self) -> float:
        """Return the radius where r c turns back or has its first pole; infinity if there is none."""
        N = self._numerator
        D = self._denominator
        twice = 2 * np.arange(4)
        # The slope by r of r N / D times D^2, with s = r^2: N D + 2 s (N' D - N D').
        slope = np.convolve(N, D) + np.convolve(twice * N, D) - np.convolve(N, twice * D)
        turn = first_positive_root(slope)
        pole = first_positive_root(D)
        return float(np.sqrt(np.minimum(turn, pole)))

    def _radius_reaching(self, end: float, beyond: float) -> float:
        """Return a radius up to ``end`` where r c is 0.9 to 1 times ``beyond``; ``end`` if r c is less."""

        def within(r: float) -> bool:  # negative beyond a pole
            return bool(0 <= self._radial(np.array(r)) <= beyond)

        if np.isfinite(end) and within(end):
            return end
        low = 0.0
        high = min(end, beyond)
        while within(high) and high < min(end, 1e100):
            low = high
            high = min(2 * high, end)
        for _ in range(100):
            if self._radial(np.array(low)) >= 0.9 * beyond:
                break
            middle = (low + high) / 2
            low, high = (middle, high) if within(middle) else (low, middle)
        return low
