"""Pictures with poses in memory, and how well a motion explains pairs of them that overlap."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry import Array

Indices = NDArray[np.int64]

_BINS = 96  # of log depth, for the agreement that chance gives
_FEW = 6  # pairs that are looked at both ways
_GAPS = (1, 2, 3, 4, 6, 8, 12, 16, 24)  # frames between those of a pair
_OVERLAPS, _TURNED = 0.45, 0.25  # shares of the field of view: the most that a pair turns, and enough
_MOST_FOV = 2.0  # radians; of a wider picture, no more counts
_BESIDE = 24  # pairs of a gap that are looked at
_LEAST_AGREE = 9  # points whose grey is compared
_LEAST_SD = 6.0  # grey levels that are noise


@dataclass(frozen=True)
class PosedPictures:
    """Depth and colours of one size, and the poses of all frames, also of those whose pictures are not read.

    Attributes:
        depth: (M, H, W) float32, 0 for no surface; as stored, planar or along the ray.
        grey: (M, H, W) float32, brightness without its local mean and contrast; None without colours.
        lenses: (M, 4) fx, fy, cx, cy; px of this size.
        frames: (M,) whose pictures these are.
        pairs: (P, 2) pictures that overlap if poses are right.
        R: (N, 3, 3) rotations of frames as said, camera to world.
        t: (N, 3) positions as said.
        panorama: whether pictures are equirectangular.
    """

    depth: NDArray[np.float32]
    grey: NDArray[np.float32] | None
    lenses: Array
    frames: Indices
    pairs: Indices
    R: Array
    t: Array
    panorama: bool = False

    @classmethod
    def read(
        cls, R: Array, t: Array, read: Callable[[int, int], Shot | None], fov: float, pairs: int, width: int
    ) -> PosedPictures | None:
        """Return the pictures of pairs of frames that are likely to overlap; None where there are none.

        Args:
            R, t: of all frames, in their order.
            read: returns a frame's picture of at most so many px width; None if it cannot be read.
            fov: field of view, radians.
            pairs: how many, at most.
            width: of pictures, px, at most.
        """
        chosen = choose_pairs(R, t, fov, pairs)
        shots = {int(i): shot for i in np.unique(chosen) if (shot := read(int(i), width)) is not None}
        sizes = Counter(shot.depth.shape for shot in shots.values())
        usual = max(sizes, key=lambda size: sizes[size], default=None)
        frames = [i for i, shot in shots.items() if shot.depth.shape == usual]
        at = {frame: place for place, frame in enumerate(frames)}
        held = [[at[a], at[b]] for a, b in chosen.tolist() if a in at and b in at]
        if not held:
            return None
        held += [pair[::-1] for pair in held] if len(held) < _FEW else []
        of = [shots[frame] for frame in frames]
        greys = [shot.grey for shot in of if shot.grey is not None]
        grey = np.stack(greys) if len(greys) == len(of) else None
        lenses = np.array([shot.lens or (1, 1, 0, 0) for shot in of], np.float64)
        depth, panorama = np.stack([shot.depth for shot in of]), of[0].lens is None
        return cls(depth, grey, lenses, np.array(frames), np.array(held), R, t, panorama)

    def points(self, count: int) -> Array:
        """Return (P, count, 5) random points of the first pictures of pairs: unit ray, depth, and grey."""
        height, width = self.depth.shape[1:]
        first = self.pairs[:, 0]
        random = np.random.default_rng(count)
        shape = len(first), count
        v, u = random.integers(2, height - 2, shape), random.integers(2, width - 2, shape)
        at = first[:, None], v, u
        grey = np.zeros(shape) if self.grey is None else self.grey[at]
        values = np.stack([self.depth[at], grey], axis=-1)
        return np.concatenate([self.rays(first, u + 0.5, v + 0.5), values], axis=-1)

    def rays(self, pictures: Indices, u: NDArray[Any], v: NDArray[Any]) -> Array:
        """Return unit rays of pixels (P, n) of pictures (P,), camera frame."""
        height, width = self.depth.shape[1:]
        if self.panorama:
            theta, phi = (2 * u / width - 1) * np.pi, (0.5 - v / height) * np.pi
            parts = [np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)]
            return np.stack(parts, axis=-1)
        fx, fy, cx, cy = self.lenses[pictures].T[..., None]
        rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)], axis=-1)
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


class Shot(NamedTuple):
    """A picture in memory: depth (H, W), 0 for none; local contrast; fx, fy, cx, cy, or None: a panorama."""

    depth: NDArray[np.float32]
    grey: NDArray[np.float32] | None
    lens: tuple[float, float, float, float] | None

    @classmethod
    def of(cls, depth: NDArray[Any], lit: NDArray[Any] | None, lens: Any, most: int) -> Shot:
        """Return the shot of depth and colours (H, W), every k-th pixel of them, k odd, to a width at most.

        ``lens`` has fx, fy, cx and cy of the depth's size; colours of another size are resized.
        """
        height, width = depth.shape
        k = max(1, -(-width // most)) | 1
        rows, columns = height // k, width // k
        cut = slice(k // 2, rows * k, k), slice(k // 2, columns * k, k)
        near = np.where(np.isfinite(depth[cut]) & (depth[cut] > 0), depth[cut], 0)
        grey = None
        if lit is not None:
            lit = lit.astype(np.float32) if lit.dtype.kind == "f" else lit
            if lit.shape[:2] != depth.shape:
                lit = cv2.resize(lit, (width, height), interpolation=cv2.INTER_AREA)
            lit = lit[: rows * k, : columns * k]
            if k > 1:
                lit = cv2.resize(lit, (columns, rows), interpolation=cv2.INTER_AREA)
            grey = local_contrast(lit)
        small = lens and (lens.fx / k, lens.fy / k, lens.cx / k, lens.cy / k)
        return cls(np.asarray(near, np.float32), grey, small)


def local_contrast(colors: NDArray[Any]) -> NDArray[np.float32]:
    """Return the brightness (H, W) of colours without its local mean and contrast."""
    grey = colors.astype(np.float32).mean(axis=-1)
    if colors.dtype == np.uint16:
        grey /= 257
    elif colors.dtype.kind == "f":
        grey = np.minimum(grey * (100 / max(float(np.median(grey)), 1e-9)), 1e3).astype(np.float32)
    sigma = max(1.2, grey.shape[1] / 260)
    size = (int(31 * sigma) | 1,) * 2
    grey = cv2.GaussianBlur(grey, (0, 0), sigma)
    grey -= cv2.blur(grey, size)
    return np.asarray(grey / (np.sqrt(np.maximum(cv2.blur(grey * grey, size), 0)) + _LEAST_SD), np.float32)


def choose_pairs(R: Array, t: Array, fov: float, most: int) -> Indices:
    """Return (P, 2) pairs of frames that turn and move, but see the same: by their order and turns.

    Args:
        R, t: rotations and positions as said; a wrong convention leaves the angle between rotations.
        fov: field of view, radians.
        most: pairs.
    """
    count, rows = len(R), list[Indices]()
    for gap in range(1, count) if count <= _BESIDE else _GAPS:
        first = np.arange(0, count - gap, max(1, (count - gap) // _BESIDE))
        rows.append(np.stack([first, first + gap], axis=1))
    if not rows:
        return np.empty((0, 2), np.int64)
    pairs = np.concatenate(rows)
    a, b = pairs.T
    trace = np.einsum("nij,nij->n", R[a], R[b])
    angle, far = np.arccos(np.clip((trace - 1) / 2, -1, 1)), np.linalg.norm(t[a] - t[b], axis=1)
    wide = min(fov, _MOST_FOV)
    fit = angle < _OVERLAPS * wide
    if fit.sum() < min(4, len(pairs)):
        fit = np.argsort(np.argsort(angle, kind="stable")) < max(4, len(pairs) // 4)
    middle = np.median(far[fit]) + 1e-12
    gain = np.minimum(angle / (_TURNED * wide), 1) + np.minimum(far / (2 * middle), 1)
    best = np.sort(np.argsort(np.where(fit, -gain, np.inf), kind="stable")[: min(3 * most, int(fit.sum()))])
    chosen = np.unique(np.linspace(0, len(best) - 1, min(most, len(best))).astype(int))
    return np.asarray(pairs[best[chosen]])


def moves(R: Array, t: Array, pairs: Indices) -> Array:
    """Return (P, 3, 4) rotations and translations from the first camera of pairs to the second."""
    a, b = pairs.T
    back = R[b].swapaxes(1, 2)
    return np.concatenate([back @ R[a], back @ (t[a] - t[b])[..., None]], axis=-1)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def agreement(
    points: Array,
    motion: Array,
    second: Indices,
    depth: NDArray[np.float32],
    grey: NDArray[np.float32],
    lenses: Array,
    how: tuple[bool, bool, float],
) -> Array:
    """Return (P, 2) of pairs the agreement of depth beyond chance, and the correlation of grey where it does.

    A point that another picture shows nearer may be hidden; one that it sees through contradicts.

    Args:
        points: (P, n, 5) of the first pictures, by :meth:`PosedPictures.points`.
        motion: (P, 3, 4) by :func:`moves`, lengths in units of depth.
        second: (P,) the second pictures.
        depth, grey, lenses: of all pictures.
        how: whether depth is along the ray; whether pictures are panoramas; the tolerance of log depth.
    """
    along, panorama, tolerance = how
    height, width = depth.shape[1:]
    result = np.zeros((len(points), 2))
    for p in range(len(points)):
        b, m = second[p], motion[p]
        fx, fy, cx, cy = lenses[b]
        expected_in, observed_in = np.zeros(_BINS), np.zeros(_BINS)
        agree = against = hidden = known = 0.0
        s1 = s2 = s11 = s22 = s12 = 0.0
        for i in range(points.shape[1]):
            x, y, z = points[p, i, 0], points[p, i, 1], points[p, i, 2]
            stored, own = points[p, i, 3], points[p, i, 4]
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
            there = grey[b, int(v), int(u)]
            s1, s2, s11, s22, s12 = s1 + own, s2 + there, s11 + own**2, s22 + there**2, s12 + own * there
        compared = agree + against
        if compared == 0:
            continue
        chance = (expected_in * observed_in).sum() / compared**2
        base = max(compared + 0.3 * hidden, 0.12 * known)
        result[p, 0] = max((agree - chance * compared) / base / (1.08 - chance), -0.5)
        if agree >= _LEAST_AGREE:
            of_both = (s11 / agree - (s1 / agree) ** 2) * (s22 / agree - (s2 / agree) ** 2)
            if of_both > 1e-18:
                both = s12 / agree - s1 * s2 / agree**2
                result[p, 1] = both / math.sqrt(of_both) * min(1.0, agree / base)
    return result
