"""Pictures with poses in memory, and how well a motion explains pairs of them that overlap."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry import Array, pinhole

Indices = NDArray[np.int64]

_BINS = 96  # of log depth, for the agreement that chance gives
_FEW = 6  # pairs that are looked at both ways
_GAPS = (1, 2, 3, 4, 6, 8, 12, 16, 24)  # frames between those of a pair
# How far a pair turns, shares of the field of view:
_OVERLAPS = 0.45  # at most
_TURNED = 0.25  # enough
_MOST_FOV = 2.0  # radians; of a wider picture, no more counts
_BESIDE = 24  # pairs of a gap that are looked at
_LEAST_AGREE = 9  # points whose grey is compared
_MIDDLE = 100.0  # grey level to which the median of a picture is scaled
_LEAST_SD = 6.0  # grey levels that are noise then


@dataclass(frozen=True)
class PosedPictures:
    """Depth and colours of one size, and the poses of all frames, read or not."""

    depth: NDArray[np.float32]  # (M, H, W), 0 for no surface; as stored, planar or along the ray
    grey: NDArray[np.float32] | None  # (M, H, W), brightness without its local mean and contrast
    lenses: Array  # (M, 4) fx, fy, cx, cy; px of this size
    frames: Indices  # (M,) whose pictures these are
    pairs: Indices  # (P, 2) pictures that overlap if poses are right
    R: Array  # (N, 3, 3) rotations of frames as said, camera to world
    t: Array  # (N, 3) positions as said
    panorama: bool = False  # whether pictures are equirectangular
    _points: dict[int, Array] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def read(
        cls, R: Array, t: Array, read: Callable[[int, int], Shot | None], fov: float, pairs: int, width: int
    ) -> PosedPictures | None:
        """Return the pictures of pairs of frames that are likely to overlap; None where there are none.

        Args:
            R: (N, 3, 3) rotations of all frames, in their order.
            t: (N, 3) positions of them.
            read: returns a frame's picture of at most so many px width; None if it cannot be read.
            fov: field of view of pictures, radians.
            pairs: so many at most.
            width: of pictures, px, at most.
        """
        chosen = choose_pairs(R, t, fov, pairs)
        shots: dict[int, Shot] = {}  # by frame
        for frame in np.unique(chosen).tolist():
            shot = read(frame, width)
            if shot is not None:
                shots[frame] = shot
        shots = _of_one_size(shots)
        overlapping = _known_pairs(chosen, list(shots))
        if not overlapping:
            return None
        depths = []
        greys = []  # of those that have colours
        lenses = []
        for shot in shots.values():
            depths.append(shot.depth)
            if shot.grey is not None:
                greys.append(shot.grey)
            lenses.append(shot.lens or (1, 1, 0, 0))
        return cls(
            depth=np.stack(depths),
            grey=np.stack(greys) if len(greys) == len(shots) else None,
            lenses=np.array(lenses, np.float64),
            frames=np.array(list(shots)),
            pairs=np.array(overlapping),
            R=R,
            t=t,
            panorama=next(iter(shots.values())).lens is None,
        )

    def agreements(
        self, R: Array, t: Array, how: tuple[int, float, bool], warp: tuple[float, ...] = (1, 1, 0, 0)
    ) -> Array:
        """Return (P, 2) of pairs the agreement of depth, and the correlation of grey where it agrees.

        Args:
            R: (P, 3, 3) rotations from first to second pictures, by :func:`moves`.
            t: (P, 3) translations likewise.
            how: points of a pair, the tolerance of log depth, and whether depth is along the ray.
            warp: scale across and down about the middle, and px across and down, of colours beside depth.
        """
        count, *flags = how
        if count not in self._points:
            height, width = self.depth.shape[1:]
            first = self.pairs[:, :1]
            random = np.random.default_rng(count)
            shape = (len(first), count)
            v = random.integers(2, height - 2, shape)
            u = random.integers(2, width - 2, shape)
            values = np.stack([self.depth[first, v, u], u + 0.5, v + 0.5], axis=-1)
            self._points[count] = np.concatenate([self.rays(first[:, 0], u + 0.5, v + 0.5), values], axis=-1)
        grey = self.depth if self.grey is None else self.grey
        pictures = (self.lenses, self.depth, grey)
        motion = np.concatenate([R, t[..., None]], axis=-1)
        kernel_how = (self.panorama, *map(float, (*flags, *warp)))
        result = np.zeros((len(self.pairs), 2))
        agreement(self._points[count], motion, self.pairs, *pictures, kernel_how, result)
        return result

    def rays(self, pictures: Indices, u: NDArray[Any], v: NDArray[Any]) -> Array:
        """Return unit rays (P, n, 3), camera frame, of pixels ``u``, ``v`` (P, n) of ``pictures`` (P,)."""
        if self.panorama:
            height, width = self.depth.shape[1:]
            theta = (2 * u / width - 1) * np.pi
            phi = (0.5 - v / height) * np.pi
            return np.stack([np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)], axis=-1)
        rays = np.zeros((*u.shape, 3))
        pixels = np.stack([u, v], axis=-1)
        for index, lens in enumerate(self.lenses[pictures].tolist()):
            rays[index] = pinhole.rays(pixels[index], pinhole.Projection(*lens))
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _known_pairs(chosen: Indices, frames: list[int]) -> list[list[int]]:
    """Return those of the pairs whose two frames are known, as indices of frames; few of them both ways.

    Args:
        chosen: (P, 2) pairs of frames.
        frames: the known ones.
    """
    index = {frame: picture for picture, frame in enumerate(frames)}
    pairs = []
    for first, second in chosen.tolist():
        if first in index and second in index:
            pairs.append([index[first], index[second]])
    if len(pairs) < _FEW:
        pairs += [pair[::-1] for pair in pairs]
    return pairs


def _of_one_size(shots: dict[int, Shot]) -> dict[int, Shot]:
    """Return the pictures of the most frequent size, by frame."""
    sizes = Counter(shot.depth.shape for shot in shots.values())
    if not sizes:
        return {}
    ((size, _),) = sizes.most_common(1)
    return {frame: shots[frame] for frame in shots if shots[frame].depth.shape == size}


class Shot(NamedTuple):
    """A picture in memory: depth (H, W), 0 for none; local contrast; fx, fy, cx, cy, or None: a panorama."""

    depth: NDArray[np.float32]
    grey: NDArray[np.float32] | None
    lens: tuple[float, float, float, float] | None

    @classmethod
    def of(cls, depth: NDArray[Any], lit: NDArray[Any] | None, lens: Any, most: int) -> Shot:
        """Return the shot of depth and colours, every k-th pixel of them, k odd.

        Args:
            depth: (H, W).
            lit: (H, W, 3) colours; of another size they are resized. None without.
            lens: with fx, fy, cx and cy of the depth's size; None for a panorama.
            most: px of the shot's width.
        """
        height, width = depth.shape
        step = max(1, -(-width // most)) | 1
        rows = height // step
        columns = width // step
        cut = depth[step // 2 : rows * step : step, step // 2 : columns * step : step]
        near = np.where(np.isfinite(cut) & (cut > 0), cut, 0)
        if lit is not None:
            lit = lit.astype(np.float32).mean(axis=-1)
            if lit.shape != depth.shape:
                lit = cv2.resize(lit, (width, height), interpolation=cv2.INTER_AREA)
            lit = cv2.resize(
                lit[: rows * step, : columns * step], (columns, rows), interpolation=cv2.INTER_AREA
            )
        small = lens and (lens.fx / step, lens.fy / step, lens.cx / step, lens.cy / step)
        return cls(np.asarray(near, np.float32), None if lit is None else local_contrast(lit), small)


def local_contrast(grey: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return brightness (H, W) of any unit without its local mean and contrast."""
    grey = np.minimum(grey * (_MIDDLE / max(float(np.median(grey)), 1e-9)), 10 * _MIDDLE)
    sigma = max(1.2, grey.shape[1] / 260)
    size = (int(31 * sigma) | 1,) * 2
    grey = cv2.GaussianBlur(grey, (0, 0), sigma)
    grey -= cv2.blur(grey, size)
    return np.asarray(grey / (np.sqrt(np.maximum(cv2.blur(grey * grey, size), 0)) + _LEAST_SD), np.float32)


def choose_pairs(R: Array, t: Array, fov: float, most: int) -> Indices:
    """Return (P, 2) pairs, so many (``most``) at most, of frames that turn and move, but see the same.

    Args:
        R: (N, 3, 3) rotations as said. Their convention may be wrong, which leaves angles between them.
        t: (N, 3) positions as said.
        fov: field of view, radians.
        most: pairs.
    """
    count = len(R)
    rows: list[Indices] = []
    for gap in range(1, count) if count <= _BESIDE else _GAPS:
        first = np.arange(0, count - gap, max(1, (count - gap) // _BESIDE))
        rows.append(np.stack([first, first + gap], axis=1))
    if not rows:
        return np.empty((0, 2), np.int64)
    pairs = np.concatenate(rows)
    a, b = pairs.T
    trace = np.einsum("nij,nij->n", R[a], R[b])
    angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    far = np.linalg.norm(t[a] - t[b], axis=1)
    wide = min(fov, _MOST_FOV)
    fit = angle < _OVERLAPS * wide
    if fit.sum() < min(4, len(pairs)):
        fit = np.argsort(np.argsort(angle, kind="stable")) < max(4, len(pairs) // 4)
    middle = np.median(far[fit]) + 1e-12
    gain = np.minimum(angle / (_TURNED * wide), 1) + np.minimum(far / (2 * middle), 1)
    best = np.sort(np.argsort(np.where(fit, -gain, np.inf), kind="stable")[: min(3 * most, int(fit.sum()))])
    chosen = np.unique(np.linspace(0, len(best) - 1, min(most, len(best))).astype(int))
    return np.asarray(pairs[best[chosen]])


def moves(R: Array, t: Array, pairs: Indices) -> tuple[Array, Array]:
    """Return rotations (P, 3, 3) and translations (P, 3) from the first camera of ``pairs`` to the second.

    ``R`` (N, 3, 3) and ``t`` (N, 3) are the poses of all pictures.
    """
    a, b = pairs.T
    return R[b].swapaxes(1, 2) @ R[a], np.einsum("pji,pj->pi", R[b], t[a] - t[b])


@njit(nogil=True)
def _pixel(grey: NDArray[np.float32], x: float, y: float) -> float:
    """Return the bilinear brightness at px from the first pixel's centre."""
    left, top = int(x), int(y)
    right, below = x - left, y - top
    upper = (1 - right) * grey[top, left] + right * grey[top, left + 1]
    lower = (1 - right) * grey[top + 1, left] + right * grey[top + 1, left + 1]
    return float((1 - below) * upper + below * lower)


@njit(
    "float64[:, :, ::1], float64[:, :, ::1], int64[:, ::1], float64[:, ::1], float32[:, :, ::1], "
    "float32[:, :, ::1], (bool, 6 * float64), out float64[:, ::1]",
    nogil=True,
    error_model="numpy",
)
def agreement(  # noqa: C901, PLR0912, PLR0915 - a kernel
    points: Array,
    motion: Array,
    pairs: Indices,
    lenses: Array,
    depth: NDArray[np.float32],
    grey: NDArray[np.float32],
    how: tuple[bool, float, float, float, float, float, float],
    result: Array,
) -> None:
    """Write (P, 2) of pairs the agreement of depth beyond chance, and the correlation of grey where it does.

    Both are 0 before. A point that another picture shows nearer may be hidden; one that it sees through
    contradicts.

    Args:
        points: (P, n, 6) of the first pictures: unit ray, depth, and pixel.
        motion: (P, 3, 4) from first to second cameras, lengths in units of depth.
        pairs: (P, 2) pictures.
        lenses, depth, grey: of all pictures.
        how: whether pictures are panoramas; the tolerance of log depth; 1 if depth is along the ray; the four
            numbers of ``warp``.
    """
    panorama, tolerance, along, across, down, right, below = how
    height, width = depth.shape[1:]
    middle, half = width / 2, height / 2
    right, below = right + middle - 0.5, below + half - 0.5
    for p in range(len(points)):
        (a, b), m = pairs[p], motion[p]
        fx, fy, cx, cy = lenses[b]
        expected_in, observed_in = np.zeros(_BINS), np.zeros(_BINS)
        agree = against = hidden = known = both = 0.0
        s1 = s2 = s11 = s22 = s12 = 0.0
        for i in range(points.shape[1]):
            x, y, z = points[p, i, 0], points[p, i, 1], points[p, i, 2]
            stored = points[p, i, 3]
            if stored <= 0 or (z <= 0 and not along):
                continue
            known += 1
            length = stored if along else stored / z
            x, y, z = x * length, y * length, z * length
            px = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
            py = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
            pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
            far = math.sqrt(px * px + py * py + pz * pz)
            if panorama:
                u = (0.5 + math.atan2(px, pz) / (2 * math.pi)) * width
                v = (0.5 + math.asin(py / far) / math.pi) * height
            else:
                if pz <= 1e-6:
                    continue
                u, v = px / pz * fx + cx, py / pz * fy + cy
            if not (u >= 1 and v >= 1 and u < width - 1 and v < height - 1):
                continue
            observed, expected = depth[b, int(v), int(u)], far if along else pz
            if observed <= 0:
                continue
            log_expected, log_observed = math.log(expected), math.log(observed)
            off = log_observed - log_expected
            if off <= -3 * tolerance:
                hidden += 1
                continue
            expected_in[int(log_expected / (2 * tolerance) + _BINS * 10) % _BINS] += 1
            observed_in[int(log_observed / (2 * tolerance) + _BINS * 10) % _BINS] += 1
            if abs(off) >= tolerance:
                against += 1
                continue
            agree += 1
            x, y = (points[p, i, 4] - middle) * across + right, (points[p, i, 5] - half) * down + below
            u, v = (u - middle) * across + right, (v - half) * down + below
            if min(x, y, u, v) >= 0 and max(x, u) < width - 1 and max(y, v) < height - 1:
                own, there, both = _pixel(grey[a], x, y), _pixel(grey[b], u, v), both + 1
                s1, s2, s11, s22, s12 = s1 + own, s2 + there, s11 + own**2, s22 + there**2, s12 + own * there
        compared = agree + against
        if compared == 0:
            continue
        chance = (expected_in * observed_in).sum() / compared**2
        base = max(compared + 0.3 * hidden, 0.12 * known)
        result[p, 0] = max((agree - chance * compared) / base / (1.08 - chance), -0.5)
        if both >= _LEAST_AGREE:
            spread = (s11 / both - (s1 / both) ** 2) * (s22 / both - (s2 / both) ** 2)
            if spread > 1e-18:
                correlation = (s12 / both - s1 * s2 / both**2) / math.sqrt(spread)
                result[p, 1] = correlation * min(1.0, agree / base)
