"""Faults of posed pictures within their convention, with their sizes: a robust fit to pairs that overlap.

Poses have errors, too, which add up along the path. How large they are is estimated with the faults
(restricted maximum likelihood), and residuals are weighed by what that leaves.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from omniscv.geometry import Array
from omniscv.importing.overlap import PosedPictures, moves

LEAST_FRAMES = 8
"""From fewer frames no fault is named."""
PAIRS = 30
WIDTH = 1300
"""Pairs of frames that are compared, and px of their width, at most."""


class Parameter(NamedTuple):
    """What may be off: its name, the step of derivatives, the size that matters, and the most that is likely.

    The size that is told has ``unit``, and is ``scale`` times the parameter.
    """

    name: str
    step: float
    matters: float
    most: float
    unit: str
    scale: float = 1.0


PARAMETERS = (
    Parameter("scale of depth", 2e-3, 2e-3, 0.1, "%", 100),
    Parameter("focal length", 2e-3, 2e-3, 0.1, "%", 100),
    Parameter("aspect", 2e-3, 3e-3, 0.1, "%", 100),
    Parameter("centre, x", 0.2, 0.12, 10, "px"),
    Parameter("centre, y", 0.2, 0.12, 10, "px"),
    Parameter("radial distortion k1", 4e-3, 4e-3, 0.2, ""),
    Parameter("planar depth, towards along the ray", 0.03, 0.08, 1.0, "of 1"),
    Parameter("time of pictures after poses", 0.05, 0.06, 1.0, "frames"),
    Parameter("rolling shutter, top to bottom", 0.05, 0.1, 1.0, "frames"),
    Parameter("offset of depth", 2e-3, 2e-3, 0.1, "of its median"),
)
SCALE, FOCAL, ASPECT, CX, CY, K1, RAY, TIME, ROLLING, OFFSET = range(len(PARAMETERS))
_OF_PANORAMA = (SCALE, TIME, OFFSET)
_POSE = slice(len(PARAMETERS), len(PARAMETERS) + 6)  # behind parameters: a turn and a move of second cameras
_STEPS = np.array([parameter.step for parameter in PARAMETERS] + [1e-3] * 6)
_MATTERS = np.array([parameter.matters for parameter in PARAMETERS])
_LIKELY = np.array([parameter.most for parameter in PARAMETERS])

_POINTS = 400  # of a pair, each way
_SMOOTH = 0.012  # second difference of inverse depth of surfaces that are compared, relative
_SOFT = 2.0  # px, by which depth is blurred for derivatives
_FAR_OFF = 0.2  # log depth of another surface
_TUKEY = 4.7
_SIGMA = 8.0
_SURE_SIGMA = 10.5  # from which a parameter counts, though all others may be off, too
_JOINT_SIGMA = 2.0
_LIKELY_SIGMA = 2.0
_BLOCKS = (16, 8)  # of time, over which residuals may be alike
_TOGETHER = 20  # pairs in a row, whose errors of poses are related
_MOST_FAULTS = 5
_ROUNDS = 8
_LEAST_POINTS = 200
# Shares of sizes, and of what matters, that the fit's model is off by:
_INEXACT = 0.02
_OF_MATTERS = 0.05
_PER_NOISE = 20.0  # more of a size, for each of the noise of log depth, which weakens derivatives
_AS_WELL = 0.75  # of the gain, by which another parameter explains the same
_POSE_NOISE = np.geomspace(1e-5, 0.03, 17)  # of a frame: radians, and shares of the median depth
_DETERMINED = 0.3  # of the most that is likely: a parameter is judged if it is known better than this
_LEAST_OF_HALF = 0.5  # of a size, that each half of the pairs shows by itself
_HALF_SIGMA = 2.5
_STILL = 3e-3  # radians from frame to frame, below which a camera does not turn; and so many times the drift
_STILL_DRIFTS = 5.0
_MOST_TURN = np.radians(25)  # from frame to frame, of a video


class Fault(NamedTuple):
    """A parameter that is off, by how much, with its standard deviation, and what explains the same."""

    parameter: Parameter
    size: float
    sigma: float
    others: tuple[Parameter, ...] = ()


class Found(NamedTuple):
    """Faults; what is left of log depth (P, n), NaN where none is compared; how large errors of poses are.

    ``drift`` is in radians, and in shares of the median depth, of a frame. ``is_turning``: whether the camera
    turns; if not, as along a line at even speed, a shift of colours is another origin.
    """

    faults: list[Fault]
    left: Array
    drift: float
    is_turning: bool = True


class System(NamedTuple):
    """Derivatives (P, m, k) and residuals (P, m), free of errors of poses; see :class:`Found`."""

    J: Array
    r: Array
    left: Array
    drift: float

    def half(self, second: bool) -> "System":
        """Return the equations of the first half of the pairs, in the order of time, or of the ``second``."""
        rows = np.array_split(np.arange(len(self.r)), 2)[int(second)]
        return self._replace(J=self.J[rows], r=self.r[rows])

    def doubts(self, most: Array) -> Array:
        """Return (k,) how unsure each parameter is if all others may be off, too.

        ``most`` (k,) are the ranges in which parameters lie. Of one that motion or scene do not determine,
        nothing but its range is known.
        """
        J = self.J.reshape(-1, self.J.shape[-1]) * most
        _, singular, V = np.linalg.svd(np.linalg.qr(J, mode="r"))
        return np.asarray(most * np.sqrt((V**2 / (1 + singular[:, None] ** 2)).sum(axis=0)))

    def solve(self, chosen: list[int]) -> tuple[Array, Array, float]:
        """Return the step of the ``chosen`` parameters, their standard deviations, and the gain.

        Standard deviations are robust: residuals may be alike over some time.
        """
        J = self.J[..., chosen]
        inverse = np.linalg.pinv(np.einsum("pni,pnj->ij", J, J), rcond=1e-12)
        total = np.einsum("pni,pn->i", J, self.r)
        step = -inverse @ total
        scores = np.einsum("pni,pn->pi", J, self.r + J @ step)
        variance = np.diag(inverse)
        for count in _BLOCKS:
            blocks = np.stack([block.sum(axis=0) for block in np.array_split(scores, count)])
            robust = inverse @ (blocks.T @ blocks) @ inverse * count / (count - 1)
            variance = np.maximum(variance, np.diag(robust))
        return step, np.sqrt(np.maximum(variance, 1e-18)), float(total @ inverse @ total)


class Fit:
    """Fits parameters to pictures.

    Args:
        pictures: with pairs.
        R, t: (N, 3, 3), (N, 3) poses of frames, in the unit of depth.
        along: whether depth is along the ray.
    """

    def __init__(self, pictures: PosedPictures, R: Array, t: Array, along: bool) -> None:
        self.pictures = pictures
        self.along = float(along)
        frames = pictures.frames
        pairs = np.concatenate([pictures.pairs, pictures.pairs[:, ::-1]])
        self.pairs = pairs[np.argsort(frames[pairs].sum(axis=1), kind="stable")]
        self.a, self.b = self.pairs.T[:, :, None]
        height, width = pictures.depth.shape[1:]
        random = np.random.default_rng(1)
        shape = (len(self.pairs), _POINTS)
        rows = random.integers(2, height - 2, shape)
        columns = random.integers(2, width - 2, shape)
        self.u = columns + 0.5
        self.v = rows + 0.5
        smooth = self._read_surfaces()
        self.stored = (pictures.depth * smooth)[self.a, rows, columns].astype(np.float64)
        self.median = float(np.median(pictures.depth[pictures.depth > 0]))
        self.R, self.t = moves(R[frames], t[frames], self.pairs)
        self.into_b = R[frames][self.pairs[:, 1]].swapaxes(1, 2)
        is_video = self._read_motion(R, t)
        possible = _OF_PANORAMA if pictures.panorama else range(len(PARAMETERS))
        self.possible = np.array([i for i in possible if is_video or i not in (TIME, ROLLING)])
        first, second = frames[self.pairs].T
        both = np.minimum.outer  # errors that add up are alike until the earlier frame
        self.alike = both(second, second) - both(second, first) - both(first, second) + both(first, first)

    def _read_surfaces(self) -> NDArray[np.bool_]:
        """Set inverse depth, as it is and blurred, and return (M, H, W) where it may be interpolated."""
        depth = self.pictures.depth
        known = depth > 0
        inverse = np.where(known, 1 / np.where(known, depth, 1), 0).astype(np.float32)
        smooth = np.zeros(depth.shape, np.bool_)
        for index in range(len(depth)):
            smooth[index] = _smooth(inverse[index], known[index])
        width = depth.shape[2]
        self.inverse = np.where(smooth, inverse, np.float32(np.nan)).reshape(-1, width)
        blurred = _blurred(inverse * smooth) / np.maximum(_blurred(smooth), 1e-6)
        self.soft = np.where(smooth, blurred, np.float32(np.nan)).reshape(-1, width)
        return smooth

    def _read_motion(self, R: Array, t: Array) -> bool:
        """Set how frames turn and move from one to the next; return whether they are of a video."""
        frames = np.arange(len(R))
        before = np.maximum(frames - 1, 0)
        after = np.minimum(frames + 1, frames[-1])
        spans = (after - before)[:, None]
        turns = Rotation.from_matrix(R[before].swapaxes(1, 2) @ R[after]).as_rotvec() / spans
        steps = np.einsum("nji,nj->ni", R, t[after] - t[before]) / spans
        self.turns = turns[self.pictures.frames]
        self.steps = steps[self.pictures.frames]
        return bool(np.median(np.linalg.norm(turns, axis=1)) < _MOST_TURN)

    def residuals(self, theta: Array, soft: bool = True) -> Array:
        """Return (P, n) log of observed over expected depth; NaN where none is compared.

        Args:
            theta: parameters, and ``_POSE``, in world axes and shares of the median depth.
            soft: compare with blurred depth, for derivatives, which noise of depth would swamp.
        """
        a = self.a
        b = self.b
        height = self.pictures.depth.shape[1]
        scale = np.exp(theta[SCALE])
        offset = theta[OFFSET] * self.median
        kind = self.along + theta[RAY]
        rays = self._rays(theta)
        p = rays * ((self.stored * scale + offset) / np.linalg.norm(rays, axis=-1) ** kind)[..., None]
        if is_late := bool(theta[TIME] or theta[ROLLING]):
            tau = (theta[TIME] + theta[ROLLING] * (self.v / height - 0.5))[..., None]
            p = _turned(tau * self.turns[a], p) + tau * self.steps[a]
        q = p @ self.R.swapaxes(1, 2) + self.t[:, None]
        tau = np.full((*self.v.shape, 1), theta[TIME])
        for _ in range(3 if theta[ROLLING] else 1):
            there = _turned(-tau * self.turns[b], q - tau * self.steps[b]) if is_late else q
            if theta[_POSE].any():
                turn, move = np.split(self.into_b @ theta[_POSE].reshape(2, 3).T, 2, axis=-1)
                there = there + np.cross(turn.swapaxes(1, 2), there) + self.median * move.swapaxes(1, 2)
            u, v, expected = self._projected(there, theta, kind)
            tau = (theta[TIME] + theta[ROLLING] * (v / height - 0.5))[..., None]
        width = self.pictures.depth.shape[2]
        seen = (self.stored > 0) & (u > 1.5) & (v > 1.5) & (u < width - 1.5) & (v < height - 1.5)
        at = (np.where(seen, b * height + v - 0.5, 0), np.where(seen, u - 0.5, 0))
        inverse = map_coordinates(self.soft if soft else self.inverse, at, order=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            off = -np.log(inverse * (expected - offset) / scale)
        return np.where(seen & np.isfinite(off), off, np.nan)

    def _lens(self, theta: Array, frame: Any) -> tuple[Array, Array, Array, Array]:
        fx, fy, cx, cy = np.moveaxis(self.pictures.lenses[frame], -1, 0)
        longer = np.exp(theta[FOCAL])
        wider = np.exp(theta[ASPECT] / 2)
        return fx * longer * wider, fy * longer / wider, cx + theta[CX], cy + theta[CY]

    def _rays(self, theta: Array) -> Array:
        if self.pictures.panorama:
            return self.pictures.rays(self.pairs[:, 0], self.u, self.v)
        fx, fy, cx, cy = self._lens(theta, self.a)
        bent = np.stack([(self.u - cx) / fx, (self.v - cy) / fy], axis=-1)
        straight = bent
        for _ in range(4 if theta[K1] else 0):
            straight = bent / (1 + theta[K1] * (straight**2).sum(axis=-1, keepdims=True))
        return np.concatenate([straight, np.ones_like(bent[..., :1])], axis=-1)

    def _projected(self, p: Array, theta: Array, kind: float) -> tuple[Array, Array, Array]:
        """Return pixels and the depth that is expected there."""
        x, y, z = np.moveaxis(p, -1, 0)
        if self.pictures.panorama:
            height, width = self.pictures.depth.shape[1:]
            far = np.linalg.norm(p, axis=-1)
            u = (0.5 + np.arctan2(x, z) / (2 * np.pi)) * width
            v = (0.5 + np.arcsin(y / far) / np.pi) * height
            return u, v, far
        ahead = np.where(z > 1e-6, z, np.nan)
        x = x / ahead
        y = y / ahead
        square = x * x + y * y
        bent = 1 + theta[K1] * square
        fx, fy, cx, cy = self._lens(theta, self.b)
        return x * bent * fx + cx, y * bent * fy + cy, ahead * (1 + square) ** (kind / 2)

    def system(self, theta: Array) -> System | None:
        """Return the equations of all parameters at ``theta``; None where too few points are compared."""
        off = self.residuals(theta, soft=False)
        steps = np.diag(_STEPS)
        derivatives = []
        for step in (*steps[_POSE], *steps[self.possible]):
            difference = self.residuals(theta + step) - self.residuals(theta - step)
            derivatives.append(difference / (2 * step.sum()))
        J = np.stack(derivatives, axis=-1)
        known = np.isfinite(J).all(axis=-1) & (np.abs(off) < _FAR_OFF)
        if known.sum() < _LEAST_POINTS:
            return None
        edges = (np.abs(J) > 6 * np.quantile(np.abs(J[known]), 0.95, axis=0) + 1e-12).any(axis=-1)
        root = np.sqrt(np.where(known & ~edges, _tukey(off, self._spread(off, known)), 0))[..., None]
        Q, T = np.linalg.qr(root * np.nan_to_num(J))  # what tells poses and parameters: no other residuals
        r = (root * Q).swapaxes(1, 2) @ np.nan_to_num(off)[..., None]
        X = np.concatenate([T[..., 6:], r], axis=-1)
        best = np.inf
        for share in _POSE_NOISE:
            Z, logarithm = self._free_of_poses(X, T, share)
            cost, noise = self._cost(Z, logarithm)
            if cost < best:
                best = cost
                drift = share * noise**0.5
                equations = Z / noise**0.5
        return System(equations[..., :-1], equations[..., -1], off, float(drift))

    def _free_of_poses(self, X: Array, T: Array, share: float) -> tuple[Array, float]:
        """Return equations X (P, m, k) whitened by errors of poses, and half the log determinant of those.

        ``T`` (P, m, n) has the derivatives by poses first; ``share`` is the error of a frame, in radians, and
        in shares of the median depth.
        """
        Z = X.copy()
        logarithm = 0.0
        for block in np.array_split(np.arange(len(X)), 2 * -(-len(X) // (2 * _TOGETHER))):
            F = share * T[block, :6, :6].reshape(-1, 6)
            alike = np.kron(self.alike[np.ix_(block, block)], np.ones((6, 6)))
            L = cholesky(np.eye(len(F)) + F @ F.T * alike, lower=True)
            free = solve_triangular(L, X[block, :6].reshape(len(F), -1), lower=True)
            Z[block, :6] = free.reshape(len(block), 6, -1)
            logarithm = logarithm + np.log(np.diag(L)).sum()
        return Z, logarithm

    def _cost(self, Z: Array, logarithm: float) -> tuple[float, float]:
        """Return the restricted likelihood of equations Z (P, m, k), -2 times its log, and their noise."""
        H = np.einsum("pmi,pmj->ij", Z, Z)
        unexplained = H[-1, -1] - H[-1, :-1] @ np.linalg.pinv(H[:-1, :-1], rcond=1e-12) @ H[:-1, -1]
        count = Z[..., 0].size
        noise = max(1.0, unexplained / (count - len(H) + 1))  # of points that are alike
        cost = unexplained / noise + count * np.log(noise) + 2 * logarithm
        cost += np.linalg.slogdet(H[:-1, :-1] / noise + np.diag(_LIKELY[self.possible] ** -2.0))[1]
        return cost, noise

    def _spread(self, off: Array, known: NDArray[np.bool_]) -> Array:
        """Return (P, n) the noise of log depth, by depth."""
        bounds = np.quantile(self.stored[known], np.linspace(0, 1, 7))
        of_point = np.clip(np.searchsorted(bounds, self.stored) - 1, 0, 5)
        noise = np.ones(6)
        for index in range(6):
            residuals = np.abs(off[known & (of_point == index)])
            if residuals.size:
                noise[index] = 1.4826 * np.median(residuals) + 2e-5
        return np.asarray(noise[of_point])

    def _settled(self, theta: Array, chosen: list[int], system: System) -> tuple[Array, System | None]:
        """Return parameters with those of ``chosen`` fitted, and the equations there."""
        at = self.possible[chosen]
        after = system
        for _ in range(_ROUNDS):
            step = after.solve(chosen)[0]
            theta = theta.copy()
            theta[at] = np.clip(theta[at] + step, -2 * _LIKELY[at], 2 * _LIKELY[at])
            system_there = self.system(theta)
            if system_there is None:
                return theta, None
            after = system_there
            if (np.abs(step) < 0.1 * _MATTERS[at]).all():
                break
        return theta, after

    def find(self) -> Found:
        """Return what is off beyond doubt, the greatest gain first."""
        theta = np.zeros(len(_STEPS))
        matters = _MATTERS[self.possible]
        chosen: list[int] = []
        others: list[list[int]] = []  # for each chosen one, what explains the same
        sigmas = np.zeros(0)  # of the chosen ones
        system = self.system(theta)
        if system is None:
            return Found([], np.full((1, 1), np.nan), 0.0)
        refused = {*range(len(self.possible))} - {*self.judged(system)}
        still = _STILL + _STILL_DRIFTS * system.drift
        is_turning = float(np.median(np.linalg.norm(self.turns, axis=1))) > still
        while len(chosen) < _MOST_FAULTS:
            gains = self._gains(system, chosen, refused)
            if not gains:
                break
            most, best = gains[-1]
            trial = [*chosen, best]
            fitted, after = self._settled(theta, trial, system)
            if after is None or not self._is_proven(fitted, trial, after):
                refused.add(best)
                continue
            others.append(_at_least(_AS_WELL * most, gains[:-1]))
            theta = fitted
            system = after
            chosen = trial
            sigmas = after.solve(trial)[1]
        noise = 1.4826 * float(np.nanmedian(np.abs(system.left)))
        sizes = theta[self.possible][chosen]
        model = np.hypot((_INEXACT + _PER_NOISE * noise) * sizes, _OF_MATTERS * matters[chosen])
        faults = self._faults(chosen, sizes, np.hypot(sigmas, model), others)
        return Found(faults, system.left, system.drift, is_turning)

    def _is_proven(self, theta: Array, chosen: list[int], system: System) -> bool:
        """Return whether parameters are off beyond doubt, and in both halves of the pairs by themselves.

        Args:
            theta: parameters, fitted.
            chosen: indices of those that are off.
            system: the equations there.
        """
        sizes = theta[self.possible][chosen]
        sigmas = system.solve(chosen)[1]
        if (np.abs(sizes) <= np.maximum(_SIGMA * sigmas, _MATTERS[self.possible][chosen])).any():
            return False
        if (np.abs(sizes) > _LIKELY[self.possible][chosen]).any():
            return False
        if (np.abs(sizes[-1]) < _SURE_SIGMA * sigmas[-1]) and not self._is_joint(sizes, chosen, system):
            return False
        for second in (False, True):
            half = system.half(second)
            steps, doubts, _ = half.solve(chosen)
            own = (sizes + steps) * np.sign(sizes)  # what this half shows, in the direction of all
            least = np.maximum(_LEAST_OF_HALF * np.abs(sizes), _HALF_SIGMA * doubts)
            if (own <= least).any():
                return False
        return True

    def judged(self, system: System) -> list[int]:
        """Return the indices of parameters that pictures determine, whatever the others are."""
        likely = _LIKELY[self.possible]
        return [int(i) for i in np.flatnonzero(system.doubts(likely) <= _DETERMINED * likely)]

    def _is_joint(self, sizes: Array, chosen: list[int], system: System) -> bool:
        """Return whether the last chosen parameter is off, too, if all others that are judged are free.

        Args:
            sizes: of the chosen parameters, fitted.
            chosen: their indices.
            system: the equations there.
        """
        free = [i for i in self.judged(system) if i not in chosen]
        steps, sigmas, _ = system.solve([*chosen, *free])
        last = len(chosen) - 1
        return bool((sizes[last] + steps[last]) * np.sign(sizes[last]) > _JOINT_SIGMA * sigmas[last])

    def _faults(self, chosen: list[int], sizes: Array, sigmas: Array, others: list[list[int]]) -> list[Fault]:
        """Return what is off: parameters, by how much and how surely, and what explains the same."""
        faults = []
        for i, size, sigma, also in zip(chosen, sizes, sigmas, others, strict=True):
            parameters = tuple(map(self._parameter, also))
            faults.append(Fault(self._parameter(i), float(size), float(sigma), parameters))
        return faults

    def _parameter(self, index: int) -> Parameter:
        """Return one of the parameters that may be off."""
        return PARAMETERS[self.possible[index]]

    def _gains(self, system: System, chosen: list[int], refused: set[int]) -> list[tuple[float, int]]:
        """Return the gain of each further parameter that may be off, the least first."""
        gains = []
        for i, matters in enumerate(_MATTERS[self.possible]):
            if i in chosen or i in refused:
                continue
            step, sigma, gain = system.solve([*chosen, i])
            if abs(step[-1]) > max(0.5 * matters, _LIKELY_SIGMA * sigma[-1]):
                gains.append((gain - system.solve(chosen)[2], i))
        return sorted(gains)


def _at_least(least: float, gains: list[tuple[float, int]]) -> list[int]:
    """Return the indices of the gains that are greater."""
    indices = []
    for gain, i in gains:
        if gain > least:
            indices.append(i)
    return indices


def _blurred(pictures: NDArray[Any]) -> NDArray[np.float32]:
    """Return (M, H, W) pictures, each blurred."""
    return np.stack([cv2.GaussianBlur(np.float32(picture), (0, 0), _SOFT) for picture in pictures])


def _smooth(inverse: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (H, W) where inverse depth may be interpolated."""
    middle = cv2.medianBlur(inverse, 3)
    filled = np.where(known, inverse, middle)  # single pixels without depth
    bend = np.abs(cv2.Laplacian(cv2.GaussianBlur(filled, (0, 0), 1.0), cv2.CV_32F))
    flat = (middle > 0) & (bend < _SMOOTH * middle)
    return known & np.asarray(cv2.erode(flat.astype(np.uint8), np.ones((3, 3), np.uint8)), np.bool_)


def _tukey(values: Array, sigma: Any) -> Array:
    """Return Tukey's weights over the variance; 0 for NaN."""
    share = np.nan_to_num(values / (_TUKEY * sigma), nan=1.0)
    return np.asarray(np.maximum(0, 1 - share**2) ** 2 / sigma**2)


def _turned(w: Array, p: Array) -> Array:
    """Return points (P, n, 3) turned by rotation vectors (P, n, 3)."""
    return Rotation.from_rotvec(w.reshape(-1, 3)).apply(p.reshape(-1, 3)).reshape(p.shape)
