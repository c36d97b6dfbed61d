"""What a figure can be where truth is known within bounds only: the least and the greatest value.

A pixel's truth t lies in [low, high], and its prediction in [q_low, q_high]: one value without alignment.
The terms of all measures but ``silog`` fall and then rise along t and along q, with their least value where
both are equal. So the least mean has each pixel's nearest pair, the greatest its farthest one, and both are
attained.

``silog`` is a standard deviation. Its least value is attained: some value c is nearest to all intervals of
log q - log t. To find its greatest value is NP-hard (Ferson and others 2002, Computing variance for interval
data is NP-hard). The bound here is the least one over c of the mean of the largest squares around c, which no
truth exceeds, and which exceeds what truths attain by about the share of one pixel.

With alignment, q depends on all truths at once. The numbers of the alignment, scale and shift, lie within
limits that are attained. These are cut into cells, in each of which q has its own interval, and the extremes
over all cells bound the figure. They are not attained.
"""

from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from omniscv.geometry import Array
from omniscv.score.measures import DepthMeasures, Terms, figures, terms

_CELLS = 12  # of a scale
_CELLS_OF_EACH = 8  # of a scale, and of a shift
_STEPS = 16  # halvings of the width of a mean's interval; what is left counts squared


class Interval(NamedTuple):
    """The least and the greatest value of each measure that truths within their bounds can give.

    Attributes:
        low: the least values, each by a truth of its own.
        high: the greatest ones.
    """

    low: DepthMeasures
    high: DepthMeasures


class Truths(NamedTuple):
    """Bounds of the truths of N pixels, metres, with their weights.

    Attributes:
        low, high: (N,) above 0.
        weights: (N,) of any sum.
    """

    low: Array
    high: Array
    weights: Array


def interval(p: Array, truths: Truths, how: str = "none") -> Interval | None:
    """Return the interval of each measure of predictions; None where a truth within the bounds lets an
    alignment leave out pixels, whose depth becomes 0 or less.

    Args:
        p: (N,) metres above 0, as they were predicted.
        truths: bounds of the truth.
        how: the alignment, one of :data:`omniscv.score.ALIGNMENTS`.
    """
    if how == "none":
        return _within(p, p, truths)
    keeps_silog = how in ("median", "scale")  # a scale does not change it
    parts = []
    for q_low, q_high in _aligned(p, truths, how):
        if not (np.isfinite(q_high).all() and (q_low > 0).all()):
            return None
        parts.append(_within(q_low, q_high, truths, has_silog=not keeps_silog))
    united = _union(parts)
    if not keeps_silog:
        return united
    plain = _within(p, p, truths)
    return Interval(replace(united.low, silog=plain.low.silog), replace(united.high, silog=plain.high.silog))


def _within(q_low: Array, q_high: Array, truths: Truths, has_silog: bool = True) -> Interval:
    """Return the interval for predictions (N,) between ``q_low`` and ``q_high``, each by itself."""
    share = truths.weights / truths.weights.sum()
    is_above = q_low > truths.high
    is_below = q_high < truths.low
    t = np.where(is_below, truths.low, truths.high)
    q = np.where(is_above, q_low, np.where(is_below, q_high, t))
    nearest = terms(q, t)
    far = terms(q_high, truths.low)
    farthest = Terms(*map(np.maximum, far, terms(q_low, truths.high)))
    variances = (0.0, 0.0)
    if has_silog:
        a = np.log(q_low / truths.high)
        b = np.log(q_high / truths.low)
        variances = _least_variance(a, b, share), _greatest_variance(a, b, share)
    low = figures(nearest, share, variances[0], np.log(nearest.ratio))
    high = figures(farthest, share, variances[1], np.log(farthest.ratio))
    # Shares of inliers are least where ratios are greatest.
    least = {name: value for name, value in vars(high).items() if _is_share(name)}
    greatest = {name: value for name, value in vars(low).items() if _is_share(name)}
    return Interval(replace(low, **least), replace(high, **greatest))


def _is_share(name: str) -> bool:
    """Return whether a measure is a share of inliers."""
    return name.startswith(("delta", "inlier"))


def _least_variance(a: Array, b: Array, share: Array) -> float:
    """Return the least variance of values between ``a`` and ``b`` (N,).

    It is the mean of the squared distances from the c where those above and below it balance. What the search
    for c leaves is taken off: the mean is convex in c.
    """
    low = float(share @ a)
    high = float(share @ b)
    for _ in range(_STEPS):
        c = (low + high) / 2
        off = np.clip(c, a, b) - c
        pull = float(share @ off)
        if pull > 0:
            low = c
        else:
            high = c
    return max(0.0, float(share @ (off * off)) - 2 * abs(pull) * (high - low))


def _greatest_variance(a: Array, b: Array, share: Array) -> float:
    """Return a bound on the variance of values between ``a`` and ``b`` (N,); see the module's first page."""
    low = float(share @ a)
    high = float(share @ b)
    middles = (a + b) / 2
    for _ in range(_STEPS):
        c = (low + high) / 2
        if float(share @ np.where(middles > c, b, a)) > c:
            low = c
        else:
            high = c
    return float(share @ np.maximum((a - c) ** 2, (b - c) ** 2))


def _union(parts: list[Interval]) -> Interval:
    """Return the interval that holds all of some."""
    low: dict[str, Any] = {}
    high: dict[str, Any] = {}
    for field in fields(DepthMeasures):
        low[field.name] = min(getattr(part.low, field.name) for part in parts)
        high[field.name] = max(getattr(part.high, field.name) for part in parts)
    return Interval(DepthMeasures(**low), DepthMeasures(**high))


def _aligned(p: Array, truths: Truths, how: str) -> Iterator[tuple[Array, Array]]:
    """Yield limits of aligned predictions, (N,) each, for cells that hold all alignments."""
    if how in ("median", "scale"):
        least, greatest = _scales(p, truths, how)
        edges = np.linspace(least, greatest, _CELLS + 1)
        for first, last in pairwise(edges):
            yield first * p, last * p
    elif how == "scale-shift":
        yield from _lines(p, truths)
    else:
        inverted = Truths(1 / truths.high, 1 / truths.low, truths.weights)
        for low, high in _lines(1 / p, inverted):
            with np.errstate(divide="ignore"):
                yield np.where(high > 0, 1 / high, -1), np.where(low > 0, 1 / low, np.inf)


def _scales(p: Array, truths: Truths, how: str) -> tuple[float, float]:
    """Return the least and the greatest scale, which rise with every truth."""
    if how == "median":
        middle = np.median(p)
        return float(np.median(truths.low) / middle), float(np.median(truths.high) / middle)
    wp = truths.weights * p
    return float(wp @ truths.low / (wp @ p)), float(wp @ truths.high / (wp @ p))


def _lines(x: Array, truths: Truths) -> Iterator[tuple[Array, Array]]:
    """Yield limits of ``slope * (x - mean) + middle``, the least-squares lines, in cells.

    Slope and middle are linear in the truths, so their limits are sums of limits. So is every sum of both, by
    which cells in the corners are left out.
    """
    share = truths.weights / truths.weights.sum()
    mean = share @ x
    spread = share @ (x - mean) ** 2
    if spread == 0:
        yield truths.low, truths.high
        return
    of_slope = share * (x - mean) / spread
    slopes = np.linspace(*_limits(of_slope, truths), _CELLS_OF_EACH + 1)
    middles = np.linspace(*_limits(share, truths), _CELLS_OF_EACH + 1)
    deviation = np.sqrt(spread)
    sums = _limits(share + deviation * of_slope, truths)
    differences = _limits(share - deviation * of_slope, truths)
    offset = x - mean
    for i in range(_CELLS_OF_EACH):
        for j in range(_CELLS_OF_EACH):
            scaled = deviation * slopes[i : i + 2]
            middle = middles[j : j + 2]
            is_possible = middle[0] + scaled[0] <= sums[1] and middle[1] + scaled[1] >= sums[0]
            is_possible &= middle[0] - scaled[1] <= differences[1]
            is_possible &= middle[1] - scaled[0] >= differences[0]
            if is_possible:
                ends = slopes[i] * offset, slopes[i + 1] * offset
                yield np.minimum(*ends) + middle[0], np.maximum(*ends) + middle[1]


def _limits(factors: Array, truths: Truths) -> tuple[float, float]:
    """Return the least and the greatest sum of factors (N,) times truths."""
    positive = np.maximum(factors, 0)
    negative = np.minimum(factors, 0)
    low = float(positive @ truths.low + negative @ truths.high)
    return low, float(positive @ truths.high + negative @ truths.low)
