"""Protocols of papers by name: their own alignments, clipping, definitions and means over images.

Each one is a function of an image's predictions and truths, whose figures are then averaged over images.
Formulas are those of the authors' evaluation code:

``depth-anywhere``     Wang and Liu 2024, utils/metric.py: disparity, scale and shift in disparity by least
                       squares, at most 10 m, then medians, then both clipped to 0.1 to 10 m
``depth-any-camera``   Guo and others 2025, dac/utils/metrics.py: metres, no alignment
``unik3d``             Piccinelli and others 2025, unik3d/utils/evaluation_depth.py: metres; ``_si`` by
                       medians; ``_ssi`` by least squares without the largest 5 % of errors
``moge``               Wang and others 2025, moge/test/metrics.py: metres; scale, and scale and shift, by the
                       least sum of relative errors at 64 x 64 pixels; scale and shift of disparity by least
                       squares

Their medians are the lower one of two middle values, as PyTorch's are.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import one_of
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask

Figures = dict[str, float]

_DELTAS = (1.25, 1.25**2, 1.25**3)
_LOW_M = 0.1  # of Depth Anywhere
_HIGH_M = 10.0
_ADDED = 1e-6  # to squares, by Depth Any Camera; to depths, by MoGe
_KEPT_ERRORS = 0.95  # quantile of errors that UniK3D fits to
_RIDGE = 1e-4  # of UniK3D's fit
_MOGE_SIZE = 64  # px of the picture that MoGe aligns
_ANCHORS = 16  # points that the best line may pass through


class Protocol(NamedTuple):
    """A protocol.

    Attributes:
        form: what predictions hold, ``range`` or ``disparity``, which may be of any scale and shift.
        figures: of predictions (H, W), truths (H, W) metres, and pixels that count (H, W) bool.
    """

    form: str
    figures: Callable[[Array, Array, Mask], Figures]


def protocol(name: str, predicted: ArrayLike, truth: ArrayLike, valid: ArrayLike) -> Figures:
    """Return the figures of one image by a protocol.

    Args:
        name: one of :data:`PROTOCOLS`.
        predicted: (H, W) as the protocol's form says.
        truth: (H, W) metres.
        valid: (H, W) bool, pixels that count; their truth is above 0.

    Raises:
        ArgumentError: an unknown protocol, or no pixel that counts.
    """
    one_of("protocol", name, PROTOCOLS)
    mask = np.asarray(valid, np.bool_)
    if not mask.any():
        raise ArgumentError("valid: expected a pixel that counts, got none")
    return PROTOCOLS[name].figures(np.asarray(predicted, np.float64), np.asarray(truth, np.float64), mask)


def _median(values: Array) -> float:
    """Return the lower one of the middle values."""
    middle = (values.size - 1) // 2
    return float(np.partition(values.ravel(), middle)[middle])


def _ratios(p: Array, t: Array) -> Array:
    """Return ``max(p / t, t / p)``; infinite where a prediction is 0 or less."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.maximum(p / t, t / p))


def _line(x: Array, y: Array, ridge: float = 0.0) -> tuple[float, float]:
    """Return scale and shift with the least sum of squares of ``scale * x + shift - y``.

    Args:
        x: (N,).
        y: (N,).
        ridge: added to the diagonal of the normal equations.
    """
    matrix = np.array([[x @ x + ridge, x.sum()], [x.sum(), len(x) + ridge]])
    if ridge == 0:
        scale, shift = np.linalg.lstsq(np.stack([x, np.ones(len(x))], axis=1), y, rcond=None)[0]
        return float(scale), float(shift)
    scale, shift = np.linalg.solve(matrix, np.array([x @ y, y.sum()]))
    return float(scale), float(shift)


def _depth_anywhere(predicted: Array, truth: Array, valid: Mask) -> Figures:
    """Return Depth Anywhere's figures of a disparity."""
    t = truth[valid]
    disparity = predicted[valid]
    scale, shift = _line(disparity, 1 / t)
    fitted = scale * disparity + shift
    depth = np.divide(1, fitted, out=np.zeros_like(fitted), where=fitted != 0)
    p = np.clip(depth, 0, _HIGH_M)
    p = np.clip(p * (_median(t) / _median(p)), _LOW_M, _HIGH_M)
    t = np.clip(t, _LOW_M, _HIGH_M)
    error = np.abs(p - t)
    ratio = _ratios(p, t)
    figures = {
        "abs": error.mean(),
        "abs_rel": (error / t).mean(),
        "sq_rel": (error**2 / t).mean(),
        "rmse": np.sqrt((error**2).mean()),
        "rmse_log": np.sqrt(((np.log10(t + 1) - np.log10(p + 1)) ** 2).mean()),
        "log10": np.abs(np.log10(p / t)).mean(),
    }
    for number, limit in enumerate(_DELTAS, 1):
        figures[f"a{number}"] = (ratio < limit).mean()
    return _plain(figures)


def _depth_any_camera(predicted: Array, truth: Array, valid: Mask) -> Figures:
    """Return Depth Any Camera's figures of metres."""
    p = predicted[valid]
    t = truth[valid]
    error = np.abs(p - t)
    ratio = _ratios(p, t)
    logs = np.log(p) - np.log(t)
    figures = {"d05": (ratio < 1.25**0.5).mean()}
    for number, limit in enumerate(_DELTAS, 1):
        figures[f"d{number}"] = (ratio < limit).mean()
    figures |= {
        "rmse": np.sqrt((error**2 + _ADDED).mean()),
        "rmse_log": np.sqrt((logs**2 + _ADDED).mean()),
        "abs_rel": (error / t).mean(),
        "sq_rel": (error**2 / t).mean(),
        "log10": np.abs(np.log10(p) - np.log10(t)).mean(),
        "silog": 100 * logs.std(ddof=1),
        "scale": (t / p).mean(),
    }
    return _plain(figures)


def _unik3d(predicted: Array, truth: Array, valid: Mask) -> Figures:
    """Return UniK3D's figures of metres."""
    p = predicted[valid]
    t = truth[valid]
    error = np.abs(p - t)
    ratio = _ratios(p, t)
    logs = np.log(p) - np.log(t)
    figures = {}
    for number, limit in enumerate(_DELTAS, 1):
        figures[f"d{number}"] = (ratio < limit).mean()
    exponents = np.linspace(0.01, 5, 100)
    shares = [(ratio < 1.25**exponent).mean() for exponent in exponents]
    figures |= {
        "rmse": np.sqrt((error**2).mean()),
        "rmselog": np.sqrt((logs**2).mean()),
        "arel": (error / t).mean(),
        "sqrel": (error**2 / t).mean(),
        "log10": np.abs(np.log10(p) - np.log10(t)).mean(),
        "silog": 100 * logs.std(ddof=1),
        "medianlog": 100 * abs(_median(logs)),
        "d_auc": np.trapezoid(shares, exponents) / 5,
        "tau": (ratio < 1.03).mean(),
    }
    is_kept = error < np.quantile(error, _KEPT_ERRORS)
    scale, shift = _line(p[is_kept], t[is_kept], _RIDGE)
    aligned = {"ssi": p * scale + shift, "si": p * (_median(t) / _median(p))}
    for name, values in aligned.items():
        of_aligned = _ratios(values, t)
        figures[f"d1_{name}"] = (of_aligned < _DELTAS[0]).mean()
        figures[f"tau_{name}"] = (of_aligned < 1.03).mean()
        figures[f"arel_{name}"] = (np.abs(t - values) / t).mean()
    return _plain(figures)


def _moge(predicted: Array, truth: Array, valid: Mask) -> Figures:
    """Return MoGe's figures of metres, by each of its alignments."""
    p = predicted[valid]
    t = truth[valid]
    small_p, small_t = _sampled(predicted, truth, valid)
    scale = _nearest_scale(small_p, small_t, 1 / small_t)
    slope, offset = _nearest_line(small_p, small_t, 1 / small_t)
    of_disparity, shift = _line(1 / p, 1 / t)
    disparity = np.maximum(of_disparity / p + shift, 1 / t.max())
    figures = {}
    for name, values in {
        "metric": p, "scale": p * scale, "affine": p * slope + offset, "disparity": 1 / disparity
    }.items():  # fmt: skip
        figures[f"rel_{name}"] = (np.abs(values - t) / (t + _ADDED)).mean()
        figures[f"delta1_{name}"] = (_ratios(values, t) < _DELTAS[0]).mean()
    return _plain(figures)


def _sampled(predicted: Array, truth: Array, valid: Mask) -> tuple[Array, Array]:
    """Return the values of 64 x 64 pixels: of each, the nearest pixel in its window that counts."""
    height, width = valid.shape
    tall = max(1.0, height / _MOGE_SIZE)
    wide = max(1.0, width / _MOGE_SIZE)
    v = ((np.arange(_MOGE_SIZE) + 0.5) / _MOGE_SIZE * height)[:, None]
    u = ((np.arange(_MOGE_SIZE) + 0.5) / _MOGE_SIZE * width)[None, :]
    top = np.round((v - tall / 2).astype(np.float32)).astype(np.int64)
    left = np.round((u - wide / 2).astype(np.float32)).astype(np.int64)
    nearest = np.full((_MOGE_SIZE, _MOGE_SIZE), np.inf)
    index = np.zeros((_MOGE_SIZE, _MOGE_SIZE), np.int64)
    for i in range(int(np.ceil(tall))):
        for j in range(int(np.ceil(wide))):
            row, column = np.broadcast_arrays(top + i, left + j)
            is_inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            inside_row = np.clip(row, 0, height - 1)
            inside_column = np.clip(column, 0, width - 1)
            away = np.hypot(row + 0.5 - v, column + 0.5 - u)
            is_nearer = is_inside & valid[inside_row, inside_column] & (away < nearest)
            nearest = np.where(is_nearer, away, nearest)
            index = np.where(is_nearer, inside_row * width + inside_column, index)
    chosen = index[np.isfinite(nearest)]
    return predicted.ravel()[chosen], truth.ravel()[chosen]


def _nearest_scale(x: Array, y: Array, weights: Array) -> float:
    """Return the scale with the least sum of ``weights * |scale * x - y|``: a weighted median of y / x."""
    return float(_nearest_scales(x[None], y[None], weights[None])[0][0])


def _nearest_scales(x: Array, y: Array, weights: Array) -> tuple[Array, Array]:
    """Return the best scale of each row, and its sum."""
    sign = np.sign(x)
    x = x * sign
    y = y * sign
    ratios = y / np.maximum(x, 1e-7)
    order = np.argsort(ratios, axis=1, kind="stable")
    wx = np.take_along_axis(weights * x, order, axis=1)
    rise = 2 * wx.cumsum(axis=1) - wx.sum(axis=1, keepdims=True)
    middle = np.minimum((rise < 0).sum(axis=1), x.shape[1] - 1)
    rows = np.arange(len(x))
    scale = ratios[rows, order[rows, middle]]
    return scale, (weights * np.abs(scale[:, None] * x - y)).sum(axis=1)


def _nearest_line(x: Array, y: Array, weights: Array) -> tuple[float, float]:
    """Return scale and shift with the least sum of ``weights * |scale * x + shift - y|``.

    With the best scale of each shift the sum is convex in the shift, which is searched for. The best line
    passes through one of the points: those that are nearest to it are tried.
    """
    from scipy.optimize import minimize_scalar

    def line(shift: float) -> tuple[float, float]:
        """Return the best scale, and its sum."""
        scale, total = _nearest_scales(x[None], y[None] - shift, weights[None])
        return float(scale[0]), float(total[0])

    _, first = _line(x, y)
    width = float(np.ptp(y))
    shift = float(
        minimize_scalar(lambda b: line(b)[1], (first - width, first + width), method="golden", tol=1e-10).x
    )
    anchors = np.argsort(np.abs(line(shift)[0] * x + shift - y))[:_ANCHORS]
    from_x = x[None] - x[anchors, None]
    from_y = y[None] - y[anchors, None]
    scales, sums = _nearest_scales(from_x, from_y, np.broadcast_to(weights, from_x.shape))
    row = int(np.argmin(sums))
    return float(scales[row]), float(y[anchors[row]] - scales[row] * x[anchors[row]])


def _plain(figures: Mapping[str, object]) -> Figures:
    """Return figures as Python's numbers."""
    return {name: float(value) for name, value in figures.items()}  # type: ignore[arg-type]


PROTOCOLS = {
    "depth-anywhere": Protocol("disparity", _depth_anywhere),
    "depth-any-camera": Protocol("range", _depth_any_camera),
    "unik3d": Protocol("range", _unik3d),
    "moge": Protocol("range", _moge),
}
"""Protocols by name."""
