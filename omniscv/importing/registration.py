"""Does depth belong to its colours? Edges of depth against edges of colours, and what its numbers may be.

Where depth ends, colours mostly change. Depth that is turned, has another lens than its colours, or lies
aside of them, has its edges elsewhere: they are moved until they meet edges of colours. Depth whose numbers
are no lengths agrees with no other frame until they are made lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from omniscv.geometry import Array
from omniscv.importing.overlap import Indices, PosedPictures

_STEP = 0.06  # log depth from pixel to pixel, of an edge
_POINTS = 250  # on edges, of a picture
_LEAST_POINTS = 400  # of all pictures
_LEAST_FRAMES = 4
_STARTS = 3  # places that are refined
_FRAMES = 24  # that are looked at
_BLURS = (3.0, 1.2)  # px of 640, of edges of colours: to search, and to tell
_RATIOS = np.geomspace(0.62, 1.6, 40)  # focal lengths of depth, of those of colours
_OFFSETS_M = np.linspace(-0.12, 0.12, 13)  # across
_GAIN = 0.5  # of the agreement of edges as they are, by which that of others is more
_LEAST_GAIN = 0.15
_LEAST = 0.55  # agreement of edges at the best place; a search finds 0.47 by chance
_MOST_OFFSET_M = 0.11
_OF_HALF = 0.4  # of the gain, which each half of the frames shows by itself
_SIGMAS = 2.3
_INSIDE = 0.4  # share of points that lie in colours, at least
_RATIO_MATTERS = 0.02
_OTHER_LENS = 0.15  # logarithm of a ratio with which depth of frames disagrees
_OFFSET_MATTERS_PX = 1.5
_OFFSET_MATTERS_M = 0.012
_TURNS = {
    (-1, 1): "with left and right exchanged, as numpy.fliplr does",
    (1, -1): "the other way up, as numpy.flipud does",
    (-1, -1): "turned by 180 degrees, as numpy.rot90 with k=2 does",
}
# Of the numbers of depth:
_SATISFIED = 0.6  # agreement from which they are lengths
_CLEAR = 0.75  # of the agreement of other forms, that as they are they do not reach
_LOOK = (140, 0.07)  # points of a pair and tolerance of log depth: to search, and to tell
_READ = (900, 0.03)
_MEDIANS_M = np.geomspace(0.3, 60, 90)  # of depth, that are tried
_NEARS_M = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0)
_FARS_M = (5.0, 10.0, 20.0, 50.0, 100.0, 1000.0, 1e4)
_POWERS = {"1 / depth": -1.0, "the square of depth": 2.0, "the root of depth": 0.5}
_BASES = {"natural logarithms": np.e, "binary logarithms": 2.0, "decimal logarithms": 10.0}
_UNITS_M = (1.0, 0.01, 0.001)
_MOST_LOGARITHM = 9.2  # natural, of lengths in their unit
_DENSE = 0.4  # share of points that lie in the other picture
_AGREES = 0.3  # share of these whose depth agrees, below which something is wrong
_UNEXPLAINED = 0.35  # agreement below which pictures are asked whether they overlap at all
_COARSE = 0.1  # log depth
_LEAST_PAIRS = 3

Edges = NDArray[np.float32]


@dataclass(frozen=True)
class Misfit:
    """Depth that does not belong to its colours: what pictures show, and what puts it right."""

    shows: str
    remedy: str


class _Place(NamedTuple):
    """Where depth lies: turned about the middle, its focal length over that of colours, metres aside."""

    turn: tuple[int, int] = (1, 1)
    ratio: float = 1.0
    right_m: float = 0.0
    down_m: float = 0.0


class _Edges:
    """Edges of depth, and how much colours change around them.

    Args:
        pictures: with colours.
        metres: of one of depth.
    """

    def __init__(self, pictures: PosedPictures, metres: float) -> None:
        random = np.random.default_rng(0)
        height, width = pictures.depth.shape[1:]
        assert pictures.grey is not None
        chosen = np.linspace(0, len(pictures.depth) - 1, min(_FRAMES, len(pictures.depth))).astype(int)
        points: list[Array] = []
        for frame in np.unique(chosen).tolist():
            edge = _edge_points(pictures.depth[frame])
            if len(edge) > _POINTS:
                edge = edge[random.choice(len(edge), _POINTS, replace=False)]
            lens = np.repeat(pictures.lenses[frame][None], len(edge), axis=0)
            points.append(np.column_stack([np.full(len(edge), frame), edge * (1, 1, metres), lens]))
        self.points = np.concatenate(points)
        self.frames = np.unique(self.points[:, 0])
        self.size = (width, height)
        self.maps: list[Edges] = []  # by blur
        for blur in _BLURS:
            sigma = max(0.8, blur * width / 640)
            self.maps.append(np.stack([_changes(grey, sigma) for grey in pictures.grey]))

    def scores(self, place: _Place, blur: int, rows: slice = slice(None)) -> Array:
        """Return by point how much colours change where an edge of depth lies, above the mean.

        Args:
            place: where depth lies.
            blur: index of the map of edges of colours.
            rows: of the points.
        """
        frame, u, v, z, fx, fy, cx, cy = self.points[rows].T
        width, height = self.size
        if place.turn[0] < 0:
            u = width - u
        if place.turn[1] < 0:
            v = height - v
        column = (u - cx) / place.ratio + cx + fx * place.right_m / z - 0.5
        row = (v - cy) / place.ratio + cy + fy * place.down_m / z - 0.5
        maps = self.maps[blur]
        is_inside = (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
        x = np.clip(np.rint(column), 0, width - 1).astype(int)
        y = np.clip(np.rint(row), 0, height - 1).astype(int)
        share = max(float(is_inside.mean()), _INSIDE)  # of depth that is wider than its colours
        return np.where(is_inside, maps[frame.astype(int), y, x] / share, 0.0)

    def by_frame(self, place: _Place) -> Array:
        """Return the mean score of each frame."""
        scores = self.scores(place, 1)
        return np.array([scores[self.points[:, 0] == frame].mean() for frame in self.frames])

    def best(self) -> _Place:
        """Return the place of depth at which its edges meet most of those of colours.

        A turned one has to be clearly better than all others.
        """
        some = slice(None, None, max(1, len(self.points) // 1500))
        places = [_Place((1, 1), ratio, offset) for ratio, offset in product(_RATIOS, _OFFSETS_M)]
        places.sort(key=lambda place: -float(self.scores(place, 0, some).mean()))
        upright = max(map(self._refined, [*places[:_STARTS], _Place()]), key=self._score)
        turned = max(map(_Place, _TURNS), key=self._score)
        gain = max(_LEAST_GAIN, _GAIN * self._score(upright))
        return turned if self._score(turned) > self._score(upright) + gain else upright

    def _score(self, place: _Place) -> float:
        return float(self.scores(place, 1).mean())

    def _refined(self, start: _Place) -> _Place:
        """Return the place of most score near another one."""
        for blur in range(len(_BLURS)):

            def cost(x: Array, blur: int = blur, turn: tuple[int, int] = start.turn) -> float:
                place = _Place(turn, float(np.exp(x[0])), float(x[1]), float(x[2]))
                return -float(self.scores(place, blur).mean())

            x = np.array([np.log(start.ratio), start.right_m, start.down_m])
            simplex = x + np.vstack([np.zeros(3), np.diag([0.015, 0.01, 0.01])])
            fit = minimize(cost, x, method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": 90})
            start = _Place(start.turn, float(np.exp(fit.x[0])), float(fit.x[1]), float(fit.x[2]))
        return start


def _edge_points(depth: NDArray[np.float32]) -> Array:
    """Return (n, 3) where depth ends: pixels u, v between two of them, and the nearer depth."""
    rows = []
    with np.errstate(divide="ignore"):
        logarithm = np.log(depth)
    for axis in (0, 1):
        first = np.delete(logarithm, -1, axis=axis)
        second = np.delete(logarithm, 0, axis=axis)
        with np.errstate(invalid="ignore"):
            is_edge = np.isfinite(first) & np.isfinite(second) & (np.abs(first - second) > _STEP)
        v, u = np.nonzero(is_edge)
        nearer = np.exp(np.minimum(first[v, u], second[v, u]))
        rows.append(np.column_stack([u + (1.0 if axis else 0.5), v + (0.5 if axis else 1.0), nearer]))
    return np.concatenate(rows)


def _changes(grey: NDArray[np.float32], sigma: float) -> Edges:
    """Return (H, W) how much colours change, 0 in the mean, blurred by ``sigma`` px."""
    across = cv2.Sobel(grey, cv2.CV_32F, 1, 0)
    down = cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    strength = np.hypot(across, down)
    strength = np.minimum(strength / max(float(np.quantile(strength, 0.9)), 1e-6), 1)
    blurred = cv2.GaussianBlur(strength, (0, 0), sigma)
    return np.asarray((blurred - blurred.mean()) / (blurred.std() + 1e-3), np.float32)


def misplaced(
    pictures: PosedPictures, metres: float, is_turned_asked: bool, agreement: float
) -> Misfit | None:
    """Return how depth lies beside its colours, if edges of both say so beyond doubt.

    Args:
        pictures: with pairs.
        metres: of one of depth.
        is_turned_asked: whether depth may be turned; not where colours are known to be.
        agreement: of the depth of frames with each other, by the lens of colours.
    """
    if pictures.grey is None or pictures.panorama:
        return None
    edges = _Edges(pictures, metres)
    if len(edges.points) < _LEAST_POINTS or len(edges.frames) < _LEAST_FRAMES:
        return None
    place = edges.best()
    as_said = edges.by_frame(_Place())
    better = edges.by_frame(place) - as_said
    gain = float(better.mean())
    if gain < max(_LEAST_GAIN, _GAIN * float(as_said.mean())) or gain + as_said.mean() < _LEAST:
        return None
    is_far = max(abs(place.right_m), abs(place.down_m)) > _MOST_OFFSET_M
    if is_far or not _RATIOS[1] < place.ratio < _RATIOS[-2]:
        return None  # edges of other things
    if abs(np.log(place.ratio)) > _OTHER_LENS and agreement >= _SATISFIED:
        return None  # points by a lens so wrong would not agree from frame to frame
    if min(better[::2].mean(), better[1::2].mean()) < _OF_HALF * gain:
        return None
    if better.mean() < _SIGMAS * better.std() / np.sqrt(len(better)):
        return None
    return _misfit_of(edges, place, is_turned_asked)


def _misfit_of(edges: _Edges, place: _Place, is_turned_asked: bool) -> Misfit | None:
    """Return a place of depth in words; None if it is nearly as said."""
    if place.turn in _TURNS:
        if not is_turned_asked:
            return None
        how = _TURNS[place.turn]
        return Misfit(f"depth {how.partition(',')[0]}", f"write depth {how} (colours are as they should be)")
    focal_px = float(np.median(edges.points[:, 4]))
    nearness = float(np.median(1 / edges.points[:, 3]))
    parts = []
    if abs(np.log(place.ratio)) > _RATIO_MATTERS:
        parts.append(f"a lens of its own, {place.ratio:.3g} times as long as that of colours")
    offset_m = float(np.hypot(place.right_m, place.down_m))
    if offset_m > _OFFSET_MATTERS_M and focal_px * offset_m * nearness > _OFFSET_MATTERS_PX:
        way = f"{1000 * place.right_m:+.0f} mm to the right and {1000 * place.down_m:+.0f} mm down"
        parts.append(f"a camera of its own, whose points lie {way} of where colours have them")
    if not parts:
        return None
    remedy = "register depth to colours, as cameras' own programs do, or give depth alone with its own lens"
    return Misfit(f"depth of {' and '.join(parts)}", remedy)


class _Form(NamedTuple):
    """What numbers of depth may be: a name, and their lengths in metres."""

    name: str
    lengths: Callable[[NDArray[np.float32]], Array]


def _of_power(depth: Array, power: float, median: float, median_m: float) -> Array:
    """Return lengths whose median is ``median_m`` metres, of numbers that are a power of them."""
    return np.asarray(median_m * (depth / median) ** (1 / power))


def _of_logarithm(depth: Array, base: float, metres: float, added: float) -> Array:
    """Return lengths in units of so many ``metres``, of logarithms of them and of what is ``added``."""
    return np.asarray(metres * (base**depth - added))


def _of_buffer(depth: Array, near: float, far: float) -> Array:
    """Return lengths of a z-buffer from 0 to 1 between two planes, metres."""
    return np.asarray(near * far / (far - depth * (far - near)))


def _forms(depth: NDArray[np.float32]) -> Iterator[_Form]:
    """Yield forms that numbers of depth may have; 0 is no surface."""
    known = depth[depth > 0]
    median = float(np.median(known))
    for median_m in _MEDIANS_M.tolist():
        for name, power in _POWERS.items():
            yield _Form(name, partial(_of_power, power=power, median=median, median_m=median_m))
    for name, base in _BASES.items():
        if np.log(base) * float(known.max()) < _MOST_LOGARITHM:
            for metres, added in product(_UNITS_M, (0.0, 1.0)):
                yield _Form(name, partial(_of_logarithm, base=base, metres=metres, added=added))
    if known.max() <= 1:
        for near, far in product(_NEARS_M, _FARS_M):
            name = f"a z-buffer, near {near:g} m and far {far:g} m"
            yield _Form(name, partial(_of_buffer, near=near, far=far))


def misread(
    pictures: PosedPictures, motion: tuple[Array, Array], along: bool, agreement: float
) -> Misfit | None:
    """Return what numbers of depth are, if they are no lengths; None where they agree as they are.

    Args:
        pictures: with pairs.
        motion: rotations (P, 3, 3) and translations (P, 3), metres, from first to second cameras.
        along: whether depth is along the ray.
        agreement: of pictures as they are.
    """
    if agreement >= _SATISFIED or len(pictures.pairs) < _LEAST_PAIRS:
        return None
    R, t = motion
    best: tuple[float, _Form] | None = None
    for form in _forms(pictures.depth):
        score = _score(pictures, form, (R, t), (*_LOOK, along))
        if best is None or score > best[0]:
            best = (score, form)
    if best is not None:
        score = _score(pictures, best[1], (R, t), (*_READ, along))
        if score > _SATISFIED and agreement < _CLEAR * score:
            return Misfit(
                f"numbers that are {best[1].name}: agreement {score:.2f} so", "write depth as lengths"
            )
    return None


def unexplained(
    pictures: PosedPictures, motion: tuple[Array, Array], along: bool, agreement: float
) -> Misfit | None:
    """Return that pictures overlap, but that their depth agrees in no form; None where they do not tell that.

    Args:
        pictures: with pairs.
        motion: rotations (P, 3, 3) and translations (P, 3), metres, from first to second cameras.
        along: whether depth is along the ray.
        agreement: of pictures as they are.
    """
    if agreement >= _UNEXPLAINED or len(pictures.pairs) < _LEAST_PAIRS:
        return None
    share, agrees = overlap_as_said(pictures, *motion, along)
    if share < _DENSE or agrees > _AGREES:
        return None
    count = len(list(_forms(pictures.depth)))
    shows = f"{share:.0%} of each picture in another, where {agrees:.0%} of depth agrees"
    remedy = "check which poses, lens and depth belong to these pictures"
    return Misfit(f"{shows}: explained by none of {count} forms of depth", remedy)


def _score(
    pictures: PosedPictures, form: _Form, motion: tuple[Array, Array], how: tuple[int, float, bool]
) -> float:
    """Return the agreement of pictures whose depth is of a form; see :meth:`PosedPictures.agreements`."""
    known = pictures.depth > 0
    with np.errstate(all="ignore"):
        lengths = np.where(known, form.lengths(np.where(known, pictures.depth, 1)), 0)
    lengths = np.where(np.isfinite(lengths) & (lengths > 0) & (lengths < 1e5), lengths, 0)
    others = replace(pictures, depth=np.ascontiguousarray(lengths, np.float32))
    depth, grey = others.agreements(*motion, how).T
    return float((depth if pictures.grey is None else (depth + np.maximum(grey, 0)) / 2).mean())


def overlap_as_said(pictures: PosedPictures, R: Array, t: Array, along: bool) -> tuple[float, float]:
    """Return the share of points that lie in the other picture of a pair, and of these whose depth agrees.

    Args:
        pictures: with pairs, of pinholes; of panoramas all points lie in the other one.
        R: (P, 3, 3) rotations from first to second cameras.
        t: (P, 3) translations, in the unit of depth.
        along: whether depth is along the ray.
    """
    random = np.random.default_rng(2)
    height, width = pictures.depth.shape[1:]
    first, second = pictures.pairs.T
    shape = (len(first), 200)
    v: Indices = random.integers(1, height - 1, shape)
    u: Indices = random.integers(1, width - 1, shape)
    stored = pictures.depth[first[:, None], v, u]
    rays = pictures.rays(first, u + 0.5, v + 0.5)
    lengths = stored if along else stored / np.maximum(rays[..., 2], 1e-6)
    points = np.einsum("pij,pnj->pni", R, rays * lengths[..., None]) + t[:, None]
    if pictures.panorama:
        return 1.0, 1.0
    fx, fy, cx, cy = np.moveaxis(pictures.lenses[second][:, None], -1, 0)
    ahead = np.maximum(points[..., 2], 1e-6)
    column = np.floor(points[..., 0] / ahead * fx + cx)
    row = np.floor(points[..., 1] / ahead * fy + cy)
    is_inside = (points[..., 2] > 1e-3) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    x = np.where(is_inside, column, 0).astype(int)
    y = np.where(is_inside, row, 0).astype(int)
    observed = pictures.depth[second[:, None], y, x]
    expected = np.linalg.norm(points, axis=-1) if along else points[..., 2]
    is_compared = is_inside & (observed > 0) & (stored > 0)
    known = max(int((stored > 0).sum()), 1)
    off = np.abs(np.log(observed[is_compared] / expected[is_compared]))
    return float(is_compared.sum() / known), float((off < _COARSE).mean()) if len(off) else 0.0
