"""Faults of posed pictures within their convention, with their sizes: a robust fit to pairs that overlap.

Poses have errors, too, which add up along the path. How large they are is estimated with the faults
(restricted maximum likelihood), and residuals are weighed by what that leaves.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky
from scipy.linalg.lapack import dtrtri
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from omniscv.geometry import Array
from omniscv.sources.recording.overlap import PosedPictures, moves

LEAST_FRAMES = 8
"""From fewer frames no fault is named."""
PAIRS, WIDTH = 30, 1300
"""Pairs of frames that are compared, and px of their width, at most."""


class Parameter(NamedTuple):
    """What may be off.

    Attributes:
        name: in words.
        step: of derivatives.
        matters: size below which it is not named.
        most: that is likely.
        unit: of the size that is told, which is ``scale`` times the parameter.
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
_STEPS, _MATTERS, _LIKELY = (
    np.array([getattr(p, key) for p in PARAMETERS]) for key in ("step", "matters", "most")
)

_POINTS = 400  # of a pair, each way
_SMOOTH = 0.012  # second difference of inverse depth of surfaces that are compared, relative
_SOFT = 2.0  # px, by which depth is blurred for derivatives
_FAR_OFF = 0.2  # log depth of another surface
_TUKEY, _SIGMA, _LIKELY_SIGMA = 4.7, 5.0, 2.0
_BLOCKS = (16, 8)  # of time, over which residuals may be alike
_TOGETHER = 20  # pairs in a row, whose errors of poses are related
_MOST_FAULTS, _ROUNDS, _EVALUATIONS, _LEAST_POINTS = 5, 4, 6, 200
_INEXACT, _OF_MATTERS = 0.02, 0.05  # shares of sizes that the fit's model is off by
_PER_NOISE = 20.0  # more of a size, for each of the noise of log depth, which weakens derivatives
_AS_WELL = 0.75  # of the gain, by which another parameter explains the same
_POSE_NOISE = np.geomspace(1e-5, 0.03, 17)  # of a frame: radians, and shares of the median depth
_MOST_TURN = np.radians(25)  # from frame to frame, of a video


class Fault(NamedTuple):
    """A parameter that is off, by how much, with its standard deviation, and what explains the same."""

    parameter: Parameter
    size: float
    sigma: float
    others: tuple[Parameter, ...] = ()


class Found(NamedTuple):
    """Faults; what is left of log depth (P, n), NaN where none is compared; how large errors of poses are.

    ``drift`` is in radians, and in shares of the median depth, of a frame.
    """

    faults: list[Fault]
    left: Array
    drift: float


class System(NamedTuple):
    """Derivatives (P, m, k) and residuals (P, m), free of errors of poses, and what frees others of them."""

    J: Array
    r: Array
    left: Array
    drift: float
    white: Callable[[Array], Array]

    def solve(self, chosen: list[int]) -> tuple[Array, Array, float]:
        """Return the step of parameters, their standard deviations, robust over time, and the gain."""
        J = self.J[..., chosen]
        inverse = np.linalg.pinv(np.einsum("pni,pnj->ij", J, J), rcond=1e-12)
        total = np.einsum("pni,pn->i", J, self.r)
        step = -inverse @ total
        scores, variance = np.einsum("pni,pn->pi", J, self.r + J @ step), np.diag(inverse)
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
        self.pictures, self.along, frames = pictures, float(along), pictures.frames
        pairs = np.concatenate([pictures.pairs, pictures.pairs[:, ::-1]])
        self.pairs = pairs[np.argsort(frames[pairs].sum(axis=1), kind="stable")]
        self.a, self.b = self.pairs.T[:, :, None]
        height, width = pictures.depth.shape[1:]
        random, shape = np.random.default_rng(1), (len(self.pairs), _POINTS)
        rows, columns = random.integers(2, height - 2, shape), random.integers(2, width - 2, shape)
        self.u, self.v = columns + 0.5, rows + 0.5
        known = pictures.depth > 0
        inverse = np.where(known, 1 / np.where(known, pictures.depth, 1), 0).astype(np.float32)
        smooth = np.stack([_smooth(*both) for both in zip(inverse, known, strict=True)])
        self.inverse = np.where(smooth, inverse, np.float32(np.nan)).reshape(-1, width)
        near = np.stack([cv2.GaussianBlur(each, (0, 0), _SOFT) for each in inverse * smooth])
        share = np.stack([cv2.GaussianBlur(np.float32(each), (0, 0), _SOFT) for each in smooth])
        self.soft = np.where(smooth, near / np.maximum(share, 1e-6), np.float32(np.nan)).reshape(-1, width)
        self.stored = (pictures.depth * smooth)[self.a, rows, columns].astype(np.float64)
        self.median = float(np.median(pictures.depth[known]))
        self.R, self.t = moves(R[frames], t[frames], self.pairs)
        self.into_b = R[frames][self.pairs[:, 1]].swapaxes(1, 2)
        before, after = np.maximum(np.arange(len(R)) - 1, 0), np.minimum(np.arange(len(R)) + 1, len(R) - 1)
        spans = np.maximum(after - before, 1)[:, None]
        turns = Rotation.from_matrix(R[before].swapaxes(1, 2) @ R[after]).as_rotvec() / spans
        steps = np.einsum("nji,nj->ni", R, t[after] - t[before]) / spans
        self.turns, self.steps = turns[frames], steps[frames]
        is_video = np.median(np.linalg.norm(turns, axis=1)) < _MOST_TURN
        possible = _OF_PANORAMA if pictures.panorama else range(len(PARAMETERS))
        self.possible = [i for i in possible if is_video or i not in (TIME, ROLLING)]
        first, second = frames[self.pairs].T
        C = np.minimum.outer(np.arange(len(R)), np.arange(len(R)))  # of errors that add up
        self.alike = C[second][:, second] - C[second][:, first] - C[first][:, second] + C[first][:, first]

    def residuals(self, theta: Array, pose: Array | None = None, soft: bool = True) -> Array:
        """Return (P, n) log of observed over expected depth; NaN where none is compared.

        ``pose`` is (6,) a turn and a move, of which second cameras are off, world axes; ``soft`` is for
        derivatives, which noise of depth would swamp.
        """
        a, b, height = self.a, self.b, self.pictures.depth.shape[1]
        scale, offset, kind = np.exp(theta[SCALE]), theta[OFFSET] * self.median, self.along + theta[RAY]
        rays = self._rays(theta)
        p = rays * ((self.stored * scale + offset) / np.linalg.norm(rays, axis=-1) ** kind)[..., None]
        if is_late := bool(theta[TIME] or theta[ROLLING]):
            tau = (theta[TIME] + theta[ROLLING] * (self.v / height - 0.5))[..., None]
            p = _turned(tau * self.turns[a], p) + tau * self.steps[a]
        q = p @ self.R.swapaxes(1, 2) + self.t[:, None]
        tau = np.full((*self.v.shape, 1), theta[TIME])
        for _ in range(3 if theta[ROLLING] else 1):
            there = _turned(-tau * self.turns[b], q - tau * self.steps[b]) if is_late else q
            if pose is not None:
                turn, move = self.into_b @ pose[:3], self.into_b @ pose[3:]
                there = there + np.cross(turn[:, None], there) + move[:, None]
            u, v, expected = self._projected(there, theta, kind)
            tau = (theta[TIME] + theta[ROLLING] * (v / height - 0.5))[..., None]
        width = self.pictures.depth.shape[2]
        seen = (self.stored > 0) & (u > 1.5) & (v > 1.5) & (u < width - 1.5) & (v < height - 1.5)
        at = np.where(seen, b * height + v - 0.5, 0), np.where(seen, u - 0.5, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            off = -np.log(
                map_coordinates(self.soft if soft else self.inverse, at, order=1)
                * (expected - offset)
                / scale
            )
        return np.where(seen & np.isfinite(off), off, np.nan)

    def _lens(self, theta: Array, frame: Any) -> tuple[Array, Array, Array, Array]:
        fx, fy, cx, cy = np.moveaxis(self.pictures.lenses[frame], -1, 0)
        longer, wider = np.exp(theta[FOCAL]), np.exp(theta[ASPECT] / 2)
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
            u, v = (0.5 + np.arctan2(x, z) / (2 * np.pi)) * width, (0.5 + np.arcsin(y / far) / np.pi) * height
            return u, v, far
        ahead = np.where(z > 1e-6, z, np.nan)
        x, y = x / ahead, y / ahead
        square = x * x + y * y
        bent = 1 + theta[K1] * square
        fx, fy, cx, cy = self._lens(theta, self.b)
        return x * bent * fx + cx, y * bent * fy + cy, ahead * (1 + square) ** (kind / 2)

    def derivatives(self, theta: Array, chosen: list[int]) -> Array:
        """Return (P, n, k) those of residuals by parameters."""
        steps = np.diag(_STEPS)[chosen]
        ends = [self.residuals(theta + step) - self.residuals(theta - step) for step in steps]
        return np.asarray(np.stack(ends, axis=-1) / (2 * _STEPS[chosen]))

    def system(self, theta: Array) -> System | None:
        """Return the equations of all parameters at ``theta``; None where too few points are compared."""
        off, unit = self.residuals(theta, soft=False), np.diag([1.0] * 3 + [self.median] * 3)
        step = 1e-3  # of poses
        ends = [self.residuals(theta, step * pose) - self.residuals(theta, -step * pose) for pose in unit]
        poses = np.stack(ends, axis=-1) / (2 * step)
        J = np.concatenate([poses, self.derivatives(theta, self.possible)], axis=-1)
        known = np.isfinite(J).all(axis=-1) & (np.abs(off) < _FAR_OFF)
        if known.sum() < _LEAST_POINTS:
            return None
        edges = (np.abs(J) > 6 * np.quantile(np.abs(J[known]), 0.95, axis=0) + 1e-12).any(axis=-1)
        root = np.sqrt(np.where(known & ~edges, _tukey(off, self._spread(off, known)), 0))[..., None]
        Q, T = np.linalg.qr(root * np.nan_to_num(J))
        Q = root * Q  # what tells poses and parameters; the rest of residuals does not matter
        X = np.concatenate([T[..., 6:], Q.swapaxes(1, 2) @ np.nan_to_num(off)[..., None]], axis=-1)
        blocks = np.array_split(np.arange(len(Q)), -(-len(Q) // _TOGETHER))

        def free(factors: list[Array], x: Array) -> Array:
            both = zip(factors, blocks, strict=True)
            of_poses = np.concatenate([F @ x[block, :6].reshape(len(F), -1) for F, block in both])
            return np.concatenate([of_poses.reshape(len(x), 6, -1), x[:, 6:]], axis=1)

        best = np.inf
        for share in _POSE_NOISE:
            factors = []
            for block in blocks:
                F = share * T[block, :6, :6].reshape(-1, 6)
                of_pairs = np.kron(self.alike[np.ix_(block, block)], np.ones((6, 6)))
                factors.append(dtrtri(cholesky(np.eye(len(F)) + F @ F.T * of_pairs, lower=True), lower=1)[0])
            Z = free(factors, X).reshape(-1, X.shape[2])
            H = Z.T @ Z
            rest = H[-1, -1] - H[-1, :-1] @ np.linalg.pinv(H[:-1, :-1], rcond=1e-12) @ H[:-1, -1]
            noise = max(1.0, rest / (len(Z) - len(H) + 1))  # of points that are alike
            cost = rest / noise + len(Z) * np.log(noise) - 2 * sum(np.log(np.diag(F)).sum() for F in factors)
            cost += np.linalg.slogdet(H[:-1, :-1] / noise + np.diag(_LIKELY[self.possible] ** -2.0))[1]
            if cost < best:
                best, drift, scale, by = cost, share * noise**0.5, noise**-0.5, factors

        def white(values: Array) -> Array:
            return np.asarray(scale * free(by, Q.swapaxes(1, 2) @ np.nan_to_num(values)))

        X = scale * free(by, X)
        return System(X[..., :-1], X[..., -1], off, float(drift), white)

    def _spread(self, off: Array, known: NDArray[np.bool_]) -> Array:
        """Return (P, n) the noise of log depth, by depth."""
        bounds = np.quantile(self.stored[known], np.linspace(0, 1, 7))
        of_point = np.clip(np.searchsorted(bounds, self.stored) - 1, 0, 5)
        spreads = [np.abs(off[known & (of_point == i)]) for i in range(6)]
        noise = np.array([1.4826 * np.median(s) + 2e-5 if s.size else 1.0 for s in spreads])
        return np.asarray(noise[of_point])

    def _settled(self, theta: Array, chosen: list[int], system: System) -> tuple[Array, System | None]:
        """Return parameters with those of ``chosen`` fitted, and the equations there."""

        def at(x: Array) -> Array:
            moved = theta.copy()
            moved[chosen] = x
            return moved

        def left(x: Array) -> Array:
            return white(np.clip(self.residuals(at(x), soft=False), -_FAR_OFF, _FAR_OFF)[..., None]).ravel()

        def slopes(x: Array) -> Array:
            return white(self.derivatives(at(x), chosen)).reshape(-1, len(chosen))

        after = system
        for _ in range(_ROUNDS):
            white = after.white
            fit = least_squares(
                left, theta[chosen], slopes, method="lm", x_scale=_STEPS[chosen], max_nfev=_EVALUATIONS
            )
            is_settled = (np.abs(fit.x - theta[chosen]) < 0.1 * _MATTERS[chosen]).all()
            theta = at(fit.x)
            if (again := self.system(theta)) is None:
                return theta, None
            after = again
            if is_settled:
                break
        return theta, after

    def _gains(self, system: System, chosen: list[int], refused: set[int]) -> list[tuple[float, int]]:
        """Return what parameters that may be off would gain beside those chosen, the least first."""
        gains, at = [], [self.possible.index(c) for c in chosen]
        known = system.solve(at)[2] if at else 0.0
        for i, c in enumerate(self.possible):
            if c not in (*chosen, *refused):
                step, sigma, gain = system.solve([*at, i])
                if abs(step[-1]) > max(0.5 * _MATTERS[c], _LIKELY_SIGMA * sigma[-1]):
                    gains.append((gain - known, c))
        return sorted(gains)

    def find(self) -> Found:
        """Return what is off beyond doubt, the greatest gain first."""
        theta, chosen, refused, others = np.zeros(len(PARAMETERS)), list[int](), set[int](), list[list[int]]()
        if (system := self.system(theta)) is None:
            return Found([], np.full((1, 1), np.nan), 0.0)
        sigmas = np.zeros(0)
        while len(chosen) < _MOST_FAULTS and (gains := self._gains(system, chosen, refused)):
            *less, (most, c) = gains
            trial = [*chosen, c]
            fitted, after = self._settled(theta, trial, system)
            of_trial = (
                after.solve([self.possible.index(c) for c in trial])[1] if after else np.full(1, np.inf)
            )
            if after and (np.abs(fitted[trial]) > np.maximum(_SIGMA * of_trial, _MATTERS[trial])).all():
                others.append([i for gain, i in less if gain > _AS_WELL * most])
                theta, system, chosen, sigmas = fitted, after, trial, of_trial
            else:
                refused.add(c)
        noise = 1.4826 * float(np.nanmedian(np.abs(system.left)))
        model = np.hypot((_INEXACT + _PER_NOISE * noise) * theta[chosen], _OF_MATTERS * _MATTERS[chosen])
        rows = zip(chosen, np.hypot(sigmas, model).tolist(), others, strict=True)
        faults = [
            Fault(PARAMETERS[c], float(theta[c]), doubt, tuple(PARAMETERS[i] for i in also))
            for c, doubt, also in rows
        ]
        return Found(faults, system.left, system.drift)


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
