"""Ask pictures with depth for the convention of their poses: which hypothesis makes them overlap.

A file's numbers are tried as camera to world and world to camera, each also with its rotation transposed,
with 48 signed axes, orders of quaternions, ratios of units, planar depth or depth along the ray, and shifts
by frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from omniscv.geometry import Array
from omniscv.geometry.trajectory_columns import FRAMES, axes_of, frame_of_axes
from omniscv.sources.recording.overlap import PosedPictures, agreement, moves

LEAST = 0.35
"""Agreement below which pictures tell nothing."""

_RATIOS = (1, 100, 0.01, 1000, 0.001, 10, 0.1, 5, 0.2, 1000 / 256, 0.256, 0.3048, 1 / 0.3048, 2, 0.5)
_SHIFTS = (-3, -2, -1, 1, 2, 3)
_LEAST_SHIFTED = 9  # frames
PAIRS, WIDTH = 20, 640
"""Pairs of frames that are asked, and px of their width, at most."""
_SKIM, _FEW, _MANY = 60, 140, 900  # points of a pair
_COARSE, _FINE = {_SKIM: 0.1, _FEW: 0.07}, (0.03, 0.015, 0.008)  # tolerances of log depth
_SKIMMED, _KEPT, _SHIFTED, _FINAL = 600, 70, 6, 60  # hypotheses
_BEARS = 0.8  # of its agreement, which the best keeps at a finer tolerance
_SPREAD = 0.03  # of agreements of pairs, at least
_TIED, _TIED_SIGMA, _NEAR_SIGMA, _NEAR = 0.01, 2.0, 3.0, 0.15
_CLEAR = 0.75  # words that reach less of the best agreement are wrong
_QUATERNIONS = {"": (0, 1, 2, 3), "w first": (1, 2, 3, 0), "w last": (3, 0, 1, 2)}
_METRES = {0.01: "cm", 0.001: "mm", 1.0: "m"}
_COMMON = (1, 100, 256, 1000, 4000, 5000, 6553.5, 65535)  # whole numbers of depth in a metre
_PLAUSIBLE = (0.1, 150.0)  # median depth, metres


_I = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class Convention(NamedTuple):
    """What the numbers of poses and depth mean.

    Attributes:
        inverse: from the world to the camera.
        transposed: rotations are the transposes of those.
        axes: (9,) C of :func:`omniscv.geometry.trajectory_columns.axes_of`, row by row.
        ratio: of the unit of depth to that of positions, over the ratio that is said.
        along: depth is along the ray.
        quaternion: the order of its numbers, where it is not as said.
        shift: frames by which poses come early.
    """

    inverse: bool = False
    transposed: bool = False
    axes: tuple[float, ...] = _I
    ratio: float = 1.0
    along: bool = False
    quaternion: str = ""
    shift: int = 0

    def departures(self, other: Convention) -> int:
        """Return in how many things two conventions differ."""
        return sum(a != b for a, b in zip(self, other, strict=True))


@dataclass(frozen=True)
class Words:
    """What is said of poses and depth.

    Attributes:
        axes: a name of :func:`omniscv.geometry.trajectory_columns.axes_of`.
        inverse: world to camera.
        along: depth along the ray.
        per_m: whole numbers of depth in a metre; 1 where depth is in floats of metres.
        quaternions: whether rotations are quaternions.
        fixed: whether only units and kinds may be others, as of faces.
        asks: whether the words are a guess that pictures may correct.
        metres: of one of positions.
    """

    axes: str = "camera"
    inverse: bool = False
    metres: float = 1.0
    along: bool = False
    per_m: float = 1.0
    quaternions: bool = False
    fixed: bool = False
    asks: bool = False

    @property
    def convention(self) -> Convention:
        """The same as a convention."""
        return Convention(self.inverse, axes=_key(axes_of(self.axes)[1]), along=self.along)

    def written(self, R_w_c: Array, t_w_c: Array) -> tuple[Array, Array]:
        """Return the rotations and translations that the file has, from poses that were read by the words."""
        W, C = axes_of(self.axes)
        R, t = W.T @ R_w_c @ C.T, t_w_c @ W
        return (R.swapaxes(1, 2), -np.einsum("nji,nj->ni", R, t)) if self.inverse else (R, t)


@dataclass(frozen=True)
class Score:
    """A hypothesis, and its agreement by pair."""

    convention: Convention
    pairs: Array

    @property
    def mean(self) -> float:
        """Mean over pairs."""
        return float(self.pairs.mean())


@dataclass(frozen=True)
class Verdict:
    """What pictures say.

    Attributes:
        words: what was said.
        best: the hypothesis of most agreement; of those that are tied with it, the nearest to the words.
        said: that of the words.
        following: the best of those that are not tied; None if all are.
        tied: conventions that pictures cannot tell from the best.
        median: of depth, as read.
        why: why pictures cannot tell; empty where they can.
    """

    words: Words
    best: Score | None = None
    said: Score | None = None
    following: Score | None = None
    tied: tuple[Convention, ...] = ()
    median: float = 1.0
    why: str = ""

    @property
    def contradicts(self) -> bool:
        """Whether pictures clearly say another thing than the words."""
        if self.why or self.best is None or self.said is None:
            return False
        same = self.best.convention == self.said.convention
        return not same and self.said.mean < _CLEAR * self.best.mean

    def line(self) -> str:
        """Return the verdict in one line."""
        if self.why or self.best is None or self.said is None:
            return f"pictures cannot tell their convention: {self.why}; taken as said"
        parts = [f"agreement {self.best.mean:.2f}"]
        is_said = self.best.convention == self.said.convention
        parts += [] if is_said else [f"as said {self.said.mean:.2f}"]
        parts += [f"next best {self.following.mean:.2f}"] if self.following else []
        names = {"ratio": "units", "along": "planar or along the ray", "shift": "timing", "axes": "axes"}
        open_ = [
            names.get(name, "the direction of poses")
            for i, name in enumerate(Convention._fields)
            if len({convention[i] for convention in (self.best.convention, *self.tied)}) > 1
        ]
        parts += [f"cannot tell {', '.join(dict.fromkeys(open_))}"] if open_ else []
        head = "pictures: as said, " if is_said else "pictures: "
        return f"{head}{self.described(self.best.convention)}: {'; '.join(parts)}"

    def described(self, convention: Convention) -> str:
        """Return a convention in words."""
        parts = ["world-to-camera" if convention.inverse else "camera-to-world"]
        parts += ["rotations transposed"] * convention.transposed
        parts += [f"quaternions {convention.quaternion}"] if convention.quaternion else []
        parts += [f"axes {frame_of_axes(np.reshape(convention.axes, (3, 3)))}"]
        metres, per_m = self.units(convention)
        parts += [f"positions in {_unit(metres)}"] if metres != 1 else []
        depth = "depth along the ray" if convention.along else "planar depth"
        parts += [depth + (f" of 1/{per_m:g} m" if per_m != 1 else "")]
        if convention.shift:
            late = "early" if convention.shift > 0 else "late"
            parts += [f"poses {abs(convention.shift)} frames {late}"]
        return ", ".join(parts)

    def units(self, convention: Convention) -> tuple[float, float]:
        """Return metres of one of positions as read, and whole numbers of depth in a metre.

        Pictures say only how they compare: depth is another where that makes its numbers known ones and
        plausible, else positions.
        """
        per_m = self.words.per_m * convention.ratio**-1
        depth_m = self.median * convention.ratio
        is_depth = self.words.per_m != 1 or not _PLAUSIBLE[0] < self.median < _PLAUSIBLE[1]
        known = any(abs(per_m / one - 1) < 0.01 for one in _COMMON)
        if is_depth and known and _PLAUSIBLE[0] < depth_m < _PLAUSIBLE[1]:
            return self.words.metres, per_m
        return self.words.metres / convention.ratio, self.words.per_m

    def advice(self, by: str) -> str:
        """Return the words to write in place of those that pictures contradict.

        Args:
            by: what says how poses are: a ``layout`` of the user's own, ``options``, or a fixed ``format``.
        """
        assert self.best is not None
        right, said = self.best.convention, self.words.convention
        metres, per_m = self.units(right)
        axes = frame_of_axes(np.reshape(right.axes, (3, 3)))
        order = "qw qx qy qz" if right.quaternion == "w first" else "qx qy qz qw"
        keys = {"axes": axes} if right.axes != said.axes else {}
        keys |= {"inverse": str(right.inverse).lower()} if right.inverse != said.inverse else {}
        keys |= {"unit": _unit(metres).removesuffix(" m")} if metres != self.words.metres else {}
        later = f"{abs(right.shift)} frames {'later' if right.shift > 0 else 'earlier'}"
        converted = {
            f"names of the columns, x y z {order}, above the poses": right.quaternion,
            "poses with their rotations transposed": right.transposed,
            f"each pose at the picture {later}": right.shift,
        }
        words = [word for word, due in converted.items() if due]
        if keys and by == "layout":
            words.append(
                f"poses: {{{', '.join(f'{key}: {value}' for key, value in keys.items())}}} in a layout"
            )
        elif keys and by == "options" and "inverse" not in keys and keys.get("axes", "ned") in FRAMES:
            keys = {"frame" if key == "axes" else key: value for key, value in keys.items()}
            words += [f"--{key} {value}" for key, value in keys.items()]
        elif keys:
            direction = "world-to-camera" if said.inverse else "camera-to-world"
            words.append(f"poses converted to {direction}, axes {self.words.axes}, and metres")
        if (right.along, per_m) != (said.along, self.words.per_m):
            unit = "m" if per_m == 1 else "mm" if per_m == 1000 else f"1/{per_m:g}"
            words.append(f"--depth {'ray' if right.along else 'planar'}-{unit}")
        return " and ".join(words)


def _unit(metres: float) -> str:
    return next((word for one, word in _METRES.items() if abs(metres / one - 1) < 1e-6), f"{metres:.6g} m")


def _key(C: Array) -> tuple[float, ...]:
    return tuple((np.asarray(C).ravel() + 0.0).tolist())


@cache
def _all_axes() -> tuple[tuple[float, ...], ...]:
    """The 48 signed axes."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        C = np.zeros((3, 3))
        C[list(order), range(3)] = signs
        found.append(_key(C))
    return tuple(found)


def poses_by(convention: Convention, R: Array, t: Array) -> tuple[Array, Array]:
    """Return rotations and positions of cameras by a hypothesis of a file's numbers, in the unit of depth.

    The order of quaternions and shifts are left to :func:`turned` and the caller.
    """
    R = R.swapaxes(1, 2) if convention.transposed else R
    if convention.inverse:
        R, t = R.swapaxes(1, 2), -np.einsum("nji,nj->ni", R, t)
    return R @ np.reshape(convention.axes, (3, 3)), t / convention.ratio


def turned(R: Array, quaternion: str) -> Array:
    """Return rotations with the numbers of their quaternions in another order."""
    if not quaternion:
        return R
    from scipy.spatial.transform import Rotation  # slow to load

    numbers = Rotation.from_matrix(R).as_quat()[:, list(_QUATERNIONS[quaternion])]
    return np.asarray(Rotation.from_quat(numbers).as_matrix())


def placed(convention: Convention, words: Words, pictures: PosedPictures) -> tuple[Array, Array]:
    """Return rotations and positions of all frames by a hypothesis, in the unit of depth."""
    R, t = words.written(pictures.R, pictures.t)
    at = np.clip(np.arange(len(R)) + convention.shift, 0, len(R) - 1)
    return poses_by(convention, turned(R, convention.quaternion)[at], t[at])


class _Search:
    """Scores hypotheses on pairs of frames."""

    def __init__(self, pictures: PosedPictures, words: Words) -> None:
        self.pictures, self.words = pictures, words
        R, self._t = words.written(pictures.R, pictures.t)
        orders = _QUATERNIONS if words.quaternions else [""]
        self._R = {order: turned(R, order) for order in orders}
        self.grey = np.zeros_like(pictures.depth) if pictures.grey is None else pictures.grey
        self._second = pictures.pairs[:, 1].copy()
        self._motions = dict[Convention, tuple[Array, Array]]()
        self._points = {count: pictures.points(count) for count in (_SKIM, _FEW, _MANY)}

    def score(self, convention: Convention, count: int, tolerance: float) -> Score:
        """Return the agreement of a hypothesis, by so many points of each pair."""
        pictures, how = self.pictures, (convention.along, self.pictures.panorama, tolerance)
        C = np.reshape(convention.axes, (3, 3))
        turn, step = self._motion(convention._replace(axes=_I, ratio=1.0, along=False))
        motion = np.concatenate([C.T @ turn @ C, C.T @ step / convention.ratio], axis=-1)
        points = self._points[count]
        found = agreement(points, motion, self._second, pictures.depth, self.grey, pictures.lenses, how)
        if pictures.grey is None:
            return Score(convention, found[:, 0])
        return Score(convention, 0.5 * (found[:, 0] + np.maximum(found[:, 1], 0)))

    def _motion(self, convention: Convention) -> tuple[Array, Array]:
        """Return rotations (P, 3, 3) and translations (P, 3, 1) of pairs, in the file's axes and unit."""
        if convention not in self._motions:
            R = self._R[convention.quaternion]
            at = np.clip(self.pictures.frames + convention.shift, 0, len(R) - 1)
            motion = moves(*poses_by(convention, R[at], self._t[at]), self.pictures.pairs)
            self._motions[convention] = motion[..., :3], motion[..., 3:]
        return self._motions[convention]

    def hypotheses(self) -> Iterator[Convention]:
        """Yield all, but for kinds of depth and shifts."""
        said, per_m = self.words.convention, self.words.per_m
        known = [per_m / one for one in _COMMON if per_m in _COMMON and one > 1 != per_m]
        ratios = dict.fromkeys(float(ratio) for ratio in (*_RATIOS, *known))
        if self.words.fixed:
            yield from (said._replace(ratio=ratio) for ratio in ratios)
            return
        orders, both = [*_QUATERNIONS] if self.words.quaternions else [""], (False, True)
        for order, inverse, transposed, C, ratio in product(orders, both, both, _all_axes(), ratios):
            yield Convention(inverse, transposed, C, ratio, said.along, order)


def ask(pictures: PosedPictures, words: Words) -> Verdict:
    """Return which convention pictures support, beside the words.

    Args:
        pictures: with poses as read by the words.
        words: what is said.
    """
    search = _Search(pictures, words)
    surfaces = pictures.depth[pictures.depth > 0]
    if not len(surfaces):
        return Verdict(words, why="depth shows no surface")
    said = words.convention
    kept = _best(search, [*search.hypotheses()], _SKIM, _SKIMMED)
    kinds = (True,) if pictures.panorama else (False, True)
    kept = _best(search, [one._replace(along=along) for one in kept for along in kinds], _FEW, _KEPT)
    kept += [said._replace(along=along) for along in kinds if said._replace(along=along) not in kept]
    scores = _scored(search, kept, _MANY, _FINE[0])
    if len(pictures.R) >= _LEAST_SHIFTED:
        likely = dict.fromkeys([said, *(score.convention for score in scores[:_SHIFTED])])
        shifted = [one._replace(shift=by) for one in likely for by in _SHIFTS]
        scores += _scored(search, shifted, _MANY, _FINE[0])
        scores.sort(key=lambda score: -score.mean)
    first, kept = scores[0].mean, [score.convention for score in scores[:_FINAL]]
    kept += [said] * (said not in kept)
    for tolerance in _FINE[1:]:
        if search.score(scores[0].convention, _MANY, tolerance).mean < _BEARS * first:
            break
        scores = _scored(search, kept, _MANY, tolerance)
    best = scores[0]
    tied = [score for score in scores if _is_tied(best, score)]
    others = [score for score in scores if score not in tied]
    nearest = min(tied, key=lambda score: (score.convention.departures(said), -score.mean))
    of_words = next(score for score in scores if score.convention == said)
    rest = tuple(score.convention for score in tied if score is not nearest)
    result = Verdict(words, nearest, of_words, next(iter(others), None), rest, float(np.median(surfaces)))
    if best.mean < LEAST:
        return replace(result, why=f"they agree by {best.mean:.2f} at best")
    return result


def _best(search: _Search, conventions: Sequence[Convention], count: int, most: int) -> list[Convention]:
    return [score.convention for score in _scored(search, conventions, count, _COARSE[count])[:most]]


def _scored(search: _Search, conventions: Sequence[Convention], count: int, tolerance: float) -> list[Score]:
    scores = [search.score(one, count, tolerance) for one in conventions]
    return sorted(scores, key=lambda score: -score.mean)


def _is_tied(best: Score, other: Score) -> bool:
    """Return whether pairs do not tell two hypotheses apart."""
    if other is best:
        return True
    difference = best.pairs - other.pairs
    margin, sigma = difference.mean(), np.hypot(difference.std(), _SPREAD) / np.sqrt(len(difference))
    z = margin / sigma
    return bool(margin < _TIED or z < _TIED_SIGMA or (z < _NEAR_SIGMA and margin < _NEAR * best.mean))
