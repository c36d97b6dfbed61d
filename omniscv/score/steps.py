"""Where a prediction's edges are, relative to the truth's: shifts by columns or half a pixel, turns, lenses.

Compared are steps from pixel to pixel of log p and of log t. A network's error is smooth, so its steps are
small, and edges make the sum of squared differences of steps. For a shift s of the truth,

    sum (dp - dt_s)^2 = sum dp^2 + sum dt_s^2 - 2 sum dp dt_s,

and the last sums of all shifts are one correlation. A shift between pixels reads the truth linearly, which
blurs it: so the shift is compared with the opposite one, which blurs it as much. A blurred prediction is as
near to both.
"""

from dataclasses import dataclass

import numpy as np

from omniscv.cameras import Camera
from omniscv.geometry import Array
from omniscv.geometry.arrays import Ints, Mask
from omniscv.score.areas import seen_pixels
from omniscv.score.other_lenses import other_lenses

MOST_COLUMNS = 32
"""Columns that a panorama is shifted by, on each side."""
_LEAST_PX = 8  # a side of pictures whose edges are compared
_LEAST_ROWS = 32  # of the band in the picture's middle that is compared
_BAND = 1 << 15  # pixels of the band, at least
_SMALLER = 0.75  # squared steps of a shift, relative to those of the opposite one, and of none
_MUCH_SMALLER = 0.6  # of a turned picture and of another lens, relative to none
_HALF = (-0.5, 0.0, 0.5)


@dataclass(frozen=True)
class Edges:
    """What edges say of a prediction.

    Attributes:
        word: the mistake's; see :class:`omniscv.score.Mistake`.
        detail: more of it.
        shift: (u, v) px that the truth is read further, to meet the prediction.
        is_mirrored, is_flipped: how the prediction is turned.
        lens: that the prediction was made by; None: the camera.
    """

    word: str
    detail: str = ""
    shift: tuple[float, float] = (0.0, 0.0)
    is_mirrored: bool = False
    is_flipped: bool = False
    lens: Camera | None = None


def compare(said: Array, true: Array, camera: Camera) -> Edges | None:
    """Return what makes edges of a prediction meet those of the truth; None where they meet as they are.

    Args:
        said: (H, W) predicted metres along rays.
        true: (H, W) metres along rays.
        camera: of both.
    """
    if min(said.shape) < _LEAST_PX:
        return None
    band = _band(said.shape)
    valid = seen_pixels(camera)
    in_said = _Steps(_logs(said[band], valid[band]))
    rows = slice(None) if other_lenses(camera) else band  # other lenses see rows beyond the band
    log_true = _logs(true[rows], valid[rows])
    part = log_true[band] if other_lenses(camera) else log_true
    in_true = _Steps(part)
    shifted = _best_shift(in_said, in_true, camera.wraps)
    unmoved = in_said.distance(in_true)
    best: Edges | None = None
    least = _MUCH_SMALLER * unmoved
    for edges, logs in _turns(part, log_true, camera, band):
        distance = in_said.distance(_Steps(logs))
        if distance < least:
            least = distance
            best = edges
    if best is None or (shifted is not None and shifted[1] < least):
        return None if shifted is None else shifted[0]
    return best


def _band(shape: tuple[int, ...]) -> slice:
    """Return the rows in a picture's middle that are compared; as many are above as below."""
    rows = max(_LEAST_ROWS, _BAND // shape[1])
    above = max(0, (shape[0] - rows) // 2)
    return slice(above, shape[0] - above)


def _logs(values: Array, valid: Mask) -> Array:
    """Return logarithms, NaN where there is no value."""
    is_known = valid & np.isfinite(values) & (values > 0)
    return np.log(np.where(is_known, values, np.nan))


class _Steps:
    """The steps of a picture (H, W) along its rows and down its columns, 0 where they are not known.

    Attributes:
        along: (H, W - 1).
        down: (H - 1, W).
    """

    def __init__(self, logs: Array) -> None:
        self.along = np.diff(logs, axis=1)
        self.down = np.diff(logs, axis=0)
        self.knows_along = np.isfinite(self.along)
        self.knows_down = np.isfinite(self.down)
        self.along[~self.knows_along] = 0
        self.down[~self.knows_down] = 0

    def distance(self, other: "_Steps") -> float:
        """Return the mean squared difference of steps that both know; infinite where they know none."""
        along = (self.along - other.along)[self.knows_along & other.knows_along]
        down = (self.down - other.down)[self.knows_down & other.knows_down]
        count = len(along) + len(down)
        return float((along @ along + down @ down) / count) if count else np.inf


def _best_shift(said: _Steps, true: _Steps, wraps: bool) -> tuple[Edges, float] | None:
    """Return the shift whose steps are nearest, and their mean squared difference; None for no shift."""
    columns = min(MOST_COLUMNS, said.down.shape[1] // 4) if wraps else 0
    reach = columns + 1
    products = _products(said.along, true.along, reach) + _products(said.down, true.down, reach)
    of_said = float((said.along**2).sum() + (said.down**2).sum())
    shifts = [(u, v) for u in _HALF for v in _HALF]
    shifts += [(float(sign * count), 0.0) for count in range(1, columns + 1) for sign in (1, -1)]
    sums = {}
    for u, v in shifts:
        of_true = _sum_of_squares(true.along, u % 1, v % 1) + _sum_of_squares(true.down, u % 1, v % 1)
        sums[u, v] = of_said + of_true - 2 * _between(products, u, v, reach)
    shift = min(sums, key=lambda candidate: sums[candidate])
    u, v = shift
    if shift == (0, 0) or not sums[shift] < _SMALLER * min(sums[0, 0], sums[-u, -v]):
        return None
    count = np.count_nonzero(said.knows_along) + np.count_nonzero(said.knows_down)
    edges = Edges("pixel", f"{u:g}, {v:g} px", shift)
    if v == 0 and u == int(u):
        edges = Edges(f"shifted by {-int(u)} columns", "", shift)
    return edges, sums[shift] / count


def _products(said: Array, true: Array, reach: int) -> Array:
    """Return (3, 2 reach + 1) the sums of ``said`` times ``true`` read -1 to 1 px further down, and
    ``-reach`` to ``reach`` px further to the right."""
    spectrum = np.conj(np.fft.rfft(said, axis=1))
    sums = []
    for v in (-1, 0, 1):
        read = np.zeros_like(true)
        rows = slice(max(0, -v), true.shape[0] - max(0, v))
        read[rows] = true[max(0, v) : true.shape[0] - max(0, -v)]
        product = np.fft.irfft((spectrum * np.fft.rfft(read, axis=1)).sum(axis=0), true.shape[1])
        sums.append(product[np.arange(-reach, reach + 1)])
    return np.array(sums)


def _between(products: Array, u: float, v: float, reach: int) -> float:
    """Return the sum of products for a shift, linearly between those of whole pixels."""
    total = 0.0
    left = int(np.floor(u))
    top = int(np.floor(v))
    for du, dv in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = abs(1 - du - u % 1) * abs(1 - dv - v % 1)
        if weight:
            total += weight * float(products[top + dv + 1, left + du + reach])
    return total


def _sum_of_squares(steps: Array, u: float, v: float) -> float:
    """Return the sum of squared steps of a picture that is read ``u`` and ``v``, 0 or 0.5 px, further."""
    if u:
        steps = (steps + np.roll(steps, -1, axis=1)) / 2
    if v:
        steps = (steps[1:] + steps[:-1]) / 2
    return float((steps * steps).sum())


def _turns(part: Array, logs: Array, camera: Camera, band: slice) -> list[tuple[Edges, Array]]:
    """Return the truth turned, and seen by other lenses, in the band.

    Args:
        part: logarithms in the band.
        logs: (H, W) of the whole picture, which other lenses need.
        camera: of the truth.
        band: the rows.
    """
    turns = [
        (Edges("mirrored", is_mirrored=True), part[:, ::-1]),
        (Edges("flipped", is_flipped=True), part[::-1]),
        (Edges("rolled", is_mirrored=True, is_flipped=True), part[::-1, ::-1]),
    ]
    for lens in other_lenses(camera):
        turns.append((Edges("lens", lens.name, lens=lens.camera), _seen(logs, camera, lens.camera, band)))
    return turns


def _seen(values: Array, camera: Camera, lens: Camera, band: slice) -> Array:
    """Return a band of a picture by another lens, nearest pixels, NaN where it shows nothing."""
    directions = lens.unproject(lens.pixels()[band]).directions
    pixels, is_seen = camera.project(np.nan_to_num(directions))
    u, v = np.moveaxis(np.where(is_seen[..., None], pixels, 0).astype(np.int64), -1, 0)
    read = values[np.minimum(v, camera.height - 1), np.minimum(u, camera.width - 1)]
    return np.where(is_seen, read, np.nan)


def moved(values: Array, rows: Ints, columns: Ints, shift: tuple[float, float], wraps: bool) -> Array:
    """Return a picture read ``shift`` px further, linearly, at pixels (N,); NaN beyond its border.

    Args:
        values: (H, W).
        rows: (N,) of the pixels.
        columns: (N,) of the pixels.
        shift: (u, v) px.
        wraps: whether the picture's left border goes on at its right one.
    """
    height, width = values.shape
    u = shift[0]
    v = shift[1]
    total = np.zeros(len(rows))
    for du, dv in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = abs(1 - du - u % 1) * abs(1 - dv - v % 1)
        if weight == 0:
            continue
        column = columns + int(np.floor(u)) + du
        row = rows + int(np.floor(v)) + dv
        is_inside = (row >= 0) & (row < height)
        if wraps:
            column = column % width
        else:
            is_inside &= (column >= 0) & (column < width)
        read = values[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        total += weight * np.where(is_inside, read, np.nan)
    return total
