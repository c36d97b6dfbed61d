"""Faults of posed pictures within their convention, with their sizes: a robust fit to pairs that overlap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
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
        most: of one step of the fit.
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
    Parameter("centre, x", 0.2, 0.12, 4, "px"),
    Parameter("centre, y", 0.2, 0.12, 4, "px"),
    Parameter("radial distortion k1", 4e-3, 4e-3, 0.1, ""),
    Parameter("planar depth, towards along the ray", 0.03, 0.08, 0.5, "of 1"),
    Parameter("time of pictures after poses", 0.05, 0.06, 0.5, "frames"),
    Parameter("rolling shutter, top to bottom", 0.05, 0.1, 0.5, "frames"),
    Parameter("offset of depth", 2e-3, 2e-3, 0.1, "of its median"),
    Parameter("focal length of colours", 4e-3, 4e-3, 0.1, "%", 100),
    Parameter("colours, x", 0.25, 1.0, 4, "px"),
    Parameter("colours, y", 0.25, 1.0, 4, "px"),
)
SCALE, FOCAL, ASPECT, CX, CY, K1, RAY, TIME, ROLLING, OFFSET, COLOR, COLOR_X, COLOR_Y = range(13)
OF_COLOR = (COLOR, COLOR_X, COLOR_Y)
OF_PANORAMA = (SCALE, TIME, OFFSET, COLOR_X, COLOR_Y)
_TURN, _MOVE = 1e-3, 1e-3  # of poses, for derivatives: radians, and a share of the median depth

_POINTS = 400  # of a pair, each way
_SMOOTH = 0.012  # second difference of inverse depth of surfaces that are compared, relative
_FAR_OFF = 0.2  # log depth of another surface
_TUKEY, _SIGMA = 4.7, 5.0
_BLOCKS = (16, 8, 4)  # of time, over which errors of pairs are alike
_RELATED = 4.0  # points of a pair count as a quarter of independent ones
_MOST_FAULTS, _ROUNDS, _LEAST_POINTS, _LEAST_OF_PAIR = 5, 6, 200, 30
_INEXACT, _INEXACT_COLOR, _OF_MATTERS = 0.02, 0.1, 0.05  # shares of sizes that the fit's model is off by
_PER_NOISE = 20.0  # more of a size, for each of the noise of log depth, which weakens derivatives
_AS_WELL = 0.75  # of the gain, by which another parameter explains the same
_POSE_NOISE = (1e-5, 1e-4, 3e-4, 1e-3, 2e-3, 4e-3, 8e-3, 0.02)  # radians, and shares of the median depth
_MOST_TURN = np.radians(25)  # from frame to frame, of a video


class Fault(NamedTuple):
    """A parameter that is off, by how much, with its standard deviation, and what explains the same."""

    parameter: int
    size: float
    sigma: float
    others: tuple[int, ...] = ()


@dataclass
class Normal:
    """Normal equations by pair (P, n, n) and (P, n), poses of pairs marginalized, and residuals."""

    matrix: Array
    right: Array
    pose: Array
    depth: Array

    def solve(self, chosen: list[int], at: Array) -> tuple[Array, Array, float]:
        """Return the step, its standard deviations, robust over blocks of time, and the gain.

        ``at`` is (P,) where in time pairs are, 0 to 1.
        """
        H, g = self.matrix[:, chosen][:, :, chosen], self.right[:, chosen]
        inverse = np.linalg.pinv(H.sum(axis=0), rcond=1e-12)
        total = g.sum(axis=0)
        step = -inverse @ total
        scores = g + H @ step
        variance = _RELATED * np.diag(inverse)
        for count in _BLOCKS:  # of several lengths: the drift of poses lasts longer than some
            block = (at * count).astype(int)
            of_block = np.stack([scores[block == i].sum(axis=0) for i in np.unique(block)])
            more = len(of_block) / max(1, len(of_block) - 1)
            robust = np.diag(inverse @ (more * of_block.T @ of_block) @ inverse)
            variance = np.maximum(variance, robust + _RELATED * np.diag(inverse))
        halves = [np.linalg.pinv(H[half].sum(axis=0)) @ g[half].sum(axis=0) for half in (at < 0.5, at >= 0.5)]
        variance = np.maximum(variance, ((halves[0] - halves[1]) / 2) ** 2)
        return step, np.sqrt(np.maximum(variance, 1e-18)), float(total @ inverse @ total)


class Fit:
    """Fits parameters to pictures.

    Args:
        pictures: with pairs.
        R, t: (N, 3, 3), (N, 3) poses of frames, in the unit of depth.
        along: whether depth is along the ray.
    """

    def __init__(self, pictures: PosedPictures, R: Array, t: Array, along: bool) -> None:
        self.pictures, self.along = pictures, float(along)
        frames = pictures.frames
        self.pairs = np.concatenate([pictures.pairs, pictures.pairs[:, ::-1]])
        self.a, self.b = self.pairs.T[:, :, None]
        height, width = pictures.depth.shape[1:]
        random = np.random.default_rng(1)
        shape = len(self.pairs), _POINTS
        rows, columns = random.integers(2, height - 2, shape), random.integers(2, width - 2, shape)
        self.u, self.v = columns + 0.5, rows + 0.5
        known = pictures.depth > 0
        inverse = np.where(known, 1 / np.where(known, pictures.depth, 1), 0).astype(np.float32)
        smooth = np.stack([_smooth(*both) for both in zip(inverse, known, strict=True)])
        self.inverse = np.where(smooth, inverse, np.float32(np.nan))
        self.stored = (pictures.depth * smooth)[self.a, rows, columns].astype(np.float64)
        self.median = float(np.median(pictures.depth[known]))
        motion = moves(R[frames], t[frames], self.pairs)
        self.R, self.t = motion[..., :3], motion[..., 3]
        before, after = np.maximum(np.arange(len(R)) - 1, 0), np.minimum(np.arange(len(R)) + 1, len(R) - 1)
        spans = np.maximum(after - before, 1)[:, None]
        turns = Rotation.from_matrix(R[before].swapaxes(1, 2) @ R[after]).as_rotvec() / spans
        steps = np.einsum("nji,nj->ni", R, t[after] - t[before]) / spans
        self.is_video = bool(np.median(np.linalg.norm(turns, axis=1)) < _MOST_TURN)
        self.turns, self.steps = turns[frames], steps[frames]
        self.at = frames[self.pairs[:, 0]] / len(R)

    def residuals(self, theta: Array, pose: Array | None = None, grey: bool = True) -> tuple[Array, Array]:
        """Return (P, n) log of observed over expected depth, and the difference of grey; NaN where none."""
        pictures, a, b = self.pictures, self.a, self.b
        height = pictures.depth.shape[1]
        scale, offset, kind = np.exp(theta[SCALE]), theta[OFFSET] * self.median, self.along + theta[RAY]
        rays = self._rays(theta)
        away = np.linalg.norm(rays, axis=-1) ** kind
        p = rays * ((self.stored * scale + offset) / away)[..., None]
        rolls = theta[TIME] or theta[ROLLING]
        if rolls:
            tau = (theta[TIME] + theta[ROLLING] * (self.v / height - 0.5))[..., None]
            p = _turned(tau * self.turns[a], p) + tau * self.steps[a]
        q = p @ self.R.swapaxes(1, 2) + self.t[:, None]
        tau_b: Any = np.full((*self.v.shape, 1), theta[TIME])
        for _ in range(3 if theta[ROLLING] else 1):
            there = _turned(-tau_b * self.turns[b], q - tau_b * self.steps[b]) if rolls else q
            if pose is not None:
                there = there + np.cross(pose[:3], there) + pose[3:]
            u, v, expected = self._projected(there, theta, kind)
            tau_b = (theta[TIME] + theta[ROLLING] * (v / height - 0.5))[..., None]
        seen = self._inside(u, v) & (self.stored > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            off = -np.log(self._sample(self.inverse, b, u, v) * (expected - offset) / scale)
        off = np.where(seen & np.isfinite(off), off, np.nan)
        if pictures.grey is None or not grey:
            return off, np.full_like(off, np.nan)
        here, beside = self._of_color(self.u, self.v, theta, a), self._of_color(u, v, theta, b)
        inside = self._inside(*here) & self._inside(*beside) & (np.abs(off) < _FAR_OFF)
        differences = self._sample(pictures.grey, b, *beside) - self._sample(pictures.grey, a, *here)
        return off, np.where(inside, differences, np.nan)

    def _lens(self, theta: Array, frame: Any) -> tuple[Array, Array, Array, Array]:
        fx, fy, cx, cy = np.moveaxis(self.pictures.lenses[frame], -1, 0)
        longer, wider = np.exp(theta[FOCAL]), np.exp(theta[ASPECT] / 2)
        return fx * longer * wider, fy * longer / wider, cx + theta[CX], cy + theta[CY]

    def _rays(self, theta: Array) -> Array:
        if self.pictures.panorama:
            return self.pictures.rays(self.pairs[:, 0], self.u, self.v)
        fx, fy, cx, cy = self._lens(theta, self.a)
        x0, y0 = (self.u - cx) / fx, (self.v - cy) / fy
        x, y = x0, y0
        for _ in range(4 if theta[K1] else 0):
            bent = 1 + theta[K1] * (x * x + y * y)
            x, y = x0 / bent, y0 / bent
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def _projected(self, p: Array, theta: Array, kind: float) -> tuple[Array, Array, Array]:
        """Return pixels and the depth that is expected there."""
        height, width = self.pictures.depth.shape[1:]
        x, y, z = np.moveaxis(p, -1, 0)
        if self.pictures.panorama:
            far = np.linalg.norm(p, axis=-1)
            return (
                (0.5 + np.arctan2(x, z) / (2 * np.pi)) * width,
                (0.5 + np.arcsin(y / far) / np.pi) * height,
                far,
            )
        ahead = np.where(z > 1e-6, z, np.nan)
        x, y = x / ahead, y / ahead
        square = x * x + y * y
        bent = 1 + theta[K1] * square
        fx, fy, cx, cy = self._lens(theta, self.b)
        return x * bent * fx + cx, y * bent * fy + cy, ahead * (1 + square) ** (kind / 2)

    def _of_color(self, u: Any, v: Any, theta: Array, frame: Any) -> tuple[Array, Array]:
        _, _, cx, cy = self._lens(theta, frame)
        larger = np.exp(theta[COLOR])
        return (u - cx) * larger + cx + theta[COLOR_X], (v - cy) * larger + cy + theta[COLOR_Y]

    def _inside(self, u: Array, v: Array) -> NDArray[np.bool_]:
        height, width = self.pictures.depth.shape[1:]
        return np.asarray((u > 1.5) & (v > 1.5) & (u < width - 1.5) & (v < height - 1.5))

    @staticmethod
    def _sample(stack: NDArray[Any], frame: Any, u: Array, v: Array) -> Array:
        """Return bilinear values inside pictures; NaN where one of the four pixels is NaN."""
        height, width = stack.shape[1:]
        x, y = np.nan_to_num(u) - 0.5, np.nan_to_num(v) - 0.5
        left = np.clip(x, 0, width - 2).astype(np.int64)
        top = np.clip(y, 0, height - 2).astype(np.int64)
        x, y = x - left, y - top
        upper = (1 - x) * stack[frame, top, left] + x * stack[frame, top, left + 1]
        lower = (1 - x) * stack[frame, top + 1, left] + x * stack[frame, top + 1, left + 1]
        return np.asarray((1 - y) * upper + y * lower)

    def normal(self, theta: Array, candidates: list[int], use_depth: bool, use_grey: bool) -> Normal | None:
        """Return the normal equations of parameters at ``theta``; None where too few points are compared."""
        depth, grey = self.residuals(theta, grey=use_grey)
        known = np.abs(depth) < _FAR_OFF
        if known.sum() < _LEAST_POINTS:
            return None
        sigma = self._spread(depth, known)
        weights = [_tukey(depth, sigma)] if use_depth else []
        if use_grey:
            near = np.isfinite(grey) & (np.abs(depth) < 5 * sigma + 0.01)
            if near.sum() < _LEAST_POINTS:
                return None
            weights.append(
                _tukey(np.where(near, grey, np.nan), 1.4826 * np.median(np.abs(grey[near])) + 1e-3)
            )
        of = [values for values, used in ((depth, use_depth), (grey, use_grey)) if used]
        columns = [self._derivative(theta, PARAMETERS[i].step, use_depth, use_grey, i) for i in candidates]
        sizes = [_TURN] * 3 + [_MOVE * self.median] * 3
        columns += [
            self._derivative(theta, size, use_depth, use_grey, -1 - i) for i, size in enumerate(sizes)
        ]
        J, r, w = np.stack(columns, axis=-1), np.concatenate(of, axis=1), np.concatenate(weights, axis=1)
        w = np.where(np.isfinite(J).all(axis=-1) & np.isfinite(r), w, 0)
        J, r = np.nan_to_num(J), np.nan_to_num(r)
        used = w > 0
        steep = 6 * np.quantile(np.abs(J[used]), 0.95, axis=0) + 1e-12 if used.any() else np.inf
        w = np.where((np.abs(J) > steep).any(axis=-1), 0, w)  # at the edges of pictures
        return self._marginalized(J, r, w, len(candidates), depth)

    def _derivative(self, theta: Array, step: float, use_depth: bool, use_grey: bool, i: int) -> Array:
        """Return the derivative of the residuals by a parameter; of poses by -1 to -6."""
        ends = []
        for sign in (1, -1):
            moved, pose = theta.copy(), None
            if i >= 0:
                moved[i] += sign * step
            else:
                pose = np.zeros(6)
                pose[-1 - i] = sign * step
            depth, grey = self.residuals(moved, pose, use_grey)
            ends.append(np.concatenate([depth] * use_depth + [grey] * use_grey, axis=1))
        return np.asarray((ends[0] - ends[1]) / (2 * step))

    def _spread(self, off: Array, known: NDArray[np.bool_]) -> Array:
        """Return (P, n) the noise of log depth, by depth."""
        bounds = np.quantile(self.stored[known], np.linspace(0, 1, 7))
        of_point = np.clip(np.searchsorted(bounds, self.stored) - 1, 0, 5)
        spreads = [np.abs(off[known & (of_point == i)]) for i in range(6)]
        noise = np.array([1.4826 * np.median(s) + 2e-5 if s.size else 1.0 for s in spreads])
        return np.asarray(noise[of_point])

    def _marginalized(self, J: Array, r: Array, w: Array, count: int, depth: Array) -> Normal:
        enough = (w > 0).sum(axis=1) >= _LEAST_OF_PAIR
        J, r, w = J[enough], r[enough], w[enough]
        H = np.einsum("pni,pn,pnj->pij", J, w, J, optimize=True)
        g = np.einsum("pni,pn,pn->pi", J, w, r, optimize=True)
        pose = slice(count, None)
        Hq, gq = H[:, pose, pose] / _RELATED, g[:, pose] / _RELATED
        best, sigma = -np.inf, np.ones(6)
        for share in _POSE_NOISE:  # the noise of poses that is most likely
            trial = share * np.array([1.0] * 3 + [self.median] * 3)
            A = Hq + np.diag(trial**-2)
            fit = (gq * np.linalg.solve(A, gq[..., None])[..., 0]).sum()
            likely = fit - np.linalg.slogdet(A)[1].sum() - 2 * len(Hq) * np.log(trial).sum()
            if likely > best:
                best, sigma = likely, trial
        right = np.concatenate([H[:, pose, :count], g[:, pose, None]], axis=-1)
        X = np.linalg.solve(H[:, pose, pose] + np.diag(_RELATED * sigma**-2), right)
        matrix, total = np.zeros((len(enough), count, count)), np.zeros((len(enough), count))
        matrix[enough] = H[:, :count, :count] - H[:, :count, pose] @ X[..., :-1]
        total[enough] = g[:, :count] - np.einsum("pij,pj->pi", H[:, :count, pose], X[..., -1])
        return Normal(matrix, total, sigma, depth)

    def faults(
        self, theta: Array, candidates: list[int], use_depth: bool, use_grey: bool
    ) -> tuple[list[Fault], Array, Normal | None]:
        """Return what is off beyond doubt, the greatest gain first, with all parameters and equations.

        Args:
            theta: (13,) to begin with; those of ``candidates`` that are not 0 are among the faults.
            candidates: parameters.
            use_depth, use_grey: whether depth, and the brightness of colours are compared.
        """
        theta, others, refused = theta.copy(), dict[int, tuple[int, ...]](), set[int]()
        chosen = [c for c in candidates if theta[c]]

        def settle(trial: list[int]) -> bool:
            """Fit some of the candidates; return whether all are beyond doubt."""
            for _ in range(_ROUNDS):
                if (normal := self.normal(theta, trial, use_depth, use_grey)) is None:
                    return False
                step, sigma, _ = normal.solve([*range(len(trial))], self.at)
                most = np.array([PARAMETERS[i].most for i in trial])
                theta[trial] += np.clip(step, -most, most)
                if (np.abs(step) < 0.1 * sigma).all():
                    break
            return all(self._is_firm(theta[i], s, i) for i, s in zip(trial, sigma, strict=True))

        if chosen and not settle(chosen):
            theta[chosen], chosen = 0, []
        while (normal := self.normal(theta, candidates, use_depth, use_grey)) and len(chosen) < _MOST_FAULTS:
            at = [candidates.index(c) for c in chosen]
            gains = []
            for c in (c for c in candidates if c not in chosen and c not in refused):
                step, sigma, gain = normal.solve([*at, candidates.index(c)], self.at)
                matters = abs(step[-1]) > 0.5 * PARAMETERS[c].matters
                if matters and abs(step[-1]) > 0.6 * _SIGMA * sigma[-1]:
                    gains.append((gain - (normal.solve(at, self.at)[2] if at else 0), c))
            if not gains:
                break
            most, c = max(gains)
            before = theta.copy()
            if settle([*chosen, c]):
                others[c] = tuple(i for gain, i in gains if i != c and gain > _AS_WELL * most)
                chosen.append(c)
            else:
                theta = before
                refused.add(c)
        if not chosen or normal is None:
            return [], theta, normal
        faults, noise = [], 1.4826 * float(np.nanmedian(np.abs(normal.depth)))
        sigmas = normal.solve([candidates.index(c) for c in chosen], self.at)[1]
        for c, sigma in zip(chosen, sigmas.tolist(), strict=True):
            model = (_INEXACT_COLOR if c in OF_COLOR else _INEXACT + _PER_NOISE * noise) * theta[c]
            doubt = float(np.hypot(np.hypot(sigma, model), _OF_MATTERS * PARAMETERS[c].matters))
            faults.append(Fault(c, float(theta[c]), doubt, others.get(c, ())))
        return faults, theta, normal

    def color_cost(self, theta: Array) -> float:
        """Return the mean difference of grey, no difference above 1."""
        grey = self.residuals(theta)[1]
        grey = grey[np.isfinite(grey)]
        return float(np.minimum(np.abs(grey), 1).mean()) if grey.size > _LEAST_POINTS else 9.0

    @staticmethod
    def _is_firm(size: float, sigma: float, parameter: int) -> bool:
        return abs(size) > max(_SIGMA * sigma, PARAMETERS[parameter].matters)


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
    """Return points (..., 3) turned by rotation vectors (..., 3)."""
    angle = np.linalg.norm(w, axis=-1, keepdims=True)
    across = np.cross(w, p)
    half = np.sinc(angle / (2 * np.pi))
    return np.asarray(p + np.sinc(angle / np.pi) * across + 0.5 * half**2 * np.cross(w, across))
