"""Measures of depth, each with its published definition.

Of predictions p and truths t, metres, with weights that sum to 1: Eigen, Puhrsch and Fergus, Depth map
prediction from a single image, 2014, for ``abs_rel`` to ``delta3`` and ``silog`` (100 times the root of the
variance of ``log p - log t``, as KITTI's benchmark has it); Ornek and others 2022 use the finer deltas.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

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


def figures(means_of: Terms, share: Array, variance: float, log_size: Array) -> DepthMeasures:
    """Return the measures.

    Args:
        means_of: the terms.
        share: (N,) weights that sum to 1.
        variance: of ``log p - log t``.
        log_size: (N,) its absolute value, the logarithm of the ratio.
    """
    ratio = means_of.ratio
    return DepthMeasures(
        abs_rel=float(share @ means_of.relative),
        sq_rel=float(share @ means_of.relative_square),
        rmse=float(np.sqrt(share @ means_of.square)),
        rmse_log=float(np.sqrt(share @ (log_size * log_size))),
        silog=100 * float(np.sqrt(max(0.0, variance))),
        mae=float(share @ means_of.absolute),
        inlier3=float(share @ (ratio < 1.03)),
        delta105=float(share @ (ratio < 1.05)),
        delta110=float(share @ (ratio < 1.10)),
        delta1=float(share @ (ratio < 1.25)),
        delta2=float(share @ (ratio < 1.25**2)),
        delta3=float(share @ (ratio < 1.25**3)),
    )


def measures(p: Array, t: Array, weights: Array) -> DepthMeasures:
    """Return the measures of predictions and truths, (N,) metres above 0, with weights (N,) of any sum."""
    share = weights / weights.sum()
    means_of = terms(p, t)
    log_size = np.log(means_of.ratio)
    logs = np.copysign(log_size, p - t)
    logs -= share @ logs
    return figures(means_of, share, float(share @ (logs * logs)), log_size)
