"""Relief that is finer than a picture's pixels show: there a surface between the pixels may be anywhere that
its neighbourhood reaches.

Second differences of inverse depth are 0 on a plane. Patterns of them, beyond what rounding makes, are
signs of relief, each seen in whole pictures before anything is sampled:

- their sign changes again and again along a row or a column: bars, teeth, leaves;
- many pixels stand out alone from their row or column: slits and wires that only some pixels meet;
- equal steps follow each other: stairs that are sampled at nearly the same phase;
- values of few digits rise and fall by a rounding step or more.

Labels are relief where they change again and again.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry.arrays import Floats, Mask
from omniscv.geometry.precision import COMPUTED, FLOAT32, LEAST_M, Precision, stored_length
from omniscv.parallel import side_by_side
from omniscv.sources import codecs
from omniscv.sources.base import Capture

WINDOW_PX = 16
TURNS = 8
"""Along a row or a column, changes of the sign of second differences, or of labels, from which on they are
relief."""
_LONE_BOX_PX = (32, 16)
_LONE_SHARE = 0.08
"""Length and breadth of a box, and the share of its pixels that stand out alone: three thin lines in it."""
_STEPS = 24
_ALIKE = 0.6
_AGAINST = 0.3
"""px within which three steps are a pattern, if the least is so large a part of the largest; and by what part
the second differences at both ends of a step may differ."""
_UNEVEN_PX = 2
_UNEVEN = 1 / 8
"""By how much the distances of three steps differ, and by what part of their sum, if they are of a beat."""
_NOISE = 3.0
_GRAZING = 0.4
_DOUBT = 1 / 3
"""Rounding errors that one of the two second differences of a turn exceeds, 1.5 steps: those of a rounded
plane are at most one. And so large a part more on planes at grazing angles, where they are at most two. The
other one exceeds a third of that."""
_GROWN_PX = 3
_BEAT_PX = 48
"""How far relief goes on beyond what was counted; and where every pixel turns, as of bars every two pixels:
there a beat hides them in turn."""
_EVERY = 200  # changes of labels in a box of 16 x 16 px, from which on every pixel turns
_LABELS_PX = 24
_LONE_LABELS = 48
"""A box's side, and so many labels in it that stand alone from their row or column: two thin lines."""
_FEW_DIGITS = 11
_SWINGS = 3
_SWING_PX = 48
_SWING_STEPS = 8.0
"""Depth of so few significant digits, as in half floats, is relief if it turns back so often within so many
px, by less than so many rounding steps: a rounded surface goes one way, or turns back once. More steps are an
edge."""
_NEAR_PX = 8  # on every side, the neighbourhood that bounds depth

_BESIDE = np.ones((3, 3), np.uint8)

Marks = NDArray[np.uint8]


def depth_relief(captures: Sequence[Capture]) -> Floats:
    """Return (V, h, w) float32 metres that depth along the ray may be off by relief in V pictures of depth; 0
    where there is none, and an empty array where no picture has any."""
    off = side_by_side(planar_relief, list(captures))
    if all(each is None for each in off):
        return np.empty(0, np.float32)
    none = np.zeros(captures[0].pixels.shape, np.float32)
    lengths = captures[0].view.ray_lengths()
    return np.stack([none if each is None else np.float32(each * lengths) for each in off])


def label_relief(across: Mask, down: Mask, shape: tuple[int, int]) -> Mask | None:
    """Return (h, w) where labels change too often to be followed from pixel to pixel; None for nowhere.

    Args:
        across, down: (h, w - 1) and (h - 1, w), whether neighbouring pixels differ.
        shape: h and w.
    """
    fired, beats = np.zeros((2, *shape), np.uint8)
    for changes, to, length in (
        (across, (slice(None), slice(-1)), (WINDOW_PX, 1)),
        (down, (slice(-1), slice(None)), (1, WINDOW_PX)),
    ):
        windows = _windows(changes.view(np.uint8), length, TURNS)
        fired[to] |= windows
        if windows.any():
            beats[to] |= _windows(changes.view(np.uint8), (WINDOW_PX, WINDOW_PX), _EVERY)
    if not fired.any():
        return None
    return _grown(fired, _GROWN_PX) | (_grown(beats, _BEAT_PX) if beats.any() else np.False_)


def lone_labels(across: Mask, down: Mask, shape: tuple[int, int]) -> Mask:
    """Return (h, w) where many labels differ from those on both sides, near a change of labels.

    That alone is no sign of relief; where depth is, the label may be another one, too. Arguments are those of
    :func:`label_relief`.
    """
    lone, changes = np.zeros((2, *shape), np.uint8)
    lone[:, 1:-1] |= across[:, 1:] & across[:, :-1]
    lone[1:-1] |= down[1:] & down[:-1]
    changes[:, 1:] |= across
    changes[1:] |= down
    dense = _windows(lone, (_LABELS_PX, _LABELS_PX), _LONE_LABELS)
    return (dense > 0) & _grown(changes, _NEAR_PX)


def planar_errors(captures: Sequence[Capture]) -> list[Floats]:
    """Return (h, w) float32 metres that planar depth may be off at each pixel and between it and the next, as
    captures say; an empty list where none says it."""
    errors = [codecs.error_of(capture) for capture in captures]
    if all(error is None for error in errors):
        return []
    planar = []
    for capture, error in zip(captures, errors, strict=True):
        off = np.zeros(capture.pixels.shape) if error is None else error / capture.view.ray_lengths()
        between = off if capture.encoding == codecs.RESAMPLED else cv2.dilate(off, _BESIDE)
        planar.append(np.asarray(between, np.float32))
    return planar


def planar_relief(capture: Capture) -> Floats | None:
    """Return (h, w) float32 metres that planar depth may be off by relief; None where there is none."""
    if capture.encoding == codecs.RESAMPLED:
        return None
    depth = capture.pixels
    focal = capture.view.focal_px
    fired = np.zeros(depth.shape, np.uint8)
    alone = np.zeros((2, *depth.shape), np.uint8)
    beats = np.zeros(depth.shape, np.uint8)
    precision = codecs.precision(capture)
    off = next(iter(planar_errors([capture])), np.zeros((0, 0), np.float32))
    counts = _patterns(depth, focal, precision, off, fired, alone, beats)
    if precision.digits <= _FEW_DIGITS:
        _swings(depth, focal, precision, fired)
        swinging = np.zeros(depth.shape[::-1], np.uint8)
        _swings(np.ascontiguousarray(depth.T), focal, precision, swinging)
        fired |= swinging.T
    least = int(_LONE_SHARE * _LONE_BOX_PX[0] * _LONE_BOX_PX[1])
    for of_axis, count, box in zip(alone, counts, (_LONE_BOX_PX, _LONE_BOX_PX[::-1]), strict=True):
        if count >= least:
            fired |= _windows(of_axis, box, least)
    if not fired.any():
        return None
    off = _off(depth, fired, _GROWN_PX, _NEAR_PX)
    beats = _windows(beats, (WINDOW_PX, WINDOW_PX), WINDOW_PX)
    return np.maximum(off, _off(depth, beats, _BEAT_PX, _BEAT_PX)) if beats.any() else off


def _off(depth: Floats, marks: Marks, grown_px: int, near_px: int) -> Floats:
    """Return (h, w) metres that depth may be off within ``grown_px`` of marks, by what is within
    ``near_px``."""
    near = np.ones((2 * near_px + 1, 2 * near_px + 1), np.uint8)
    most = cv2.dilate(_bent(depth), near)
    farthest = cv2.dilate(depth, near)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        off = most * depth * depth
        reach = np.where(most * depth < 1, off / (1 - most * depth), np.inf)
        off = np.maximum(off, np.minimum(reach, farthest - depth))
    return np.where(_grown(marks, grown_px) & np.isfinite(depth), off, 0).astype(np.float32)


def _bent(depth: Floats) -> Floats:
    """Return (h, w) the larger of the second differences of 1/z across and down."""
    inverse = np.pad(1 / np.maximum(depth.astype(np.float64), LEAST_M), 1, "edge")
    across = inverse[1:-1, :-2] + inverse[1:-1, 2:] - 2 * inverse[1:-1, 1:-1]
    down = inverse[:-2, 1:-1] + inverse[2:, 1:-1] - 2 * inverse[1:-1, 1:-1]
    return np.maximum(np.abs(across), np.abs(down)).astype(np.float32)


def _windows(marks: Marks, length: tuple[int, int], least: int) -> Marks:
    """Return the pixels of all windows that hold so many marks or more."""
    if not marks.any():  # or none at all, between the pixels of one row
        return marks
    counts = cv2.boxFilter(marks, cv2.CV_16U, length, normalize=False, borderType=cv2.BORDER_CONSTANT)
    full = (counts >= least).view(np.uint8)
    if not full.any():
        return np.asarray(full)
    last = length[0] - 1 - length[0] // 2, length[1] - 1 - length[1] // 2  # the window is not symmetric
    return np.asarray(cv2.dilate(full, np.ones(length[::-1], np.uint8), anchor=last), np.uint8)


def _grown(marks: Marks, px: int) -> Mask:
    return np.asarray(cv2.dilate(marks, np.ones((2 * px + 1, 2 * px + 1), np.uint8)) > 0)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _exceeded(bend: Any, change: Any, z: Any, noise: Any) -> Any:
    """Return a second difference of 1/z as a multiple of noise; 0 if it is too small to count.

    Of a plane, z itself bends by ``2 z'^2 / z``. The less so, the more do the rounding errors of neighbours
    depend on each other. All arguments are float32.
    """
    noise += min(np.float32(0.5) * z * change * change, np.float32(_GRAZING) * noise)
    return bend / noise if abs(bend) > np.float32(_DOUBT) * noise else np.float32(0)


@njit(
    "float32[:, ::1], float64, Precision, float32[:, ::1], out uint8[:, ::1], out uint8[:, :, ::1], "
    "out uint8[:, ::1] -> (int64, int64)",
    nogil=True,
    error_model="numpy",
)
def _patterns(  # noqa: C901, PLR0912, PLR0915 - a kernel
    depth: Floats, focal: float, precision: Precision, off: Floats, fired: Marks, alone: Marks, beats: Marks
) -> tuple[int, int]:
    """Mark patterns of second differences of 1/z of planar depth (h, w), which may be ``off`` beside its
    precision; return how many pixels stand out alone, across and down.

    Args:
        fired: (h, w), pixels from the first to the last of many turns, or of three equal steps.
        alone: (2, h, w), pixels that stand out from their row, or their column.
        beats: (h, w), pixels at the end of many turns, one at each pixel, or of three uneven steps.
    """
    height, width = depth.shape
    rows = np.zeros((3, width), np.float32)  # 1/z above, here and below
    x, y = np.zeros(width, np.float32), np.zeros((4, width), np.float32)
    per_unit, off_m = np.float32(1.0 / precision.unit_m), np.full(width, _NOISE * precision.off_m, np.float32)
    share = np.float32(_NOISE * (COMPUTED * FLOAT32 + precision.share))
    step_m = np.float32(_NOISE * precision.unit_m / np.float64(np.int64(1) << precision.digits))
    turns = np.zeros((2, width), np.uint8)
    # Of the row in the last place, and of each column: where the sign turned last, and the last two steps.
    at, number = np.zeros((width + 1, TURNS), np.int64), np.zeros(width + 1, np.int64)
    step_at, step = np.zeros((width + 1, 2), np.int64), np.zeros((width + 1, 2))
    counts = np.zeros(2, np.int64)
    for r in range(-1, height - 1):
        step[width] = 0.0
        above, here, below = rows[r % 3], rows[(r + 1) % 3], rows[(r + 2) % 3]
        for c in range(width):
            below[c] = np.float32(1) / max(depth[r + 1, c], np.float32(LEAST_M))
        if r < 1:
            continue
        if off.size:
            for c in range(width):
                off_m[c] = np.float32(_NOISE) * (np.float32(precision.off_m) + off[r, c])
        down, last, second, third = y[r % 4], y[(r - 1) % 4], y[(r - 2) % 4], y[(r - 3) % 4]
        for c in range(1, width - 1):  # vectorized
            bend_across = here[c - 1] + here[c + 1] - np.float32(2) * here[c]
            bend_down = above[c] + below[c] - np.float32(2) * here[c]
            # As precision.rounding, in float32, whose own errors of 1/z are well below it.
            z, length = depth[r, c], np.float32(stored_length(r, c, (height, width), focal, precision))
            stored = np.float32(z * length * per_unit)
            power = np.int32(stored.view(np.int32) & 0x7F800000)
            noise = (power.view(np.float32) * step_m / length + share * z + off_m[c]) * here[c] * here[c]
            noise = noise if z < np.inf else np.float32(1e-30)
            x[c] = _exceeded(bend_across, here[c - 1] - here[c + 1], z, noise)
            down[c] = _exceeded(bend_down, above[c] - below[c], z, noise)
        turned = 0
        for c in range(1, width - 1):
            clear_across = max(abs(x[c]), abs(x[c - 1])) > np.float32(1)
            clear_down = max(abs(last[c]), abs(second[c])) > np.float32(1)
            turns[0, c] = (x[c] * x[c - 1] < np.float32(0)) & clear_across
            turns[1, c] = (last[c] * second[c] < np.float32(0)) & clear_down
            turned += turns[0, c] + turns[1, c]
        number[width] = 0
        for c in range(1, width - 1 if turned else 1):
            for axis in range(2):
                if turns[axis, c] == 0:
                    continue
                if axis == 0:
                    k, here_at = width, c
                    earlier, previous, value, later = x[c - 2], x[c - 1], x[c], x[c + 1]
                else:
                    k, here_at = c, r - 1
                    earlier, previous, value, later = third[c], second[c], last[c], down[c]
                previous += earlier if earlier * previous > 0.0 else 0.0  # a step may end between two pixels
                value += later if later * value > 0.0 else 0.0
                count = number[k]
                first = here_at
                if count >= TURNS - 1 and here_at - at[k, (count + 1) % TURNS] < WINDOW_PX:
                    first = at[k, (count + 1) % TURNS]
                    if here_at - first < TURNS:
                        beats[r, c] = 1
                clear = min(abs(value), abs(previous)) > 1.0
                if count and at[k, (count - 1) % TURNS] == here_at - 1:
                    alone[axis, r, c] = 1
                    counts[axis] += 1
                at[k, count % TURNS], number[k] = here_at, count + 1
                if clear and abs(value + previous) <= _AGAINST * max(abs(value), abs(previous)):
                    a, b = step[k]
                    least, most = min(abs(value), min(abs(a), abs(b))), max(abs(value), max(abs(a), abs(b)))
                    alike = least >= _ALIKE * most and a * value > 0.0 and b * value > 0.0
                    if alike and here_at - step_at[k, 0] <= _STEPS:
                        first = min(first, step_at[k, 0])
                        before, after = step_at[k, 1] - step_at[k, 0], here_at - step_at[k, 1]
                        if abs(after - before) >= max(_UNEVEN_PX, _UNEVEN * (before + after)):
                            beats[r, c] = 1
                    step_at[k, 0], step[k, 0] = step_at[k, 1], step[k, 1]
                    step_at[k, 1], step[k, 1] = here_at, value
                if axis == 0:
                    fired[r, first:c] = 1
                else:
                    fired[first:here_at, c] = 1
    return counts[0], counts[1]


@njit("float32[:, ::1], float64, Precision, out uint8[:, ::1]", nogil=True, error_model="numpy")
def _swings(depth: Floats, focal: float, precision: Precision, marks: Marks) -> None:
    """Mark (h, w) where depth rises and falls along the rows, by few rounding steps."""
    height, width = depth.shape
    at = np.zeros(_SWINGS, np.int64)
    stored, steps = np.zeros((2, width), np.float32)
    per_unit, per_step = np.float32(1.0 / precision.unit_m), np.float32(1 << (precision.digits - 1))
    for r in range(height):
        for c in range(width):  # vectorized
            length = np.float32(stored_length(r, c, (height, width), focal, precision))
            stored[c] = depth[r, c] * length * per_unit
        moved = 0
        for c in range(1, width):  # vectorized
            value = np.float32(stored[c])
            power = np.int32(value.view(np.int32) & 0x7F800000)
            steps[c] = (value - stored[c - 1]) * per_step / power.view(np.float32)
            moved += not abs(steps[c]) <= np.float32(0.5)
        count, way = 0, np.float32(0)
        for c in range(1, width if moved > _SWINGS else 1):
            if abs(steps[c]) <= np.float32(0.5):
                continue
            if not abs(steps[c]) < np.float32(_SWING_STEPS):
                count, way = 0, np.float32(0)
                continue
            if steps[c] * way < 0.0:
                at[count % _SWINGS] = c
                count += 1
                first = at[count % _SWINGS]
                if count >= _SWINGS and c - first < _SWING_PX:
                    marks[r, first - 1 : c + 1] = 1
            way = steps[c]
