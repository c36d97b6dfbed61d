"""The parameter r_vl of an uncalibrated camera of revolution, from the images of straight lines;
and the edges of colour images that show them.

A camera of revolution sees a point at the angle phi from its axis at the radius r. A line and the optical
centre span a plane with the normal n = (nx, ny, nz), where z is the axis that the image's middle sees. With
``alpha(r) = -r cot phi(r)`` the line's image is ``nx x + ny y - nz alpha(r) = 0``, where (x, y) is relative
to the image's middle. ``r_vl`` is the radius at phi = 90 degrees, of the vanishing points of lines parallel
to the image plane. It alone determines alpha; for hyper-catadioptric systems together with the camera's
focal length. :func:`models` has alpha / r_vl by ``s = r / r_vl``.

For a candidate, each line's plane normal follows linearly from its points. The distances of the points from
the line image of this normal measure the fit.

Source: Bermudez-Cameo, Lopez-Nicolas, Guerrero 2015, Automatic line extraction in uncalibrated
omnidirectional cameras with revolution symmetry; f as in the paper of OmniSCV.

An edge point is a maximum of the gradient's magnitude along the row or column that is nearer to the
gradient's direction, at the top of a parabola through three pixels (Devernay 1995). Neighbours join a chain
while the gradient turns little, so that chains end at corners. RANSAC separates the lines of a chain: three
points determine r_vl and a line's image; the triple that most points agree with takes these points from the
chain.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.geometry.pose import Array

_HALVINGS = 24

Formula = Callable[[Array, Array], Array]
"""Of s and r_vl, px."""

_CANDIDATES = 60
_CAP_PX = 3.0  # bound of the distances: a point farther off is an outlier
_REWEIGHTINGS = 2
_LEAST_NZ = 0.15  # radial lines, whose planes contain the axis, do not depend on r_vl
_MOST_PX = 1.0  # rms distance of the points of a line
_PASSES = 3
_ROBUST_PX = 0.5


@dataclass(frozen=True)
class LineImages:
    """A model of cameras.

    Attributes:
        name: the paper's.
        model: of the camera, for :func:`omniscv.cameras.create`.
        parameters: of the camera, by r_vl, px.
        formula: alpha / r_vl, by s and r_vl.
        derivative: of the formula by s.
        widest: the s that radii are below.
    """

    name: str
    model: str
    parameters: Callable[[float], Mapping[str, Any]]
    formula: Formula
    derivative: Formula
    widest: float = np.inf

    def alpha(self, r: Array, r_vl: Array | float) -> Array:
        """Return alpha, px, NaN where the model has no radius ``r``; ``r`` and ``r_vl`` are px, broadcast."""
        return np.asarray(r_vl * self.formula(self._relative(r, r_vl), np.asarray(r_vl)))

    def slope(self, r: Array, r_vl: Array | float) -> Array:
        """Return the derivative of :meth:`alpha` by ``r``; ``r``, ``r_vl`` are px, and broadcast."""
        return np.asarray(self.derivative(self._relative(r, r_vl), np.asarray(r_vl)))

    def camera(self, size: int, r_vl: float) -> Camera:
        """Return the camera of ``size`` by ``size`` px with that r_vl, px."""
        return cameras.create(self.model, width=size, height=size, **self.parameters(r_vl))

    def r_vl_of_triples(self, points: Array, low: float, high: float) -> Array:
        """Return the r_vl for which three points lie on the image of one line, by bisection.

        With ``l1 = x2 y3 - x3 y2``, ``l2 = x3 y1 - x1 y3``, ``l3 = x1 y2 - x2 y1`` it is a zero of
        ``sum_i l_i alpha(r_i)``.

        Args:
            points: (..., 3, 2) px from the image's middle.
            low: px, the least r_vl.
            high: px, the greatest r_vl.

        Returns:
            (...) px; NaN where there is none.
        """
        r = np.linalg.norm(points, axis=-1)
        b = np.roll(points, -1, axis=-2)
        c = np.roll(points, -2, axis=-2)
        weights = b[..., 0] * c[..., 1] - b[..., 1] * c[..., 0]

        def value(r_vl: Array) -> Array:
            return np.asarray((weights * self.alpha(r, r_vl[..., None])).sum(axis=-1))

        below = np.maximum(r.max(axis=-1) / self.widest * (1 + 1e-9), low)
        above = np.full(below.shape, high)
        with np.errstate(invalid="ignore"):
            start = value(below)
            crossed = start * value(above) < 0
            for _ in range(_HALVINGS):
                middle = (below + above) / 2
                beyond = start * value(middle) > 0
                below = np.where(beyond, middle, below)
                above = np.where(beyond, above, middle)
        return np.where(crossed, (below + above) / 2, np.nan)

    def _relative(self, r: Array, r_vl: Array | float) -> Array:
        s = r / r_vl
        return np.where(s < self.widest, s, np.nan)


def models(focal: float) -> Mapping[str, LineImages]:
    """Return the paper's six models by name; ``focal`` is that of the hyper-catadioptric's camera, px."""
    parabola: tuple[Formula, Formula] = (lambda s, _: (s * s - 1) / 2, lambda s, _: s)
    all_models = (
        LineImages(
            "equi-angular",
            "fisheye-equidistant",
            lambda r_vl: {"focal": 2 * r_vl / np.pi},
            lambda s, _: -s / np.tan(s * np.pi / 2),
            lambda s, _: s * np.pi / 2 / np.sin(s * np.pi / 2) ** 2 - 1 / np.tan(s * np.pi / 2),
            widest=2.0,
        ),
        LineImages("stereographic", "fisheye-stereographic", lambda r_vl: {"focal": r_vl / 2}, *parabola),
        LineImages(
            "orthogonal",
            "fisheye-orthographic",
            lambda r_vl: {"focal": r_vl},
            lambda s, _: -np.sqrt(1 - s * s),
            lambda s, _: s / np.sqrt(1 - s * s),
            widest=1.0,
        ),
        LineImages(
            "equi-solid",
            "fisheye-equisolid",
            lambda r_vl: {"focal": np.sqrt(2) * r_vl},
            lambda s, _: (s * s - 1) / np.sqrt(2 - s * s),
            lambda s, _: s * (3 - s * s) / (2 - s * s) ** 1.5,
            widest=np.sqrt(2),
        ),
        LineImages("para-catadioptric", "catadioptric-parabolic", lambda r_vl: {"focal": r_vl}, *parabola),
        LineImages(
            "hyper-catadioptric",
            "catadioptric-hyperbolic",
            lambda r_vl: {"focal": focal, "distance": 1.0, "semi_latus_rectum": r_vl / focal},
            lambda s, r_vl: focal / r_vl * (np.hypot(s, focal / r_vl) - np.hypot(1, focal / r_vl)),
            lambda s, r_vl: focal / r_vl * s / np.hypot(s, focal / r_vl),
        ),
    )
    return {model.name: model for model in all_models}


class PointsOnLines:
    """Points, grouped by line.

    Args:
        groups: (N_i, 2) px from the image's middle, per line, at least 3 each.
    """

    def __init__(self, groups: Sequence[Array]) -> None:
        self._points = np.concatenate(groups)
        self._r = np.maximum(np.linalg.norm(self._points, axis=-1), 1e-9)
        self._counts = np.array([len(group) for group in groups])
        self._starts = np.cumsum(self._counts) - self._counts

    def fit(self, model: LineImages, r_vl: float) -> tuple[Array, Array]:
        """Fit each line's normal to its points, by least squares of Sampson's distances.

        ``model`` is that of the camera, with ``r_vl``, px.

        Returns:
            (L, 3) unit normals, and (N,) px distances of the points from the line images, at most the cap,
            which stands where the model has no such radius.
        """
        with np.errstate(invalid="ignore"):
            alpha = model.alpha(self._r, r_vl)
            slope = model.slope(self._r, r_vl)
        seen = np.isfinite(alpha) & np.isfinite(slope)
        rows = np.where(seen[:, None], np.column_stack([self._points, -alpha]), 0.0)
        outward = np.where(seen, slope, 0.0)[:, None] * self._points / self._r[:, None]
        weight = seen.astype(np.float64)
        for _ in range(1 + _REWEIGHTINGS):
            products = (weight[:, None] * rows)[:, :, None] * rows[:, None, :]
            normals = np.linalg.eigh(np.add.reduceat(products, self._starts))[1][:, :, 0]
            normal = np.repeat(normals, self._counts, axis=0)
            length = np.maximum(np.linalg.norm(normal[:, :2] - normal[:, 2:] * outward, axis=-1), 1e-9)
            weight = seen / length**2
        distance = np.abs((rows * normal).sum(axis=-1)) / length
        return normals, np.where(seen, np.minimum(distance, _CAP_PX), _CAP_PX)

    def rms(self, distances: Array) -> Array:
        """Return (L,) px of distances (N,)."""
        return np.asarray(np.sqrt(np.add.reduceat(distances**2, self._starts) / self._counts))


def calibrate(groups: Sequence[Array], model: LineImages, low: float, high: float) -> float:
    """Return r_vl, px, by points of lines; NaN if no line depends on it.

    Args:
        groups: (N_i, 2) px from the image's middle, the points of each line; curves that are no lines are
            left out.
        model: of the camera.
        low: px, the least r_vl.
        high: px, the greatest r_vl.
    """
    if not groups:
        return float("nan")
    points = PointsOnLines(groups)
    candidates = np.geomspace(low, high, _CANDIDATES)
    costs = []
    for candidate in candidates:
        _, distances = points.fit(model, candidate)
        costs.append(float((distances**2).sum()))
    r_vl = float(candidates[np.argmin(costs)])
    for _ in range(_PASSES):
        normals, distances = points.fit(model, r_vl)
        used = (np.abs(normals[:, 2]) >= _LEAST_NZ) & (points.rms(distances) <= _MOST_PX)
        if not used.any():
            return float("nan")
        lines = PointsOnLines(list(compress(groups, used)))
        r_vl = _refine(lines, model, r_vl, low, high)
    return r_vl


def _refine(lines: PointsOnLines, model: LineImages, r_vl: float, low: float, high: float) -> float:
    """Return r_vl between ``low`` and ``high``, by robust least squares of the points' distances to lines."""

    def distances(x: Array) -> Array:
        return lines.fit(model, float(x[0]))[1]

    options: Any = {"loss": "soft_l1", "f_scale": _ROBUST_PX, "xtol": 1e-14, "ftol": 1e-14}
    solution = least_squares(distances, [r_vl], bounds=([low], [high]), **options)
    return float(solution.x[0])


# -- edges of images ------------------------------------------------------------------------------------

_SIGMA_PX = 1.0  # of the blur before the gradient
_LEAST_CONTRAST = 4.0  # of 255, per pixel of the blurred image
_MARGIN_PX = 4  # from the image circle, whose rim is no edge of the scene
_MOST_TURN = np.cos(np.radians(20))  # of the gradient between neighbours of a chain
_NEIGHBOURS = ((0, 1), (1, -1), (1, 0), (1, 1))

_TRIPLES = 48
_NEAR_PX = 0.8
_MOST_LINES = 6  # of a chain
_MOST_POINTS = 120  # of a line; more would not make it more accurate


def find_edges(lit: NDArray[np.uint8], valid: NDArray[np.bool_]) -> list[Array]:
    """Return the chains of edge points of an image, (N_i, 2) px each.

    Args:
        lit: (H, W, 3) colours.
        valid: (H, W) inside the field of view.
    """
    blurred = cv2.GaussianBlur(lit.astype(np.float32), (0, 0), _SIGMA_PX)
    along_x = cv2.Scharr(blurred, cv2.CV_32F, 1, 0) / 32
    along_y = cv2.Scharr(blurred, cv2.CV_32F, 0, 1) / 32
    both = np.stack([along_x, along_y], axis=-1)
    most = np.argmax((both**2).sum(axis=-1), axis=-1)  # the channel that changes most
    gradient = np.take_along_axis(both, most[..., None, None], axis=2)[:, :, 0].astype(np.float64)
    size = np.hypot(gradient[..., 0], gradient[..., 1])
    inside = cv2.erode(
        np.pad(valid, 1).astype(np.uint8), np.ones((3, 3), np.uint8), iterations=_MARGIN_PX, borderValue=0
    )[1:-1, 1:-1].astype(bool)
    row, column, offset = _maxima(size, gradient, inside)
    unit = gradient[row, column] / size[row, column, None]
    chain = _chains(row, column, unit, size.shape)
    pixels = np.stack([column + 0.5, row + 0.5], axis=-1) + offset
    return np.split(pixels[np.argsort(chain, kind="stable")], np.cumsum(np.bincount(chain))[:-1])


def group_by_line(
    chains: Sequence[Array], model: LineImages, limits: tuple[float, float], least: int
) -> list[Array]:
    """Return the points of each likely line in chains of edge points.

    Args:
        chains: (N_i, 2) px from the image's middle.
        model: of the camera.
        limits: bounds of r_vl, px.
        least: number of points of a line.
    """
    rng = np.random.default_rng(0)
    groups = []
    for chain in chains:
        points = chain
        for _ in range(_MOST_LINES):
            if len(points) < least:
                break
            near = _largest_consensus(points, model, limits, rng)
            if near.sum() < least:
                break
            line = points[near]
            groups.append(line[:: -(-len(line) // _MOST_POINTS)])
            points = points[~near]
    return groups


def _largest_consensus(
    points: Array, model: LineImages, limits: tuple[float, float], rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return (N,) whether points are near the image of a line through three of them."""
    triples = points[rng.integers(len(points), size=(_TRIPLES, 3))]
    r_vl = model.r_vl_of_triples(triples, *limits)
    triples = triples[np.isfinite(r_vl)]
    r_vl = r_vl[np.isfinite(r_vl), None]
    if not len(triples):
        return np.zeros(len(points), np.bool_)
    rows = np.concatenate([triples, -model.alpha(np.linalg.norm(triples, axis=-1), r_vl)[..., None]], axis=-1)
    normals = np.linalg.svd(rows)[2][:, 2]
    r = np.maximum(np.linalg.norm(points, axis=-1), 1e-9)
    with np.errstate(invalid="ignore"):
        alpha = model.alpha(r, r_vl)
        slope = model.slope(r, r_vl)
        across = normals[:, None, :2] - normals[:, None, 2:] * slope[..., None] * (points / r[:, None])
        value = normals[:, :2] @ points.T - normals[:, 2:] * alpha
        near = np.abs(value) <= _NEAR_PX * np.linalg.norm(across, axis=-1)
    return np.asarray(near[near.sum(axis=1).argmax()])


def _maxima(
    size: Array, gradient: Array, inside: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return rows and columns of the maxima, and (N, 2) px their offsets from the pixels' centres."""
    across = np.abs(gradient[..., 0]) >= np.abs(gradient[..., 1])
    strong = inside & (size >= _LEAST_CONTRAST)
    strong[[0, -1]] = False
    strong[:, [0, -1]] = False
    row, column = np.nonzero(strong)
    step = across[row, column].astype(np.intp)
    middle = size[row, column]
    before = size[row - (1 - step), column - step]
    after = size[row + (1 - step), column + step]
    top = (middle > before) & (middle >= after)
    shift = 0.5 * (before - after)[top] / (before - 2 * middle + after)[top]
    offset = np.stack([shift * step[top], shift * (1 - step[top])], axis=-1)
    return row[top], column[top], offset


def _chains(
    row: NDArray[np.intp], column: NDArray[np.intp], unit: Array, shape: tuple[int, ...]
) -> NDArray[np.intp]:
    """Return the chain of each point, (N,) numbers from 0.

    A chain connects neighbouring pixels between which the gradient turns by less than 20 degrees.

    Args:
        row: (N,) of the points' pixels.
        column: (N,) of the points' pixels.
        unit: (N, 2) directions of the gradient there.
        shape: of the image, (H, W).
    """
    index = np.full(shape, -1, np.intp)
    index[row, column] = np.arange(len(row))
    starts = []
    ends = []
    for down, right in _NEIGHBOURS:
        neighbour = index[(row + down) % shape[0], (column + right) % shape[1]]
        start = np.flatnonzero(neighbour >= 0)
        alike = (unit[start] * unit[neighbour[start]]).sum(axis=-1) >= _MOST_TURN
        starts.append(start[alike])
        ends.append(neighbour[start[alike]])
    first = np.concatenate(starts)
    second = np.concatenate(ends)
    graph = coo_matrix((np.ones(len(first)), (first, second)), shape=(len(row), len(row)))
    _, chain = connected_components(graph, directed=False)
    return np.asarray(chain, np.intp)
