"""Polynomials on the branch where they increase, and their inverse there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike

from omniscv.cameras.base import Array

_TABLE = 2048
_NEWTON_STEPS = 3
_BISECTIONS = 60
_HALVINGS = 70  # from a ratio of 1e300 to the last digit
_EPS = np.finfo(np.float64).eps
_BLOCK = 1 << 14  # values solved together: their arrays stay in the processor's cache


def first_positive_root(coefficients: ArrayLike) -> float:
    """The least x > 0 from which on ``c_0 + c_1 x + c_2 x^2 + ...``, positive at 0, is negative.

    Infinite if it never is. A root that the polynomial only touches is no crossing: the branch goes on.
    """
    trimmed = np.trim_zeros(np.asarray(coefficients, dtype=np.float64), "b")
    if trimmed.size < 2:
        return np.inf
    constant, least = trimmed[0], 1e-300 * np.abs(trimmed).max()
    if abs(constant) < least:  # a root next to 0 stays next to 0, and its reciprocal finite
        trimmed = np.append(np.copysign(least, constant), trimmed[1:])
    # Coefficients that are next to nothing have roots next to infinity, where all may overflow.
    with np.errstate(all="ignore"):
        # The least root is the greatest reciprocal, which the solver finds best. Roots that coincide come
        # out scattered in the complex plane; a crossing is next to the real part of one all the same.
        roots = 1 / np.roots(trimmed).astype(np.complex128)
        near = np.sort(roots.real[np.isfinite(roots) & (roots.real > 0)])
        if not near.size:
            return np.inf
        between = np.sqrt(near) * np.sqrt(np.append(near[1:], 4 * near[-1]))
        rounding = _EPS * len(trimmed) * polyval(between, np.abs(trimmed))
        negative = polyval(between, trimmed) < -rounding
        if not negative.any():
            return np.inf
        first = int(np.argmax(negative))
        return _crossing(trimmed, between[first - 1] if first else near[0] / 2, between[first])


def _crossing(coefficients: Array, low: float, high: float) -> float:
    """Where a polynomial, positive at ``low`` > 0, becomes negative before ``high``: halves their ratio."""
    for _ in range(_HALVINGS):
        middle = np.sqrt(low) * np.sqrt(high)
        low, high = (low, middle) if polyval(middle, coefficients) < 0 else (middle, high)
    return float(low)


def invert(
    function: Callable[[Array], Array], slope: Callable[[Array], Array], end: float, values: Array
) -> Array:
    """x in [0, end] with ``function(x) = value``, for a function that increases there.

    A table gives the start, Newton's steps the digits; where the slope vanishes, at the end of the
    branch, the interval of the table is halved instead. Values outside the range give its ends.

    Args:
        function, slope: vectorised.
        end: finite.
        values: (...).
    """
    x_table = np.linspace(0.0, end, _TABLE)
    y_table = np.maximum.accumulate(function(x_table))
    flat = values.ravel()
    result = np.empty(flat.shape)
    for start in range(0, flat.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        result[part] = _invert_block(function, slope, x_table, y_table, flat[part])
    return result.reshape(values.shape)


def _invert_block(
    function: Callable[[Array], Array],
    slope: Callable[[Array], Array],
    x_table: Array,
    y_table: Array,
    values: Array,
) -> Array:
    cell = np.clip(np.searchsorted(y_table, values) - 1, 0, len(x_table) - 2)
    low, high = x_table[cell], x_table[cell + 1]
    x = np.clip(np.interp(values, y_table, x_table), low, high)
    for _ in range(_NEWTON_STEPS):
        gradient = slope(x)
        step = (function(x) - values) / np.where(gradient > 0, gradient, np.inf)
        x = np.clip(x - step, low, high)
    gradient = slope(x)
    residual = np.abs(function(x) - values)
    bad = np.flatnonzero(~(residual <= 4e-16 * (np.abs(values) + gradient * np.abs(x))))
    if bad.size:
        a, b, wanted = low[bad], high[bad], values[bad]
        for _ in range(_BISECTIONS):
            middle = (a + b) / 2
            below = function(middle) < wanted
            a, b = np.where(below, middle, a), np.where(below, b, middle)
        x[bad] = (a + b) / 2
    return x
