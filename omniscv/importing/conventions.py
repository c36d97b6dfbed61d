"""Ask pictures with depth for the convention of their poses: which one makes them overlap."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from omniscv.geometry import Array
from omniscv.geometry.trajectory_columns import FRAMES, axes_of, frame_of_axes
from omniscv.importing.overlap import PosedPictures, moves

LEAST = 0.35
"""Agreement below which pictures tell nothing."""
PAIRS = 20
WIDTH = 640
"""Pairs of frames that are asked, and px of their width, at most."""

_RATIOS = (1, 100, 0.01, 1000, 0.001, 10, 0.1, 5, 0.2, 1000 / 256, 0.256, 0.3048, 1 / 0.3048, 2, 0.5)
# frames
_SHIFTS = (-3, -2, -1, 1, 2, 3)
_LEAST_SHIFTED = 9
# points of a pair, and tolerances of log depth
_SKIM = (60, 0.1)
_LOOK = (140, 0.07)
_READ = ((900, 0.03), (900, 0.015), (900, 0.008))
# hypotheses
_SKIMMED = 600
_KEPT = 70
_SHIFTED = 6
_FINAL = 60
_BEARS = 0.8  # of its agreement, which the best keeps at a finer tolerance
_SPREAD = 0.03  # of agreements of pairs, at least
_TIED = 0.01
_TIED_SIGMA = 2.0
_NEAR_SIGMA = 3.0
_NEAR = 0.15
_CLEAR = 0.75  # words that reach less of the best agreement are wrong
_QUATERNIONS = {"": (0, 1, 2, 3), "w first": (1, 2, 3, 0), "w last": (3, 0, 1, 2)}
_METRES = {0.01: "cm", 0.001: "mm", 1.0: "m"}
_COMMON = (1, 100, 256, 1000, 4000, 5000, 6553.5, 65535)  # whole numbers of depth in a metre
_PLAUSIBLE = (0.1, 150.0)  # median depth, metres
_I = tuple(np.eye(3).ravel().tolist())
_TURN = "the direction of poses"
_OPEN = (_TURN, _TURN, "axes", "units", "planar or along the ray", _TURN, "timing")
_FLIPPED = {
    "with left and right exchanged, as numpy.fliplr does": (-1, 1, 1),
    "the other way up, as numpy.flipud does": (1, -1, 1),
}
"""How pictures are turned, and which axes of the camera that exchanges."""
_COLORS_TURNED = {
    "with left and right exchanged, as numpy.fliplr does": (-1.0, 1.0),
    "the other way up, as numpy.flipud does": (1.0, -1.0),
    "turned by 180 degrees, as numpy.rot90 with k=2 does": (-1.0, -1.0),
}
"""How colours are turned beside depth, and their scale across and down about the middle."""
_OF_DEPTH_ALONE = 0.7  # of its agreement, which colours beside depth that is turned alone do not reach
_BY = {
    **dict.fromkeys(("nerfstudio", "tum", "arkitscenes", "isaac"), "format"),
    **dict.fromkeys(("latlong", "pinhole"), "options"),
}
"""By layout, what says how poses are; a layout of the user's if it is none of these."""


class Convention(NamedTuple):
    """What the numbers of poses and depth mean."""

    inverse: bool = False  # from the world to the camera
    transposed: bool = False  # rotations are the transposes of those
    axes: tuple[float, ...] = _I  # (9,) C of `trajectory_columns.axes_of`, row by row
    ratio: float = 1.0  # of the unit of depth to that of positions, over the ratio that is said
    along: bool = False  # depth is along the ray
    quaternion: str = ""  # the order of its numbers, where it is not as said
    shift: int = 0  # frames by which poses come early

    @property
    def C(self) -> Array:
        """The axes as a matrix."""
        return np.reshape(self.axes, (3, 3))

    def poses(self, R: Array, t: Array) -> tuple[Array, Array]:
        """Return rotations and positions of cameras by a file's numbers, in the unit of depth."""
        if self.quaternion:
            from scipy.spatial.transform import Rotation  # slow to load

            numbers = Rotation.from_matrix(R).as_quat()[:, list(_QUATERNIONS[self.quaternion])]
            R = np.asarray(Rotation.from_quat(numbers).as_matrix())
        at = np.clip(np.arange(len(R)) + self.shift, 0, len(R) - 1)
        R = (R.swapaxes(1, 2) if self.transposed else R)[at]
        t = t[at]
        R, t = inverted(R, t) if self.inverse else (R, t)
        return R @ self.C, t / self.ratio


@dataclass(frozen=True)
class Words:
    """What is said of poses and depth."""

    axes: str = "camera"  # a name of `trajectory_columns.axes_of`
    inverse: bool = False  # poses are world to camera
    metres: float = 1.0  # of one of positions
    along: bool = False  # depth is along the ray
    per_m: float = 1.0  # whole numbers of depth in a metre; 1 where it is in floats of metres
    quaternions: bool = False  # whether rotations are quaternions
    fixed: bool = False  # whether only units and kinds may be others, as of faces
    asks: bool = False  # whether the words are a guess that pictures may correct

    @property
    def convention(self) -> Convention:
        """The same as a convention."""
        return Convention(self.inverse, axes=_key(axes_of(self.axes)[1]), along=self.along)

    def written(self, R_w_c: Array, t_w_c: Array) -> tuple[Array, Array]:
        """Return the rotations and translations that the file has, of poses that were read by the words."""
        W, C = axes_of(self.axes)
        R = W.T @ R_w_c @ C.T
        t = t_w_c @ W
        return inverted(R, t) if self.inverse else (R, t)


class Score(NamedTuple):
    """A hypothesis, its agreement by pair, and the means of them and of depth's alone."""

    convention: Convention
    pairs: Array
    mean: float
    of_depth: float


@dataclass(frozen=True)
class Verdict:
    """What pictures say of words, or ``why`` they cannot tell."""

    words: Words
    best: Score | None = None  # of most agreement; of those that are tied with it, the nearest to the words
    said: Score | None = None  # that of the words
    following: Score | None = None  # the best of those that are not tied
    tied: tuple[Convention, ...] = ()  # what pictures cannot tell from the best
    median: float = 1.0  # of depth, as read
    why: str = ""
    colors: str = ""  # how colours are put right that are turned beside depth; empty where they are not

    @property
    def contradicts(self) -> bool:
        """Whether pictures clearly say another thing than the words."""
        if self.why or self.best is None or self.said is None:
            return False
        return self.best is not self.said and self.said.mean < _CLEAR * self.best.mean

    def line(self) -> str:
        """Return the verdict in one line."""
        if self.why or self.best is None or self.said is None:
            return f"pictures cannot tell their convention: {self.why}; taken as said"
        is_said = self.best is self.said
        values = zip(self.best.convention, *self.tied, strict=True)
        open_ = dict.fromkeys(name for name, of in zip(_OPEN, values, strict=True) if len({*of}) > 1)
        parts = [
            f"{'as said, ' * is_said}{self.described(self.best.convention)}: agreement {self.best.mean:.2f}",
            "" if is_said else f"as said {self.said.mean:.2f}",
            f"next best {self.following.mean:.2f}" if self.following else "",
            f"cannot tell {', '.join(open_)}" if open_ else "",
        ]
        return f"pictures: {'; '.join(filter(None, parts))}"

    def described(self, convention: Convention) -> str:
        """Return a convention in words."""
        metres, per_m = self.units(convention)
        late = "early" if convention.shift > 0 else "late"
        parts = {
            "world-to-camera" if convention.inverse else "camera-to-world": True,
            "rotations transposed": convention.transposed,
            f"quaternions {convention.quaternion}": convention.quaternion,
            f"axes {frame_of_axes(convention.C)}": True,
            f"positions in {_unit(metres)}": metres != 1,
            f"{'depth along the ray' if convention.along else 'planar depth'}"
            f"{f' of 1/{per_m:g} m' if per_m != 1 else ''}": True,
            f"poses {abs(convention.shift)} frames {late}": convention.shift,
        }
        return ", ".join(part for part, due in parts.items() if due)

    def units(self, convention: Convention) -> tuple[float, float]:
        """Return metres of one of positions as read, and whole numbers of depth in a metre.

        Depth is another where that makes its numbers known ones and plausible, else positions.
        """
        per_m = self.words.per_m / convention.ratio
        depth_m = self.median * convention.ratio
        is_depth = self.words.per_m != 1 or not _PLAUSIBLE[0] < self.median < _PLAUSIBLE[1]
        known = any(abs(per_m / one - 1) < 0.01 for one in _COMMON)
        if is_depth and known and _PLAUSIBLE[0] < depth_m < _PLAUSIBLE[1]:
            return self.words.metres, per_m
        return self.words.metres / convention.ratio, self.words.per_m

    def advice(self, layout: str) -> str:
        """Return the words to write in place of those that pictures contradict, in a layout."""
        assert self.best is not None
        right = self.best.convention
        said = self.words.convention
        by = _BY.get(layout, "layout")
        metres, per_m = self.units(right)
        axes = frame_of_axes(right.C)
        order = "qx qy qz qw" if right.quaternion == "w last" else "qw qx qy qz"
        turned = self._turned_pictures(layout)
        keys = {"axes": axes} if right.axes != said.axes and (by == "layout" or not turned) else {}
        keys |= {"inverse": str(right.inverse).lower()} if right.inverse != said.inverse else {}
        keys |= {"unit": _unit(metres).removesuffix(" m")} if metres != self.words.metres else {}
        if "inverse" in keys or keys.get("axes", "ned") not in FRAMES:
            by = by.replace("options", "format")  # which have no words for it
        direction = "world-to-camera" if said.inverse else "camera-to-world"
        listed = ", ".join(f"{key}: {value}" for key, value in keys.items())
        options = [f"--{key.replace('axes', 'frame')} {value}" for key, value in keys.items()]
        unit = {1.0: "m", 1000.0: "mm"}.get(per_m, f"1/{per_m:g}")
        words = {
            f"names of the columns, x y z {order}, above the poses": right.quaternion,
            "poses with their rotations transposed": right.transposed,
            f"each pose at the picture {abs(right.shift)} frames "
            f"{'later' if right.shift > 0 else 'earlier'}": right.shift,
            turned: turned and by != "layout",
            f"poses: {{{listed}}} in a layout{f', or {turned}' if turned else ''}": keys and by == "layout",
            " and ".join(options): keys and by == "options",
            f"poses converted to {direction}, axes {self.words.axes}, and metres": keys and by == "format",
            f"--depth {'ray' if right.along else 'planar'}-{unit}": (right.along, per_m)
            != (said.along, self.words.per_m),
        }
        return " and ".join(word for word, due in words.items() if due)

    def _turned_pictures(self, layout: str) -> str:
        """Return what to do where poses are as said, but pictures are mirrored or upside down; else empty."""
        assert self.best is not None
        change = self.words.convention.C.T @ self.best.convention.C
        how = next((how for how, flip in _FLIPPED.items() if np.array_equal(change, np.diag(flip))), "")
        if not how:
            return ""
        if self.best.mean < _OF_DEPTH_ALONE * self.best.of_depth:
            return f"depth {how} (colours are as they should be)"
        is_option = how.startswith("with left") and _BY.get(layout) == "options"
        return "--mirrored" if is_option else f"colours and depth {how}"


def inverted(R: Array, t: Array) -> tuple[Array, Array]:
    """Return the inverses of poses."""
    return R.swapaxes(1, 2), -np.einsum("nji,nj->ni", R, t)


def _unit(metres: float) -> str:
    return next((word for one, word in _METRES.items() if abs(metres / one - 1) < 1e-6), f"{metres:.6g} m")


def _key(C: Array) -> tuple[float, ...]:
    return tuple((np.asarray(C).ravel() + 0.0).tolist())


_AXES = tuple(
    _key(np.eye(3)[list(order)] * signs)
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
)
"""The 48 signed axes."""


class _Search:
    """Scores hypotheses on pairs of frames."""

    def __init__(self, pictures: PosedPictures, words: Words) -> None:
        self.pictures = pictures
        self.words = words
        self._file = words.written(pictures.R, pictures.t)
        self._motions = dict[Convention, tuple[Array, Array]]()
        self._scores = dict[tuple[int, float], dict[Convention, Score]]()

    def ranked(self, conventions: Iterable[Convention], points: int, tolerance: float) -> list[Score]:
        """Return the scores of hypotheses, the best first, by so many points of each pair."""
        scores = self._scores.setdefault((points, tolerance), {})
        for each in (asked := dict.fromkeys(conventions)):
            if each not in scores:
                scores[each] = self._score(each, points, tolerance)
        return sorted((scores[each] for each in asked), key=lambda score: -score.mean)

    def turned_colors(self, convention: Convention) -> str:
        """Return how to put colours right that agree from picture to picture only if they are turned about
        their middle; empty where they agree as they are, or do not tell."""
        if self.pictures.grey is None:
            return ""
        motion = self._motion(convention)
        how = (*_READ[0], convention.along)
        as_said = self.pictures.agreements(*motion, how)[:, 1].mean()
        agreements = {}
        for words, scale in _COLORS_TURNED.items():
            agreements[words] = self.pictures.agreements(*motion, how, (*scale, 0, 0))[:, 1].mean()
        best = max(agreements, key=lambda words: float(agreements[words]))
        is_turned = agreements[best] >= LEAST and as_said < _CLEAR * agreements[best]
        return best if is_turned else ""

    def _motion(self, convention: Convention) -> tuple[Array, Array]:
        """Return rotations (P, 3, 3) and translations (P, 3), in units of depth, between pairs of cameras."""
        pictures = self.pictures
        form = convention._replace(axes=_I, ratio=1.0, along=False)
        if form not in self._motions:
            R, t = form.poses(*self._file)
            self._motions[form] = moves(R[pictures.frames], t[pictures.frames], pictures.pairs)
        turn, step = self._motions[form]
        C = convention.C
        return C.T @ turn @ C, step @ C / convention.ratio

    def _score(self, convention: Convention, points: int, tolerance: float) -> Score:
        pictures = self.pictures
        how = points, tolerance, convention.along
        depth, grey = pictures.agreements(*self._motion(convention), how).T
        pairs = depth if pictures.grey is None else (depth + np.maximum(grey, 0)) / 2
        return Score(convention, pairs, float(pairs.mean()), float(depth.mean()))

    def hypotheses(self) -> Iterator[Convention]:
        """Yield all, but for kinds of depth and shifts."""
        said = self.words.convention
        per_m = self.words.per_m
        known = [per_m / one for one in _COMMON if per_m in _COMMON and one > 1 != per_m]
        ratios = dict.fromkeys(float(ratio) for ratio in (*_RATIOS, *known))
        if self.words.fixed:
            yield from (said._replace(ratio=ratio) for ratio in ratios)
            return
        orders = [*_QUATERNIONS] if self.words.quaternions else [""]
        both = (False, True)
        for order, inverse, transposed, C, ratio in product(orders, both, both, _AXES, ratios):
            yield Convention(inverse, transposed, C, ratio, said.along, order)


def ask(pictures: PosedPictures, words: Words) -> Verdict:
    """Return which convention pictures support, whose poses were read by the words."""
    search = _Search(pictures, words)
    said = words.convention
    surfaces = pictures.depth[pictures.depth > 0]
    if not len(surfaces):
        return Verdict(words, why="depth shows no surface")

    def of_both_kinds(conventions: Iterable[Convention]) -> list[Convention]:
        kinds = (True,) if pictures.panorama else (False, True)
        return [each._replace(along=along) for each in conventions for along in kinds]

    kept = [score.convention for score in search.ranked(search.hypotheses(), *_SKIM)[:_SKIMMED]]
    kept = [score.convention for score in search.ranked(of_both_kinds(kept), *_LOOK)[:_KEPT]]
    kept += of_both_kinds([said])
    scores = search.ranked(kept, *_READ[0])
    if len(pictures.R) >= _LEAST_SHIFTED:
        likely = [said, *(score.convention for score in scores[:_SHIFTED])]
        unshifted = {score.convention: score.of_depth for score in scores}
        shifted = search.ranked([each._replace(shift=by) for each in likely for by in _SHIFTS], *_READ[0])
        # Where depth does not agree better, colours are late, and not poses.
        before = [unshifted[score.convention._replace(shift=0)] for score in shifted]
        pairs = zip(shifted, before, strict=True)
        kept += [score.convention for score, of_depth in pairs if score.of_depth > of_depth]
        scores = search.ranked(kept, *_READ[0])
    first = scores[0]
    kept = [*(score.convention for score in scores[:_FINAL]), said]
    for finer in _READ[1:]:
        if search.ranked([scores[0].convention], *finer)[0].mean < _BEARS * first.mean:
            break
        scores = search.ranked(kept, *finer)
    best = scores[0]
    tied = [score for score in scores if _are_tied(best, score)]
    nearest = min(tied, key=lambda score: sum(a != b for a, b in zip(score.convention, said, strict=True)))
    of_words = next(score for score in scores if score.convention == said)
    following = next((score for score in scores if not _are_tied(best, score)), None)
    others = tuple(score.convention for score in tied if score is not nearest)
    why = f"they agree by {best.mean:.2f} at best" if best.mean < LEAST else ""
    colors = search.turned_colors(nearest.convention)
    return Verdict(words, nearest, of_words, following, others, float(np.median(surfaces)), why, colors)


def _are_tied(best: Score, other: Score) -> bool:
    """Return whether pairs do not tell two hypotheses apart."""
    difference = best.pairs - other.pairs
    margin = difference.mean()
    sigma = np.hypot(difference.std(), _SPREAD) / np.sqrt(len(difference))
    z = margin / sigma
    return bool(margin < _TIED or z < _TIED_SIGMA or (z < _NEAR_SIGMA and margin < _NEAR * best.mean))
