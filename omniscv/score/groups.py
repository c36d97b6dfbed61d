"""Where errors of depth are: by angle, by distance, at the poles, and across a panorama's seam.

Errors are weighted by solid angle. Far surfaces lie in other directions than near ones do, so the error by
distance also tells directions, and that by angle distances. Both are in one table. An error by distance *at
equal angle* is the mean over the angles of that distance's errors, each with the solid angle that it has in
all distances. Cells that are empty are left out.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from omniscv.cameras import Camera
from omniscv.geometry import Array
from omniscv.geometry.arrays import Ints, Mask
from omniscv.score.areas import solid_angles

STEP_DEG = 15
"""Width of rings and bands, degrees."""
_BANDS = 180 // STEP_DEG
_FIRST_POWER = -3  # of two, metres: the first distances are below 1/8 m
_DISTANCES = 12  # up to 128 m, and beyond
_DELTA1 = 1.25
_BLOCK = 1 << 14  # pixels that are sorted at once: they fit a processor's cache
_KEPT = 4  # cameras whose rings are kept


class Groups(NamedTuple):
    """Sums over pixels by ring or band, and by distance, of one image or of several.

    Attributes:
        rings: (12, 12, 3) by 15 degrees of the angle from the optical axis, and by distance: solid angle, and
            this times ``|p - t| / t`` and times whether ``max(p / t, t / p) < 1.25``.
        bands: (12, 12, 3) by 15 degrees of latitude, the lower pole first.
        seam: (3,) weight, and this times the error of the step across the seam, and of steps elsewhere: of
            log p less that of log t, without its sign. 0 where the picture does not wrap.
    """

    rings: Array
    bands: Array
    seam: Array

    def __add__(self, other: object) -> "Groups":
        """Return the sums over both."""
        if not isinstance(other, Groups):
            return NotImplemented
        return Groups(self.rings + other.rings, self.bands + other.bands, self.seam + other.seam)


def group(p: Array, t: Array, where: Mask, camera: Camera) -> Groups:
    """Return where the errors of an image are.

    Args:
        p: (H, W) predicted metres along rays, aligned.
        t: (H, W) metres along rays.
        where: (H, W) bool, pixels that are compared.
        camera: with one optical centre.
    """
    cells = _angles(camera)
    areas = solid_angles(camera)
    size = _BANDS * _BANDS * _DISTANCES
    sums = np.zeros((3, size))
    rows = max(1, _BLOCK // camera.width)
    for first in range(0, camera.height, rows):
        block = slice(first, first + rows)
        chosen = where[block]
        predicted = p[block][chosen]
        true = t[block][chosen]
        area = areas[block][chosen]
        exponent = np.frexp(true.astype(np.float32))[1]
        cell = cells[block][chosen] + np.clip(exponent - _FIRST_POWER, 0, _DISTANCES - 1)
        relative = area * (np.abs(predicted - true) / true)
        inlier = area * (np.maximum(predicted / true, true / predicted) < _DELTA1)
        for number, weights in enumerate((area, relative, inlier)):
            sums[number] += np.bincount(cell, weights, size)
    table = sums.T.reshape(_BANDS, _BANDS, _DISTANCES, 3)
    return Groups(table.sum(axis=1), table.sum(axis=0), _seam(p, t, where, camera))


@lru_cache(_KEPT)
def _angles(camera: Camera) -> Ints:
    """Return (H, W) the first cell of each pixel in a table of rings, bands and distances, read-only."""
    directions = np.nan_to_num(camera.unproject().directions)
    from_axis = np.degrees(np.arccos(np.clip(directions[..., 2], -1, 1)))
    latitude = np.degrees(np.arcsin(np.clip(-directions[..., 1], -1, 1)))
    rings = np.minimum(from_axis // STEP_DEG, _BANDS - 1)
    bands = np.minimum((latitude + 90) // STEP_DEG, _BANDS - 1)
    cells: Ints = ((rings * _BANDS + bands) * _DISTANCES).astype(np.int32)
    cells.flags.writeable = False
    return cells


def _seam(p: Array, t: Array, where: Mask, camera: Camera) -> Array:
    """Return the sums of :attr:`Groups.seam`: steps elsewhere are those at three other meridians."""
    sums = np.zeros(3)
    if not camera.wraps:
        return sums
    width = camera.width
    areas = solid_angles(camera)
    columns = [width - 1, width // 4, width // 2, 3 * width // 4]
    errors = []
    known = np.ones(camera.height, np.bool_)
    for column in columns:
        beside = (column + 1) % width
        both = where[:, column] & where[:, beside]
        with np.errstate(divide="ignore", invalid="ignore"):
            predicted = np.log(p[:, beside] / p[:, column])
            errors.append(np.abs(predicted - np.log(t[:, beside] / t[:, column])))
        known &= both
    weights = areas[known, 0]
    elsewhere = np.mean([error[known] for error in errors[1:]], axis=0)
    return np.array([weights.sum(), weights @ errors[0][known], weights @ elsewhere])


@dataclass(frozen=True)
class Row:
    """The error in one group of pixels.

    Attributes:
        name: such as ``30 to 45 degrees`` or ``2 to 4 m``.
        share: of the solid angle that is compared.
        abs_rel: mean of ``|p - t| / t``.
        delta1: share with ``max(p / t, t / p) < 1.25``.
        abs_rel_at_equal: the same at equal distances, of an angle, or at equal angles, of a distance.
    """

    name: str
    share: float
    abs_rel: float
    delta1: float
    abs_rel_at_equal: float


def by_ring(groups: Groups) -> list[Row]:
    """Return a row for each ring of the angle from the optical axis that has pixels."""
    names = [f"{step * STEP_DEG} to {(step + 1) * STEP_DEG} degrees off the axis" for step in range(_BANDS)]
    return _rows(groups.rings, names)


def by_band(groups: Groups) -> list[Row]:
    """Return a row for each band of latitude that has pixels; the first and the last ones are the poles."""
    names = []
    for step in range(_BANDS):
        south = step * STEP_DEG - 90
        names.append(f"latitude {south} to {south + STEP_DEG}")
    return _rows(groups.bands, names)


def by_distance(groups: Groups, by_latitude: bool = False) -> list[Row]:
    """Return a row for each distance that has pixels, at equal angles from the axis, or equal latitudes."""
    names = [f"below {2.0**_FIRST_POWER:g} m"]
    for power in range(_FIRST_POWER, _FIRST_POWER + _DISTANCES - 2):
        names.append(f"{2.0**power:g} to {2.0 ** (power + 1):g} m")
    names.append(f"beyond {2.0 ** (_FIRST_POWER + _DISTANCES - 2):g} m")
    table = groups.bands if by_latitude else groups.rings
    return _rows(table.transpose(1, 0, 2), names)


def _rows(table: Array, names: list[str]) -> list[Row]:
    """Return a row for each first index of a table that has pixels."""
    areas = table[..., 0]
    of_other = areas.sum(axis=0)
    rows = []
    for name, cells in zip(names, table, strict=True):
        total, relative, inlier = cells.sum(axis=0)
        if total <= 0:
            continue
        has_pixels = cells[:, 0] > 0
        errors = cells[has_pixels, 1] / cells[has_pixels, 0]
        weights = of_other[has_pixels]
        at_equal = float(weights @ errors / weights.sum())
        rows.append(Row(name, float(total / areas.sum()), relative / total, inlier / total, at_equal))
    return rows


def seam(groups: Groups) -> dict[str, float]:
    """Return the mean errors of steps of log depth: ``across the seam`` and ``elsewhere``; empty where the
    pictures do not wrap."""
    weight, across, elsewhere = groups.seam
    if weight <= 0:
        return {}
    return {"across the seam": float(across / weight), "elsewhere": float(elsewhere / weight)}
