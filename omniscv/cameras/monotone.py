"""Polynomials on the branch where they increase from 0."""

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike

from omniscv.cameras.base import Array

_CELLS = 1 << 11


class Increasing:
    """``p(x) = c1 x + c2 x^2 + ...``, c1 > 0, from x = 0 to where it turns back, and its inverse there.

    Args:
        coefficients: (N,) 0, c1, c2 ...
        most: the largest x that is wanted.

    Attributes:
        end, last: the last x, and p there.
    """

    def __init__(self, coefficients: Array, most: float) -> None:
        self._coefficients = np.array(coefficients)
        slope = polyder(self._coefficients)
        # An odd polynomial's slope is even: its first root is the square root of one in x^2.
        odd = not slope[1::2].any()
        turn = np.sqrt(first_positive_root(slope[::2])) if odd else first_positive_root(slope)
        self.end = float(min(turn, most))
        self.last = float(self(np.array(self.end)))
        x = np.linspace(0.0, self.end, 2 * _CELLS)
        y = np.maximum.accumulate(self(x))
        self._table = np.interp(np.linspace(0.0, self.last, _CELLS + 1), y, x)
        self._table.flags.writeable = self._coefficients.flags.writeable = False
        if not np.isfinite(self._table).all():
            self.end = self.last = np.nan  # no camera is made of such numbers

    def __call__(self, x: Array) -> Array:
        return np.asarray(polyval(x, self._coefficients))

    def inverse(self, y: Array) -> Array:
        """The x of values 0 <= y <= ``last``."""
        from omniscv.cameras import camera_kernels  # slow to load

        flat = np.require(np.asarray(y).reshape(-1), requirements=("C", "W"))
        return np.asarray(
            camera_kernels.invert(flat, self._coefficients, self._table, self.last).reshape(np.shape(y))
        )


def first_positive_root(coefficients: ArrayLike) -> float:
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
