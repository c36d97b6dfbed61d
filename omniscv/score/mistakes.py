"""What a prediction reads as, where it was taken for something else: planar depth, another unit, a mirrored
picture, another lens.

Two kinds of evidence name a mistake.

Whole pictures: each other reading is tried on a grid of pixels. The one with the least AbsRel is named where
that is less than half of the AbsRel of the reading that was said.

Edges (:mod:`omniscv.score.steps`): a shift by a column or by half a pixel changes AbsRel less than a
network's error does, but it moves edges. A network's error is smooth.

Where neither names one, depth that ends at a limit is looked for.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from omniscv.cameras import Camera
from omniscv.geometry import Array
from omniscv.geometry.arrays import Ints, Mask
from omniscv.score import steps
from omniscv.score.areas import seen_pixels, solid_angles
from omniscv.score.other_lenses import other_lenses

_MUCH_BETTER = 0.5
"""Error of another reading, relative to that of the one that was said."""
_BETTER = 0.9  # the same, of a turned picture or another lens that edges name
_LEAST_ERROR = 0.02
"""AbsRel of a reading as it was said from which on another one is looked for: less is no mistake of
reading."""
_KEPT = 4  # cameras whose cosines are kept
UNITS = (1000.0, 100.0, 10.0, 0.1, 0.01, 0.001)
_GRID = 5000  # pixels at which readings are compared
_CLIPPED = 0.02  # least share of pixels whose depth is clipped
_BEYOND = 1.1  # ratio of truth and the limit from which on a pixel is clipped
_FLAT = 0.4  # slope of clipped log p over log t, which is 1 of sound ones
_NEARER = 0.6  # error of a limit, relative to that of the truth, where depth is clipped
_CLEAR = 2.5  # error of clipped depth, relative to that of the rest
_FEWEST = 64  # pixels of which a limit is looked for
_FAR_SHARES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)  # of the farthest pixels, of which a limit is measured

Reading = Callable[[Array, Ints, Ints], Array]
"""Returns metres along rays (N,), for a picture (H, W) and the rows and columns (N,) of its pixels."""


class Mistake(NamedTuple):
    """What a prediction reads as.

    Attributes:
        word: ``planar``, ``range``, ``disparity``, ``mirrored``, ``flipped``, ``rolled``, ``shifted by N
            columns``, ``unit N``, ``lens``, ``clipped``, ``pixel``, or ``frame``.
        as_said: AbsRel by solid angle of the reading that was said; of ``frame``, degrees.
        so: the same of this one.
        detail: more of it, such as the lens; empty for nothing.
    """

    word: str
    as_said: float
    so: float
    detail: str = ""

    def line(self) -> str:
        """Return the mistake as a line for people."""
        detail = f" ({self.detail})" if self.detail else ""
        if self.word == "frame":
            return f"reads as frame{detail}: {self.as_said:.1f} degrees as said, {self.so:.1f} so"
        return f"reads as {self.word}{detail}: AbsRel {self.as_said:.3f} as said, {self.so:.3f} so"


class Pictures(NamedTuple):
    """A prediction and its truth.

    Attributes:
        said: (H, W) metres along rays, as it was said.
        true: (H, W) metres along rays.
        known: (H, W) bool, which pixels have a truth beyond doubt.
        camera: of both.
    """

    said: Array
    true: Array
    known: Mask
    camera: Camera

    def grid(self) -> tuple[Ints, Ints]:
        """Return rows and columns (N,) of known pixels, at most about ``_GRID``."""
        step = max(1, int(np.sqrt(self.true.size / _GRID)))
        rows, columns = np.nonzero(self.known[step // 2 :: step, step // 2 :: step])
        return rows * step + step // 2, columns * step + step // 2

    def error(self, values: Array, rows: Ints, columns: Ints, truth: Array | None = None) -> float:
        """Return AbsRel by solid angle of values (N,) at pixels; infinite where half of them have none.

        Args:
            values: (N,) metres.
            rows: (N,) of the pixels.
            columns: (N,) of the pixels.
            truth: (N,) metres; None: that of the pixels.
        """
        true = self.true[rows, columns] if truth is None else truth
        areas = solid_angles(self.camera)[rows, columns]
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            relative = np.abs(values / true - 1)
            relative[~((values > 0) & (true > 0) & (relative < np.inf))] = np.nan
        has_value = ~np.isnan(relative)
        if has_value.all():
            return float(areas @ relative / areas.sum())
        if np.count_nonzero(has_value) < 0.5 * len(values):
            return np.inf
        return float(areas[has_value] @ relative[has_value] / areas[has_value].sum())

    def scaled_error(self, values: Array, rows: Ints, columns: Ints) -> float:
        """Return :meth:`error` after a scale by medians: a wrong scale is no wrong reading."""
        true = self.true[rows, columns]
        has_value = np.isfinite(values) & (values > 0)
        if not has_value.any():
            return np.inf
        scale = np.median(true[has_value]) / np.median(values[has_value])
        return self.error(values * scale, rows, columns)


def find_mistakes(
    predicted: ArrayLike, truth: ArrayLike, camera: Camera, doubt: ArrayLike | None = None
) -> list[Mistake]:
    """Return what a prediction of metres along rays reads as instead; empty where it is what it says.

    Args:
        predicted: (H, W) metres along rays, as it was said.
        truth: (H, W) metres along rays.
        camera: of both, with one optical centre.
        doubt: (H, W) bool, pixels that are not compared.
    """
    said = np.asarray(predicted, np.float64)
    true = np.asarray(truth, np.float64)
    known = seen_pixels(camera) & np.isfinite(true) & (true > 0)
    if doubt is not None:
        known &= ~np.asarray(doubt, np.bool_)
    pictures = Pictures(said, true, known, camera)
    rows, columns = pictures.grid()
    if not len(rows):
        return []
    as_said = pictures.error(said[rows, columns], rows, columns)
    mistake = None
    if as_said >= _LEAST_ERROR:
        mistake = _by_reading(pictures, rows, columns, as_said)
    if mistake is None:
        mistake = _by_steps(pictures, rows, columns, as_said)
    if mistake is None:
        mistake = _by_limit(pictures, rows, columns, as_said)
    return [] if mistake is None else [mistake]


def _by_reading(pictures: Pictures, rows: Ints, columns: Ints, as_said: float) -> Mistake | None:
    """Return the best of all readings of whole pictures; None where none is much better."""
    best: Mistake | None = None
    scaled = pictures.scaled_error(pictures.said[rows, columns], rows, columns)
    for word, detail, read in _readings(pictures.camera):
        values = read(pictures.said, rows, columns)
        error = pictures.error(values, rows, columns)
        if error >= _MUCH_BETTER * as_said or (best is not None and error >= best.so):
            continue
        explains_more = word.startswith("unit")
        if explains_more or pictures.scaled_error(values, rows, columns) < _BETTER * scaled:
            best = Mistake(word, as_said, error, detail)
    return best


def _readings(camera: Camera) -> Iterator[tuple[str, str, Reading]]:
    """Yield other readings of a picture, each with its word and its detail."""
    axis = _cosines(camera)
    if axis is not None:
        yield "planar", "", partial(_along_ray, axis=axis)
        yield "range", "", partial(_along_axis, axis=axis)
    yield "disparity", "", _inverse
    for unit in UNITS:
        yield f"unit {unit:g}", "", partial(_in_unit, unit=unit)
    yield "mirrored", "", partial(_turned, is_mirrored=True)
    yield "flipped", "", partial(_turned, is_flipped=True)
    yield "rolled", "", partial(_turned, is_mirrored=True, is_flipped=True)
    for lens in other_lenses(camera):
        yield "lens", lens.name, partial(_by_lens, camera=camera, lens=lens.camera)


@lru_cache(_KEPT)
def _cosines(camera: Camera) -> Array | None:
    """Return (H, W) cosines of rays and the optical axis; None where some look beside it, or behind."""
    rays = camera.unproject()
    axis = rays.directions[..., 2]
    return axis if (axis[rays.valid] > 0).all() else None


def _along_ray(values: Array, rows: Ints, columns: Ints, axis: Array) -> Array:
    """Return what planar depth is along the ray; ``axis``: cosines of rays and the optical axis."""
    return np.asarray(values[rows, columns] / axis[rows, columns])


def _along_axis(values: Array, rows: Ints, columns: Ints, axis: Array) -> Array:
    """Return what depth along the ray is along the optical axis."""
    return np.asarray(values[rows, columns] * axis[rows, columns])


def _in_unit(values: Array, rows: Ints, columns: Ints, unit: float) -> Array:
    """Return metres of values of which ``unit`` are a metre."""
    return np.asarray(values[rows, columns] / unit)


def _inverse(values: Array, rows: Ints, columns: Ints) -> Array:
    """Return 1 / values, NaN where there is none."""
    read = values[rows, columns]
    with np.errstate(divide="ignore"):
        return np.where(read > 0, 1 / read, np.nan)


def _turned(
    values: Array, rows: Ints, columns: Ints, is_mirrored: bool = False, is_flipped: bool = False
) -> Array:
    """Return the values of a picture that is mirrored, flipped, or both."""
    height, width = values.shape
    if is_flipped:
        rows = height - 1 - rows
    if is_mirrored:
        columns = width - 1 - columns
    return np.asarray(values[rows, columns])


def _by_lens(values: Array, rows: Ints, columns: Ints, camera: Camera, lens: Camera) -> Array:
    """Return what a picture by a ``lens`` shows along a camera's rays, NaN where it shows nothing."""
    directions = camera.unproject(np.stack([columns, rows], axis=-1) + 0.5).directions
    pixels, is_seen = lens.project(directions)
    u, v = np.where(is_seen[:, None], pixels, 0).astype(np.int64).T
    read = values[np.minimum(v, lens.height - 1), np.minimum(u, lens.width - 1)]
    return np.where(is_seen, read, np.nan)


def _by_steps(pictures: Pictures, rows: Ints, columns: Ints, as_said: float) -> Mistake | None:
    """Return what edges say; None where the prediction is worse so."""
    edges = steps.compare(pictures.said, pictures.true, pictures.camera)
    if edges is None:
        return None
    if edges.shift != (0.0, 0.0):
        said = pictures.said[rows, columns]
        true = pictures.true[rows, columns]
        has_truth = seen_pixels(pictures.camera) & np.isfinite(pictures.true) & (pictures.true > 0)
        known = np.where(has_truth, pictures.true, np.nan)
        moved = steps.moved(known, rows, columns, edges.shift, pictures.camera.wraps)
        error = pictures.error(said, rows, columns, moved)
        is_better = _square_error(said, moved) < _square_error(said, true)
        return Mistake(edges.word, as_said, error, edges.detail) if is_better else None
    read = _turned(pictures.said, rows, columns, edges.is_mirrored, edges.is_flipped)
    if edges.lens is not None:
        read = _by_lens(pictures.said, rows, columns, pictures.camera, edges.lens)
    error = pictures.error(read, rows, columns)
    return Mistake(edges.word, as_said, error, edges.detail) if error < _BETTER * as_said else None


def _square_error(said: Array, true: Array) -> float:
    """Return the mean squared logarithm of ratios (N,); infinite where there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(said / true)
    known = logs[np.isfinite(logs)]
    return float((known * known).mean()) if len(known) else np.inf


def _by_limit(pictures: Pictures, rows: Ints, columns: Ints, as_said: float) -> Mistake | None:
    """Return that depth is clipped, where a limit tells far, or near, pixels better than the truth does."""
    said = pictures.said[rows, columns]
    true = pictures.true[rows, columns]
    has_value = np.isfinite(said) & (said > 0)
    logs_said = np.log(said[has_value])
    logs_true = np.log(true[has_value])
    for sign in (1, -1):  # the farthest, the nearest
        limit = _limit(sign * logs_said, sign * logs_true)
        if limit is not None:
            metres = float(np.exp(sign * limit))
            so = np.minimum(true, metres) if sign > 0 else np.maximum(true, metres)
            relative = np.where(has_value, np.abs(said - so) / so, 0)
            areas = solid_angles(pictures.camera)[rows, columns] * has_value
            error = float(areas @ relative / areas.sum())
            return Mistake("clipped", as_said, error, f"at {metres:.3g} m")
    return None


def _limit(logs_said: Array, logs_true: Array) -> float | None:
    """Return the logarithm at which predictions (N,) are clipped from above; None where they are not."""
    if len(logs_true) < _FEWEST:
        return None
    order = np.sort(logs_true)
    for share in _FAR_SHARES:
        is_far = logs_true >= order[int((1 - share) * (len(order) - 1))]
        limit = float(np.median(logs_said[is_far]))
        is_beyond = logs_true > limit + np.log(_BEYOND)
        if np.count_nonzero(is_beyond) < max(4, _CLIPPED * len(logs_true)):
            continue
        beyond = logs_said[is_beyond]
        true = logs_true[is_beyond]
        below = ~is_beyond & (logs_true < limit)
        scale = np.median((logs_said - logs_true)[below]) if below.any() else 0.0
        off_limit = np.abs(beyond - limit).mean()
        off_truth = np.abs(beyond - true - scale).mean()
        rise = (true - true.mean()) @ (beyond - beyond.mean())
        is_flat = rise < _FLAT * ((true - true.mean()) ** 2).sum()
        off_below = np.abs((logs_said - logs_true)[below] - scale).mean() if below.any() else 0.0
        if is_flat and off_limit < _NEARER * off_truth and off_truth > _CLEAR * off_below:
            return limit
    return None
