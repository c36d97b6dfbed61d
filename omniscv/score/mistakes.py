"""What a prediction reads as, where it was taken for something else: planar depth, another unit, a mirrored
picture.

Each reading is tried and scored. The one with the least error is named where that is less than half of the
error of the reading that was said.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from omniscv.cameras import Camera
from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask
from omniscv.score.areas import solid_angles

_MUCH_BETTER = 0.5
"""Error of another reading, relative to that of the one that was said."""
_LEAST_ERROR = 0.02
"""AbsRel of a reading as it was said from which on another one is looked for: less is no mistake of
reading."""
UNITS = (1000.0, 100.0, 10.0, 0.1, 0.01, 0.001)
_SHIFTS = 32  # columns that are tried on each side, of a panorama


Reading = Callable[..., Any]
"""Returns metres along rays, (H, W), for what a prediction holds."""


class Mistake(NamedTuple):
    """What a prediction reads as.

    Attributes:
        word: ``planar``, ``range``, ``disparity``, ``mirrored``, ``flipped``, ``rolled``, ``shifted by N
            columns``, or ``unit N``.
        as_said: AbsRel by solid angle of the reading that was said.
        so: AbsRel of this one.
    """

    word: str
    as_said: float
    so: float

    def line(self) -> str:
        """Return the mistake as a line for people."""
        return f"reads as {self.word}: AbsRel {self.as_said:.3f} as said, {self.so:.3f} so"


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
    known = camera.valid() & np.isfinite(true) & (true > 0)
    if doubt is not None:
        known &= ~np.asarray(doubt, np.bool_)
    areas = solid_angles(camera)
    as_said = _error(said, true, known, areas)
    if as_said < _LEAST_ERROR:
        return []
    best: Mistake | None = None
    for word, read in _readings(camera):
        error = _error(read(said), true, known, areas)
        if error < _MUCH_BETTER * as_said and (best is None or error < best.so):
            best = Mistake(word, as_said, error)
    return [] if best is None else [best]


def _error(predicted: Array, true: Array, known: Mask, areas: Array) -> float:
    """Return AbsRel by solid angle over the pixels that have values."""
    both = known & np.isfinite(predicted) & (predicted > 0)
    if np.count_nonzero(both) < 0.5 * np.count_nonzero(known):
        return np.inf
    relative = np.abs(predicted[both] - true[both]) / true[both]
    return float((areas[both] * relative).sum() / areas[both].sum())


def _readings(camera: Camera) -> Iterator[tuple[str, Reading]]:
    """Yield other readings of a picture, each with its word."""
    rays = camera.unproject()
    axis = rays.directions[..., 2]
    if (axis[rays.valid] > 0).all():
        yield "planar", partial(_along_ray, axis=axis)
        yield "range", partial(_along_axis, axis=axis)
    yield "disparity", _inverse
    for unit in UNITS:
        yield f"unit {unit:g}", partial(_in_unit, unit=unit)
    yield "mirrored", np.fliplr
    yield "flipped", np.flipud
    yield "rolled", partial(np.rot90, k=2)
    if camera.wraps:
        for columns in range(1, min(_SHIFTS, camera.width // 2) + 1):
            for shift in (columns, -columns):
                yield f"shifted by {shift} columns", partial(np.roll, shift=-shift, axis=1)


def _along_ray(values: Array, axis: Array) -> Array:
    """Return what planar depth is along the ray; ``axis``: cosines of rays and the optical axis."""
    return values / axis


def _along_axis(values: Array, axis: Array) -> Array:
    """Return what depth along the ray is along the optical axis."""
    return values * axis


def _in_unit(values: Array, unit: float) -> Array:
    """Return metres of values of which ``unit`` are a metre."""
    return values / unit


def _inverse(values: Array) -> Array:
    """Return 1 / values, NaN where there is none."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(values > 0, 1 / values, np.nan))
