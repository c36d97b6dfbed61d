"""Ask pictures with depth for the convention of their poses: which one makes them overlap."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from omniscv.geometry import Array
from omniscv.geometry.trajectory_columns import FRAMES, axes_of, frame_of_axes
from omniscv.importing.overlap import PosedPictures, moves
from omniscv.importing.registration import Misfit, misplaced, misread, unexplained

LEAST = 0.35
"""Agreement below which pictures tell nothing."""
CHANCE = {True: 0.4, False: 0.6}
"""By whether there are colours: what the best of thousands of conventions reaches above :data:`LEAST` by
chance, of one pair of frames that see different places. Of n pairs it is that over n^1.5."""
PAIRS = 20
WIDTH = 640
"""Pairs of frames that are asked, and px of their width, at most."""

_RATIOS = (1, 100, 0.01, 1000, 0.001, 10, 0.1, 5, 0.2, 1000 / 256, 0.256, 0.3048, 1 / 0.3048, 2, 0.5)
_SHIFTS = (-3, -2, -1, 1, 2, 3)  # frames by which poses are tried early or late
_LEAST_SHIFTED = 9  # frames, for that
# Points of a pair and tolerance of log depth, of each look at hypotheses:
_SKIM = (60, 0.1)
_LOOK = (140, 0.07)
_READ = ((900, 0.03), (900, 0.015), (900, 0.008))
# Hypotheses that are kept:
_SKIMMED = 600  # after the first look
_KEPT = 70  # after the second
_SHIFTED = 6  # for which shifts are tried
_FINAL = 60  # for finer tolerances
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
        """Return rotations and positions of cameras by a file's numbers, in the unit of depth.

        Args:
            R: (N, 3, 3) rotations as the file has them.
            t: (N, 3) translations, likewise.
        """
        if self.quaternion:
            from scipy.spatial.transform import Rotation  # slow to load

            numbers = Rotation.from_matrix(R).as_quat()[:, list(_QUATERNIONS[self.quaternion])]
            R = np.asarray(Rotation.from_quat(numbers).as_matrix())
        if self.transposed:
            R = R.swapaxes(1, 2)
        frames = np.clip(np.arange(len(R)) + self.shift, 0, len(R) - 1)
        R = R[frames]
        t = t[frames]
        if self.inverse:
            R, t = inverted(R, t)
        return R @ self.C, t / self.ratio

    def count_differences(self, other: "Convention") -> int:
        """Return in how many fields it differs from another one."""
        return sum(own != others for own, others in zip(self, other, strict=True))


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
        """Return the rotations and translations that the file has, of poses that were read by the words.

        These are rotations ``R_w_c`` (N, 3, 3) and positions ``t_w_c`` (N, 3).
        """
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
    misfit: Misfit | None = None  # how depth does not belong to its colours, or is no length
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
        agreement = f"{self.described(self.best.convention)}: agreement {self.best.mean:.2f}"
        if self.best is self.said:
            parts = [f"as said, {agreement}"]
        else:
            parts = [agreement, f"as said {self.said.mean:.2f}"]
        if self.following:
            parts.append(f"next best {self.following.mean:.2f}")
        unknown: dict[str, None] = {}  # each once, in the order of a convention's fields
        for name, *values in zip(_OPEN, self.best.convention, *self.tied, strict=True):
            if len(set(values)) > 1:
                unknown[name] = None
        if unknown:
            parts.append(f"cannot tell {', '.join(unknown)}")
        return f"pictures: {'; '.join(parts)}"

    def described(self, convention: Convention) -> str:
        """Return a convention in words."""
        metres, per_m = self.units(convention)
        parts = ["world-to-camera" if convention.inverse else "camera-to-world"]
        if convention.transposed:
            parts.append("rotations transposed")
        if convention.quaternion:
            parts.append(f"quaternions {convention.quaternion}")
        parts.append(f"axes {frame_of_axes(convention.C)}")
        if metres != 1:
            parts.append(f"positions in {_unit(metres)}")
        kind = "depth along the ray" if convention.along else "planar depth"
        parts.append(kind if per_m == 1 else f"{kind} of 1/{per_m:g} m")
        if convention.shift:
            late = "early" if convention.shift > 0 else "late"
            parts.append(f"poses {abs(convention.shift)} frames {late}")
        return ", ".join(parts)

    def units(self, convention: Convention) -> tuple[float, float]:
        """Return metres of one of positions as read, and whole numbers of depth in a metre.

        Depth is another where that makes its numbers known ones and plausible, else positions.
        """
        per_m = self.words.per_m / convention.ratio
        depth_m = self.median * convention.ratio
        is_depth = self.words.per_m != 1 or not _PLAUSIBLE[0] < self.median < _PLAUSIBLE[1]
        known = any(abs(per_m / common - 1) < 0.01 for common in _COMMON)
        if is_depth and known and _PLAUSIBLE[0] < depth_m < _PLAUSIBLE[1]:
            return self.words.metres, per_m
        return self.words.metres / convention.ratio, self.words.per_m

    def advice(self, layout: str) -> str:
        """Return the words to write in place of those that pictures contradict, in a layout."""
        assert self.best is not None
        right = self.best.convention
        _, per_m = self.units(right)
        turned = self._turned_pictures(layout)
        is_layout = _BY.get(layout, "layout") == "layout"
        keys = self._changed_keys(with_axes=is_layout or not turned)
        words = _changes_in_file(right)
        if turned and not is_layout:
            words.append(turned)
        if keys and is_layout:
            listed = ", ".join(f"{key}: {keys[key]}" for key in keys)
            words.append(f"poses: {{{listed}}} in a layout" + (f", or {turned}" if turned else ""))
        elif keys:
            words.append(self._change_of_poses(layout, keys))
        if (right.along, per_m) != (self.words.along, self.words.per_m):
            unit = {1.0: "m", 1000.0: "mm"}.get(per_m, f"1/{per_m:g}")
            words.append(f"--depth {'ray' if right.along else 'planar'}-{unit}")
        return " and ".join(words)

    def _changed_keys(self, with_axes: bool) -> dict[str, str]:
        """Return the keys of poses, as a layout has them, that pictures contradict, and what is right."""
        assert self.best is not None
        right = self.best.convention
        said = self.words.convention
        metres, _ = self.units(right)
        keys = {}
        if with_axes and right.axes != said.axes:
            keys["axes"] = frame_of_axes(right.C)
        if right.inverse != said.inverse:
            keys["inverse"] = str(right.inverse).lower()
        if metres != self.words.metres:
            keys["unit"] = _unit(metres).removesuffix(" m")
        return keys

    def _change_of_poses(self, layout: str, keys: Mapping[str, str]) -> str:
        """Return the options to write for some keys; what to do with the file where there are none."""
        has_options = "inverse" not in keys and keys.get("axes", "ned") in FRAMES
        if _BY[layout] == "options" and has_options:
            return " and ".join(f"--{key.replace('axes', 'frame')} {keys[key]}" for key in keys)
        direction = "world-to-camera" if self.words.inverse else "camera-to-world"
        return f"poses converted to {direction}, axes {self.words.axes}, and metres"

    def _turned_pictures(self, layout: str) -> str:
        """Return what to do where poses are as said, but pictures are mirrored or upside down; else empty."""
        assert self.best is not None
        change = self.words.convention.C.T @ self.best.convention.C
        how = ""
        for words, flip in _FLIPPED.items():
            if np.array_equal(change, np.diag(flip)):
                how = words
        if not how:
            return ""
        if self.best.mean < _OF_DEPTH_ALONE * self.best.of_depth:
            return f"depth {how} (colours are as they should be)"
        is_option = how.startswith("with left") and _BY.get(layout) == "options"
        return "--mirrored" if is_option else f"colours and depth {how}"


def _changes_in_file(right: Convention) -> list[str]:
    """Return what to do with the file of poses itself, as no option says it."""
    changes = []
    if right.quaternion:
        order = "qx qy qz qw" if right.quaternion == "w last" else "qw qx qy qz"
        changes.append(f"names of the columns, x y z {order}, above the poses")
    if right.transposed:
        changes.append("poses with their rotations transposed")
    if right.shift:
        later = "later" if right.shift > 0 else "earlier"
        changes.append(f"each pose at the picture {abs(right.shift)} frames {later}")
    return changes


def inverted(R: Array, t: Array) -> tuple[Array, Array]:
    """Return the inverses of poses: of rotations ``R`` (N, 3, 3) and translations ``t`` (N, 3)."""
    return R.swapaxes(1, 2), -np.einsum("nji,nj->ni", R, t)


def _unit(metres: float) -> str:
    for unit, word in _METRES.items():
        if abs(metres / unit - 1) < 1e-6:
            return word
    return f"{metres:.6g} m"


def _key(C: Array) -> tuple[float, ...]:
    return tuple((np.asarray(C).ravel() + 0.0).tolist())


def _signed_axes() -> Iterator[tuple[float, ...]]:
    """Yield all 48 axes that are those of the world in another order, with signs."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        yield _key(np.eye(3)[list(order)] * signs)


_AXES = tuple(_signed_axes())


class _Search:
    """Scores hypotheses on pairs of frames."""

    def __init__(self, pictures: PosedPictures, words: Words) -> None:
        self.pictures = pictures
        self.words = words
        self._file = words.written(pictures.R, pictures.t)
        self._motions: dict[Convention, tuple[Array, Array]] = {}
        self._scores: dict[tuple[int, float], dict[Convention, Score]] = {}

    def ranked(self, conventions: Iterable[Convention], points: int, tolerance: float) -> list[Score]:
        """Return the scores of hypotheses, the best first.

        Args:
            conventions: the hypotheses.
            points: of each pair that are compared.
            tolerance: of log depth.
        """
        known = self._scores.setdefault((points, tolerance), {})
        scores = []
        for convention in dict.fromkeys(conventions):
            if convention not in known:
                known[convention] = self._score(convention, points, tolerance)
            scores.append(known[convention])
        return sorted(scores, key=lambda score: -score.mean)

    def turned_colors(self, convention: Convention) -> str:
        """Return how to put colours right that are turned about their middle.

        They agree from picture to picture only then. Empty where they agree as they are, or do not tell.
        """
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

    def misfit(self, verdict: Verdict) -> Misfit | None:
        """Return how depth does not belong to its colours, or is no length, if pictures say so."""
        assert verdict.best is not None
        assert verdict.said is not None
        said = verdict.said.convention
        as_said = (self.pictures, self._motion(said), said.along, verdict.best.mean)
        misfit = misread(*as_said)
        if misfit is None:
            score = verdict.said if verdict.why else verdict.best
            _, per_m = verdict.units(score.convention)
            is_turned_asked = verdict.contradicts or not verdict.colors
            misfit = misplaced(self.pictures, self.words.per_m / per_m, is_turned_asked, verdict.best.mean)
        if misfit is None and not verdict.contradicts:
            misfit = unexplained(*as_said)
        return misfit

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
        how = (points, tolerance, convention.along)
        depth, grey = pictures.agreements(*self._motion(convention), how).T
        pairs = depth if pictures.grey is None else (depth + np.maximum(grey, 0)) / 2
        return Score(convention, pairs, float(pairs.mean()), float(depth.mean()))

    def hypotheses(self) -> Iterator[Convention]:
        """Yield all, but for kinds of depth and shifts."""
        said = self.words.convention
        per_m = self.words.per_m
        ratios = list(map(float, _RATIOS))
        if per_m in _COMMON and per_m != 1:
            ratios += [per_m / common for common in _COMMON if common > 1]
        ratios = list(dict.fromkeys(ratios))
        if self.words.fixed:
            for ratio in ratios:
                yield said._replace(ratio=ratio)
            return
        orders = [*_QUATERNIONS] if self.words.quaternions else [""]
        both = (False, True)
        for order, inverse, transposed, C, ratio in product(orders, both, both, _AXES, ratios):
            yield Convention(inverse, transposed, C, ratio, said.along, order)

    def likely(self) -> list[Convention]:
        """Return the hypotheses that bear a second look, of both kinds of depth, and the words themselves."""
        skimmed = _conventions(self.ranked(self.hypotheses(), *_SKIM)[:_SKIMMED])
        kept = _conventions(self.ranked(self._of_both_kinds(skimmed), *_LOOK)[:_KEPT])
        return kept + self._of_both_kinds([self.words.convention])

    def _of_both_kinds(self, conventions: Iterable[Convention]) -> list[Convention]:
        """Return hypotheses with depth along the ray, and planar, which panoramas have not."""
        kinds = (True,) if self.pictures.panorama else (False, True)
        both = []
        for convention, along in product(conventions, kinds):
            both.append(convention._replace(along=along))
        return both

    def shifted(self, scores: list[Score]) -> list[Convention]:
        """Return hypotheses by which poses come some frames early or late, and depth agrees better.

        Where depth does not agree better, colours are late, and not poses.
        """
        best = [self.words.convention, *_conventions(scores[:_SHIFTED])]
        trials = []
        for convention, frames in product(best, _SHIFTS):
            trials.append(convention._replace(shift=frames))
        unshifted = {score.convention: score.of_depth for score in scores}
        better = []
        for score in self.ranked(trials, *_READ[0]):
            if score.of_depth > unshifted[score.convention._replace(shift=0)]:
                better.append(score.convention)
        return better

    def refined(self, scores: list[Score]) -> list[Score]:
        """Return the scores of the best hypotheses by the finest tolerance that the best one bears."""
        first = scores[0]
        kept = [*_conventions(scores[:_FINAL]), self.words.convention]
        for finer in _READ[1:]:
            if self.ranked([scores[0].convention], *finer)[0].mean < _BEARS * first.mean:
                break
            scores = self.ranked(kept, *finer)
        return scores


def _conventions(scores: Iterable[Score]) -> list[Convention]:
    return [score.convention for score in scores]


def ask(pictures: PosedPictures, words: Words) -> Verdict:
    """Return which convention ``pictures`` support, whose poses were read by the ``words``."""
    surfaces = pictures.depth[pictures.depth > 0]
    if not len(surfaces):
        return Verdict(words, why="depth shows no surface")
    search = _Search(pictures, words)
    kept = search.likely()
    scores = search.ranked(kept, *_READ[0])
    if len(pictures.R) >= _LEAST_SHIFTED:
        scores = search.ranked(kept + search.shifted(scores), *_READ[0])
    scores = search.refined(scores)
    best = scores[0]
    tied = []
    others = []
    for score in scores:
        if _are_tied(best, score):
            tied.append(score)
        else:
            others.append(score)
    nearest = min(tied, key=lambda score: score.convention.count_differences(words.convention))
    said = next(score for score in scores if score.convention == words.convention)
    verdict = Verdict(
        words,
        best=nearest,
        said=said,
        following=others[0] if others else None,
        tied=tuple(score.convention for score in tied if score is not nearest),
        median=float(np.median(surfaces)),
        why=_doubt(pictures, best, is_as_said=nearest is said),
        colors=search.turned_colors(nearest.convention),
    )
    return replace(verdict, misfit=search.misfit(verdict))


def _doubt(pictures: PosedPictures, best: Score, is_as_said: bool) -> str:
    """Return why pictures cannot tell their convention; empty where they can.

    Args:
        pictures: with pairs.
        best: the convention that agrees best.
        is_as_said: whether it is that of the words, which chance did not choose among thousands.
    """
    count = len(np.unique(np.sort(pictures.pairs, axis=1), axis=0))
    by_chance = LEAST + CHANCE[pictures.grey is not None] / count**1.5
    if best.mean < LEAST:
        return f"they agree by {best.mean:.2f} at best"
    if best.mean < by_chance and not is_as_said:
        pairs = f"{count} pairs" if count > 1 else "one pair"
        return f"{pairs} agree by {best.mean:.2f} at best, which chance may give"
    return ""


def _are_tied(best: Score, other: Score) -> bool:
    """Return whether pairs do not tell two hypotheses apart."""
    difference = best.pairs - other.pairs
    margin = difference.mean()
    sigma = np.hypot(difference.std(), _SPREAD) / np.sqrt(len(difference))
    z = margin / sigma
    return bool(margin < _TIED or z < _TIED_SIGMA or (z < _NEAR_SIGMA and margin < _NEAR * best.mean))
