"""Measures of depth, each with its published definition.

Of predictions p and truths t, metres, with weights that sum to 1: Eigen, Puhrsch and Fergus, Depth map
prediction from a single image, 2014, for ``abs_rel`` to ``delta3`` and ``silog`` (100 times the root of the
variance of ``log p - log t``, as KITTI's benchmark has it); Ornek and others 2022 use the finer deltas.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array


@dataclass(frozen=True)
class DepthMeasures:
    """Measures with one kind of weights.

    Attributes:
        abs_rel: mean of ``|p - t| / t``.
        sq_rel: mean of ``(p - t)^2 / t``, metres.
        rmse: root of the mean of ``(p - t)^2``, metres.
        rmse_log: the same of natural logarithms.
        silog: 100 times the standard deviation of ``log p - log t``.
        mae: mean of ``|p - t|``, metres.
        inlier3: share with ``max(p / t, t / p) < 1.03``.
        delta105, delta110: the same below 1.05 and 1.10.
        delta1, delta2, delta3: below 1.25, its square and its cube.
    """

    abs_rel: float
    sq_rel: float
    rmse: float
    rmse_log: float
    silog: float
    mae: float
    inlier3: float
    delta105: float
    delta110: float
    delta1: float
    delta2: float
    delta3: float


class Terms(NamedTuple):
    """What the measures are means of, (N,) each.

    Attributes:
        relative: ``|p - t| / t``.
        relative_square: ``(p - t)^2 / t``.
        absolute: ``|p - t|``.
        square: ``(p - t)^2``.
        ratio: ``max(p / t, t / p)``.
    """

    relative: Array
    relative_square: Array
    absolute: Array
    square: Array
    ratio: Array


def terms(p: Array, t: Array) -> Terms:
    """Return the terms of predictions and truths, (N,) metres above 0."""
    absolute = np.abs(p - t)
    relative = absolute / t
    return Terms(relative, relative * absolute, absolute, absolute * absolute, np.maximum(p / t, t / p))


LIMITS = (1.03, 1.05, 1.10, 1.25, 1.25**2, 1.25**3)
"""Ratios below which shares are counted: ``inlier3`` to ``delta3``."""
_BLOCK = 1 << 14
"""Pixels whose terms are computed at once: they fit a processor's cache."""


def figures(means_of: Terms, share: Array, variance: float, log_size: Array) -> DepthMeasures:
    """Return the measures.

    Args:
        means_of: the terms.
        share: (N,) weights that sum to 1.
        variance: of ``log p - log t``.
        log_size: (N,) its absolute value, the logarithm of the ratio.
    """
    sums = [share @ term for term in (*means_of[:4], log_size * log_size)]
    below = np.cumsum(np.bincount(_steps(means_of.ratio), share, len(LIMITS) + 1), dtype=np.float64)
    return _measures(np.array(sums), variance, below)


def _steps(ratio: Array) -> NDArray[np.uint8]:
    """Return how many of ``LIMITS`` each ratio (N,) is not below."""
    steps = np.zeros(ratio.shape, np.uint8)
    for limit in LIMITS:
        steps += ~(ratio < limit)
    return steps


def _measures(means: Array, variance: float, below: Array) -> DepthMeasures:
    """Return the measures.

    Args:
        means: of the relative error, the relative square, the absolute error, its square, and the squared
            logarithm.
        variance: of ``log p - log t``.
        below: shares below each of ``LIMITS``.
    """
    return DepthMeasures(
        float(means[0]),
        float(means[1]),
        float(np.sqrt(means[3])),
        float(np.sqrt(means[4])),
        100 * float(np.sqrt(max(0.0, variance))),
        float(means[2]),
        *(float(value) for value in np.minimum(below[: len(LIMITS)], 1.0)),
    )


def measures(p: Array, t: Array, weights: Array) -> DepthMeasures:
    """Return the measures of predictions and truths, (N,) metres above 0, with weights (N,) of any sum."""
    return measures_by(p, t, (weights,))[0]


def measures_by(p: Array, t: Array, kinds: Sequence[Array]) -> list[DepthMeasures]:
    """Return the measures with several kinds of weights, each as :func:`measures` does."""
    middle = float(np.log(p[len(p) // 2] / t[len(t) // 2]))  # near the mean, so that squares stay exact
    sums = np.zeros((len(kinds), 7))
    steps = np.zeros((len(kinds), len(LIMITS) + 1))
    for first in range(0, len(p), _BLOCK):
        block = slice(first, first + _BLOCK)
        means_of = terms(p[block], t[block])
        logs = np.log(means_of.ratio)
        log_square = logs * logs
        off_middle = np.copysign(logs, p[block] - t[block]) - middle
        rows = np.stack([*means_of[:4], log_square, off_middle, off_middle * off_middle])
        of_ratio = _steps(means_of.ratio)
        for number, weights in enumerate(kinds):
            sums[number] += rows @ weights[block]
            steps[number] += np.bincount(of_ratio, weights[block], len(LIMITS) + 1)
    results = []
    for number in range(len(kinds)):
        means = sums[number] / steps[number].sum()
        below = np.cumsum(steps[number]) / steps[number].sum()
        results.append(_measures(means[:5], float(means[6] - means[5] ** 2), below))
    return results
