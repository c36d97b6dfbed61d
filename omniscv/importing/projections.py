"""Is a picture what its shape suggests? Panoramas and faces of cubes are asked for what others are not.

A panorama meets itself at +-180 degrees, and its first and last rows show one point each. Two fisheyes beside
each other have black corners; two eyes repeat each other. Faces of a cube meet along twelve edges, and lines
run straight over them. Nothing is said where pictures do not tell: dark, plain, or turned over a tripod.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.importing.layouts import Arrangement, edges, grey_levels
from omniscv.importing.overlap import local_contrast
from omniscv.pictures.forms import Pixels

Grey = NDArray[np.float32]

_WIDTH = 512  # px of the panorama that is looked at
_BROKEN = 3.0  # times the steps between columns, beyond which a seam is none
_BROKEN_EYES = 1.5  # the same between halves that repeat
_LEAST_LEVELS = 4.0  # grey levels beyond which steps count
_POLE = 0.5  # of the spread along other rows, which is more than rows at a pole have
_BLACK = 14.0  # grey levels
_LIT = 30.0
_IN_CIRCLE = 0.94  # of the radius of a fisheye's picture
_BEYOND_CIRCLE = 1.05
_REPEATED = 0.75  # correlation of the pictures of two eyes; of sound panoramas it is 0.5 at most
_EYE = 128  # px of a half that is looked at
_DISPARITY = 8  # px of them
_FACE = 256  # px of faces that are looked at
_LINES = 4  # pixels from the edge of a face by which its slope there is known
_BLUR = 3.0  # px along an edge
_EAC = 1.3  # bend of lines over edges, which is 0 for plain cubes and 1 or more for equi-angular ones
_LEAST_FACE = 192  # px, below which textures are too fine for that
_EXPLAINED = 0.08  # of how colours change over edges, which bends explain at least
_WIDER = np.linspace(1, 1.2, 81)  # extents of faces over those of 90 degrees
_LEAST_WIDER = 1.004
_CLEAR = 0.6  # of the step at 90 degrees, below which another field of view is one
_AS_SAID = "--trust-words takes it as said"


def check_panorama(pixels: Pixels) -> None:
    """Raise ArgumentError for colours (H, W, 3), W = 2 H, that are certainly no panorama.

    Two fisheyes, two eyes and plain pictures are named.
    """
    grey = np.asarray(grey_levels(pixels).mean(axis=-1), np.float32)
    grey = cv2.resize(grey, (_WIDTH, _WIDTH // 2), interpolation=cv2.INTER_AREA)
    if _is_two_fisheyes(grey):
        remedy = "ffmpeg -vf v360=dfisheye:equirect:ih_fov=190:iv_fov=190 makes a panorama of them"
        raise _no_panorama("two fisheyes in black corners", remedy)
    left, right = np.split(grey, 2, axis=1)
    if _is_repeated(left, right) and _is_broken(grey, _WIDTH // 2, _BROKEN_EYES):
        raise _no_panorama("halves side by side that repeat, as of two eyes", "cut out the left half")
    upper, lower = np.split(grey, 2, axis=0)
    if _is_repeated(upper, lower):
        raise _no_panorama("halves one above the other that repeat, as of two eyes", "cut out the upper half")
    is_open = _is_broken(np.roll(grey, _WIDTH // 2, axis=1), _WIDTH // 2)
    if is_open and _is_no_pole(grey, 0) and _is_no_pole(grey, -1):
        seam = float(np.abs(grey[:, 0] - grey[:, -1]).mean())
        poles = f"many points in the rows at the poles, and a step of {seam:.0f} levels at +-180 degrees"
        raise _no_panorama(poles, "--intrinsics FILE takes pictures of another lens")


def _no_panorama(shown: str, remedy: str) -> ArgumentError:
    """Return the error of a picture that shows another thing."""
    return ArgumentError(f"expected an equirectangular panorama, got {shown}; {remedy}; {_AS_SAID}")


def _is_broken(grey: Grey, column: int, times: float = _BROKEN) -> bool:
    """Return whether a picture has a step before a column, so many ``times`` those between other columns."""
    steps = np.abs(np.diff(grey, axis=1)).mean(axis=0)
    others = float(np.quantile(np.delete(steps, column - 1), 0.95))
    return bool(steps[column - 1] > times * others + _LEAST_LEVELS)


def _is_no_pole(grey: Grey, row: int) -> bool:
    """Return whether a row, which would be at a pole, varies as other rows do."""
    spreads = grey.std(axis=1)
    return bool(spreads[row] > _POLE * np.median(spreads) + _LEAST_LEVELS)


def _is_two_fisheyes(grey: Grey) -> bool:
    """Return whether a picture is black beyond two circles side by side, and lit close to their borders."""
    height, width = grey.shape
    rows, columns = np.mgrid[:height, :width] + 0.5
    across = np.abs(columns % (width // 2) - width / 4)
    radius = np.hypot(across, rows - height / 2) / (height / 2)
    beyond = grey[radius > _BEYOND_CIRCLE]
    rim = grey[(radius < _IN_CIRCLE) & (radius > 0.7)]
    return bool(np.quantile(beyond, 0.95) < _BLACK and np.median(rim) > _LIT and np.mean(rim > _BLACK) > 0.9)


def _is_repeated(first: Grey, second: Grey) -> bool:
    """Return whether two halves show the same, but for a disparity across."""
    size = (_EYE * first.shape[1] // first.shape[0], _EYE)
    one = local_contrast(np.asarray(cv2.resize(first, size, interpolation=cv2.INTER_AREA)))
    other = local_contrast(np.asarray(cv2.resize(second, size, interpolation=cv2.INTER_AREA)))
    middle = one[:, _DISPARITY:-_DISPARITY]
    if middle.std() < 0.1:
        return False
    correlation = cv2.matchTemplate(other, np.ascontiguousarray(middle), cv2.TM_CCOEFF_NORMED)
    return bool(correlation.max() > _REPEATED)


def check_cube(pictures: Sequence[Pixels], arrangement: Arrangement) -> None:
    """Raise ArgumentError for colours of six faces that are certainly not of 90 degrees each, and flat.

    Args:
        pictures: (s, s, 3), of any type.
        arrangement: the faces that they show.
    """
    faces = [np.asarray(grey_levels(picture).mean(axis=-1), np.float32) for picture in pictures]
    extent, step, step_of_cube = _extent(_small(faces, _WIDTH), arrangement)
    expected = "expected six faces of 90 degrees"
    if extent > _LEAST_WIDER:
        fov_deg = np.degrees(2 * np.arctan(extent))
        steps = f"edges step by {step:.1f} grey levels so, by {step_of_cube:.1f} as 90 degrees"
        remedy = f"keep the middle {100 / extent:.2f} % of each, across and down"
        actual = f"{fov_deg:.2f} degrees by their edges ({steps})"
        raise ArgumentError(f"{expected}, got {actual}; {remedy}; {_AS_SAID}")
    if len(faces[0]) >= _LEAST_FACE and _is_equi_angular(_small(faces, _FACE), arrangement):
        remedy = "ffmpeg -vf v360=eac:equirect makes a panorama of a picture of six"
        actual = "an equi-angular cube (EAC), as lines bend at the edges"
        raise ArgumentError(f"{expected}, got {actual}; {remedy}; {_AS_SAID}")


def _small(faces: Sequence[Grey], most: int) -> list[Grey]:
    """Return faces of at most so many px (``most``)."""
    if len(faces[0]) <= most:
        return list(faces)
    return [np.asarray(cv2.resize(face, (most, most), interpolation=cv2.INTER_AREA)) for face in faces]


def _turned(faces: Sequence[Grey], arrangement: Arrangement) -> list[tuple[Grey, Grey]]:
    """Return by edge both faces, turned so that their first rows meet there, column by column."""
    pairs = []
    picture_of = {face.row: picture for picture, face in enumerate(arrangement)}
    for (a, side_a), (b, side_b) in edges():
        picture_a = picture_of[a]
        picture_b = picture_of[b]
        first = np.rot90(faces[picture_a], (side_a + arrangement[picture_a].quarters) % 4)
        second = np.rot90(faces[picture_b], (side_b + arrangement[picture_b].quarters) % 4)[:, ::-1]
        pairs.append((np.ascontiguousarray(first), np.ascontiguousarray(second)))
    return pairs


def _extent(faces: Sequence[Grey], arrangement: Arrangement) -> tuple[float, float, float]:
    """Return the extent of faces, of which 1 is 90 degrees, by which edges agree; the step so, and at 1."""
    size = len(faces[0])
    pairs = _turned(faces, arrangement)
    steps = np.zeros(len(_WIDER))
    along = np.linspace(-1, 1, size)
    for i, extent in enumerate(_WIDER):
        columns = ((along / extent + 1) * size / 2 - 0.5).astype(np.float32)[None]
        rows = np.full_like(columns, max(0.0, (1 - 1 / extent) * size / 2 - 0.5))
        for first, second in pairs:
            line = cv2.remap(first, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            other = cv2.remap(second, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            steps[i] += np.abs(line - other).mean() / len(pairs)
    best = int(steps.argmin())
    is_clear = steps[best] < _CLEAR * steps[0] and steps[0] - steps[best] > 1
    return float(_WIDER[best]) if is_clear else 1.0, float(steps[best]), float(steps[0])


def _is_equi_angular(faces: Sequence[Grey], arrangement: Arrangement) -> bool:
    """Return whether lines bend over the edges of faces as those of an equi-angular cube do.

    Beside an edge, y from -1 to 1 along it, colours of a plain cube change by ``f_out - f_in = y f_y`` more
    per pixel away from it on one side than towards it on the other; those of an equi-angular one by
    ``sin(pi y / 2) f_y``. The bend is the weight of the difference between both, 0 for a plain cube.
    """
    size = len(faces[0])
    places = np.arange(_LINES) + 0.5
    to_value, to_slope = np.linalg.inv(np.vander(places, increasing=True))[:2]
    y = 2 * (np.arange(size) + 0.5) / size - 1
    margin = slice(_LINES, -_LINES)
    kinks: list[Array] = []
    plain: list[Array] = []
    shifts: list[Array] = []
    for first, second in _turned(faces, arrangement):
        on_edge = _smooth((to_value @ first[:_LINES] + to_value @ second[:_LINES]) / 2)
        slope = np.zeros_like(on_edge)
        slope[2:-2] = (8 * (on_edge[3:-1] - on_edge[1:-3]) - (on_edge[4:] - on_edge[:-4])) / 12
        kinks.append(_smooth(to_slope @ first[:_LINES] + to_slope @ second[:_LINES])[margin])
        plain.append((y * slope)[margin])
        shifts.append(((np.sin(np.pi * y / 2) - y) * slope)[margin])
    kink = np.concatenate(kinks)
    as_plain = np.concatenate(plain)
    share, _ = _slope(as_plain, kink)
    left = np.median(np.abs(kink - share * as_plain))
    if left > (1 - _EXPLAINED) * np.median(np.abs(kink)):
        return False
    bend, sigma = _slope(np.concatenate(shifts), kink - as_plain)
    return bend > _EAC and bend - sigma > 1


def _smooth(line: Array) -> Array:
    """Return a line (n,) blurred along itself."""
    return np.asarray(cv2.GaussianBlur(line[None], (0, 0), _BLUR)[0])


def _slope(x: Array, y: Array) -> tuple[float, float]:
    """Return the slope of a line through the origin, few outliers aside, and its standard deviation."""
    weight = np.ones_like(x)
    slope = 0.0
    for _ in range(10):
        slope = float((weight * x * y).sum() / ((weight * x * x).sum() + 1e-12))
        off = y - slope * x
        scale = 2 * (1.48 * np.median(np.abs(off)) + 0.05)
        weight = 1 / (1 + (off / scale) ** 2)
    spread = np.sqrt(2 * _BLUR * (weight**2 * off**2 * x**2).sum())  # neighbours along an edge are alike
    return slope, float(spread / ((weight * x * x).sum() + 1e-12))
