"""What pictures with poses and depth say of themselves: their convention, and what is off within it."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import one_of
from omniscv.diagnostics import Finding
from omniscv.diagnostics.posed_faults import LEAST_FRAMES, PAIRS, WIDTH, Fault, Fit, Found, Parameter
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.geometry import Array
from omniscv.importing.asking import read_pictures, words_of
from omniscv.importing.conventions import Words, ask
from omniscv.importing.overlap import PosedPictures, Shot, moves
from omniscv.importing.posed_frames import Options
from omniscv.importing.sequences import find_sequence, sequences
from omniscv.sources.base import Request, Source

OF_COLORS = (
    Parameter("focal length of colours", 4e-3, 4e-3, 0.14, "%", 100),
    Parameter("colours, x", 0.5, 1.0, 6.0, "px"),
    Parameter("colours, y", 0.5, 1.0, 6.0, "px"),
)
"""How colours may lie beside depth."""
# How agreement of colours is measured:
_POINTS = 900  # of a pair
_TOLERANCE = 0.03  # relative depth
# What decides that other colours fit better:
_GAIN = 0.2  # of what correlation lacks
_CLEAR = 3.0  # standard errors
_CLEARER = 0.05  # of correlation
_EXPLAINED = 0.5  # of what correlation lacks, which colours of another place or frame bring back
# Shares of sizes, and of what matters, that the search is off by:
_INEXACT = 0.1
_OF_MATTERS = 0.25
# Of a search for colours:
_REACHES = (1.0, 0.4)  # shares of the most that is likely
_TRIALS = 15  # of each parameter within them
_ROUNDS = 4  # of Newton's method from there
_BLOCKS = 8  # of pairs, for the standard error
_SIGMA = 5.0  # standard errors that prove a size
_OF_HALF = 0.5  # of a size, that each half of the pairs shows by itself
# Surfaces that are gone:
_BEHIND = 0.05  # share of the points, which may
_OF_SIGMA = 6.0  # of the noise of log depth
_LEAST_OFF = 0.03  # log depth
# Values of depth:
_PILED = 2e-3  # share of the pixels at one end that is doubted
_LIMITS = (*(2**bits - 1 for bits in (8, 10, 12, 13, 14, 15, 16, 24, 31, 32)), 65504, 1e10)
"""The largest numbers of types, sensors and programs."""
_SAME = 1e-6  # relative difference of equal depths
_STEPS = 0.2  # share of all values that are distinct, below which depth has steps
_COARSE = 0.01  # a step, as a share of depth
_SAMPLE = 200_000  # values
_WIDEST_DEG = 150.0  # field of view below which views of a recording are examined
_OVERLAP = "frames that see the same surfaces"
_CHECK = "check the file of poses, and the lens, that belong to these pictures"
_MOVES = "things move, or poses are wrong in places: frames of a still world"
_SHIFTS = {
    0: "",
    -1: "of 1 frames earlier",
    1: "of 1 frames later",
    -2: "of 2 frames earlier",
    2: "of 2 frames later",
    -3: "of 3 frames earlier",
    3: "of 3 frames later",
}
"""By how many frames colours are shifted for a trial, and its name."""
_FLIPS = {"": (1, 1), "mirrored": (-1, 1), "upside down": (1, -1), "turned by 180 degrees": (-1, -1)}


def examine_folder(path: Path, layout: str = "auto", **said: Any) -> list[Finding]:
    """Return findings on a folder of frames with poses and depth, which is read as an import reads it.

    Args:
        path: of the folder.
        layout: of the frames, as of an import.
        said: further options of the import.

    Raises:
        ArgumentError: no such folder, or no depth in it.
    """
    if not layout.endswith((".yaml", ".yml")):
        one_of("layout", layout, ("auto", *sequences()))
    sequence = find_sequence(path, layout, Options(**said))
    words = None if sequence is None else words_of(sequence)
    if sequence is None or words is None:
        expected = "expected a recording, captures, or frames with poses and depth"
        raise ArgumentError(f"{path}: {expected}, got others; --layout my.yaml describes a folder")
    pictures = read_pictures(sequence, PAIRS, WIDTH)
    return [Finding("frames", line) for line in sequence.lines()] + examine_pictures(pictures, words)


def examine_views(source: Source) -> list[Finding]:
    """Examine whether the views of a recording agree with each other: poses, lens, scale of depth.

    Views from a single centre have no parallax: there are no findings on them.

    Args:
        source: the recording; its views below ``_WIDEST_DEG`` that have depth are examined.
    """
    views = [view for view in source.recorded_in("depth") if view.fov_deg < _WIDEST_DEG]
    centers_w = {tuple(view.pose.position) for view in views}
    if len(centers_w) < 2:
        return []

    def read(i: int, width: int) -> Shot | None:
        """Return the picture of the view ``i``, at most ``width`` px wide; None without depth."""
        pixels: dict[str, Any] = {}
        for mode in ("depth", "lit"):
            with suppress(MissingCaptureError):
                (capture,) = source.capture([Request(views[i], mode, source.state)])
                pixels[mode] = capture.pixels
        depth = pixels.get("depth")
        lit = pixels.get("lit")
        return None if depth is None else Shot.of(depth, lit, views[i].projection, width)

    R_w_c = np.stack([view.pose.R_w_c for view in views])
    t_w_c = np.stack([view.pose.t_w_c for view in views])
    fov = float(np.radians(min(view.fov_deg for view in views)))
    pictures = PosedPictures.read(R_w_c, t_w_c, read, fov, PAIRS, WIDTH)
    return examine_pictures(pictures, Words())


def examine_pictures(pictures: PosedPictures | None, words: Words) -> list[Finding]:
    """Return the convention that ``pictures`` support, and what is off within it.

    ``words`` are what is said of the convention; pictures are None if no two frames overlap.
    """
    if pictures is None:
        return [Finding("convention", "no two frames overlap", "warning", _OVERLAP)]
    verdict = ask(pictures, words)
    value = verdict.line().removeprefix("pictures").lstrip(": ")
    misfits = []
    if verdict.misfit is not None:
        misfits.append(Finding("depth", verdict.misfit.shows, "bad", verdict.misfit.remedy))
    if verdict.why or verdict.best is None:
        return [Finding("convention", value, "warning", _OVERLAP), *misfits, *_values(pictures, words)]
    remedy = f"write {verdict.advice('')}"
    findings = [Finding.unless(not verdict.contradicts, "convention", value, "bad", remedy), *misfits]
    R, t = verdict.best.convention.poses(*words.written(pictures.R, pictures.t))
    along = verdict.best.convention.along
    findings += _colors(pictures, R, t, along)
    if len(R) >= LEAST_FRAMES:
        findings += _faults(find(pictures, R, t, along))
    else:
        findings.append(Finding("faults", f"none is named from fewer than {LEAST_FRAMES} frames"))
    return [*findings, *_values(pictures, words)]


def find(pictures: PosedPictures, R: Array, t: Array, along: bool) -> Found:
    """Return the faults of pictures: of depth and poses, or else of colours, which need both.

    Args:
        pictures: with pairs.
        R: (N, 3, 3) rotations of all frames, camera to world.
        t: (N, 3) their positions, in the unit of depth.
        along: whether depth is along the ray.
    """
    found = Fit(pictures, R, t, along).find()
    if found.faults or not found.is_turning:
        return found
    return found._replace(faults=_colors_beside(pictures, R, t, along))


def _faults(found: Found) -> Iterator[Finding]:
    """Yield what is off, the noise, and whether things move."""
    off = found.left[np.isfinite(found.left)]
    if not off.size:
        yield Finding("faults", "too few points are seen twice", "warning", "frames that overlap more")
        return
    for parameter, size, sigma, others in found.faults:
        scale = parameter.scale
        value = f"off by {scale * size:+.3g} +- {scale * sigma:.1g} {parameter.unit}".rstrip()
        if others:
            value += f"; or explained by {' or '.join(other.name for other in others)}"
        yield Finding(parameter.name, value, "bad", _CHECK)
    if not found.faults:
        yield Finding("lens, scale and time", "nothing is off beyond doubt")
    noise = 1.4826 * float(np.median(np.abs(off[np.abs(off) < _LEAST_OFF])))
    drift = found.drift
    value = f"depth {noise:.2%}; poses of frames {np.degrees(drift):.2g} degrees, {drift:.2g} of depth"
    yield Finding("noise", value)
    share = float((off > max(_OF_SIGMA * noise, _LEAST_OFF)).mean())
    yield Finding.unless(share < _BEHIND, "surfaces that are gone", f"{share:.1%}", "warning", _MOVES)


def _colors(pictures: PosedPictures, R: Array, t: Array, along: bool) -> Iterator[Finding]:
    """Yield whether colours belong to depth: as they are, not mirrored, and of the same frame."""
    if pictures.grey is None:
        return
    frames = pictures.frames
    scores: dict[str, Array] = {}
    motion = moves(R[frames], t[frames], pictures.pairs)
    for shift, late in _SHIFTS.items():
        if shift != 0 and np.isin(frames + shift, frames).mean() <= 0.6:
            continue
        shifted = np.abs(frames[:, None] - (frames + shift)).argmin(axis=0)
        others = replace(pictures, grey=pictures.grey[shifted])
        for name, flip in _FLIPS.items():
            score = others.agreements(*motion, (_POINTS, _TOLERANCE, along), (*flip, 0, 0))[:, 1]
            scores[" and ".join(filter(None, (name, late)))] = score
    best = max(scores, key=lambda name: float(scores[name].mean()))
    unchanged = scores[""]
    better = scores[best] - unchanged
    signs = np.sign(better).sum() / np.sqrt(len(better))  # standard deviations, if either were as likely
    correlation = f"correlation {unchanged.mean():.2f}"
    lacking = _EXPLAINED * (1 - unchanged.mean())
    if best and better.mean() > max(_CLEARER, lacking) and signs > _CLEAR:
        value = f"{best}: {scores[best].mean():.2f}"
        remedy = "give each depth the colours of its own frame"
        yield Finding("colours over depth", f"{value}; as said {correlation}", "bad", remedy)
    else:
        yield Finding("colours over depth", correlation)


def _colors_beside(pictures: PosedPictures, R: Array, t: Array, along: bool) -> list[Fault]:
    """Return by how much colours lie beside depth: where they agree best from picture to picture."""
    if pictures.grey is None:
        return []
    motion = moves(R[pictures.frames], t[pictures.frames], pictures.pairs)

    def scores(x: Array) -> Array:
        scale = float(np.exp(x[0]))
        return pictures.agreements(*motion, (_POINTS, _TOLERANCE, along), (scale, scale, x[1], x[2]))[:, 1]

    before = scores(np.zeros(3))
    steps = np.array([2 / pictures.depth.shape[2], 0.5, 0.5])  # px, at a quarter of the width
    x, sigma = _refined(scores, _searched(scores), steps)
    halves = []  # what each half of the pairs shows by itself
    for rows in (slice(None, None, 2), slice(1, None, 2)):
        halves.append(_refined(partial(_of_rows, scores, rows), x, steps)[0])
    better = scores(x) - before
    if better.mean() < max(_GAIN * (1 - before.mean()), _CLEAR * better.std() / np.sqrt(len(better))):
        return []
    faults = []
    for parameter, size, error, *of_halves in zip(OF_COLORS, x, sigma, *halves, strict=True):
        if abs(size) > parameter.most or min(np.sign(size) * np.array(of_halves)) < _OF_HALF * abs(size):
            continue  # beyond what is likely, or not in either half
        inexact = np.hypot(_INEXACT * size, _OF_MATTERS * parameter.matters)
        fault = Fault(parameter, float(size), float(np.hypot(error, inexact)))
        if abs(fault.size) > max(parameter.matters, _SIGMA * fault.sigma):
            faults.append(fault)
    return faults


def _of_rows(scores: Callable[[Array], Array], rows: slice, x: Array) -> Array:
    """Return the scores at ``x`` of some rows of the pairs."""
    return scores(x)[rows]


def _searched(scores: Callable[[Array], Array]) -> Array:
    """Return (3,) values of :data:`OF_COLORS` with the best score of a search, one after the other."""
    x = np.zeros(3)
    for reach in _REACHES:
        for axis, parameter in zip(np.eye(3), OF_COLORS, strict=True):
            trials = x + axis * np.linspace(-reach, reach, _TRIALS)[:, None] * parameter.most
            x = max([x, *trials], key=lambda trial: float(scores(trial).mean()))
    return x


def _refined(scores: Callable[[Array], Array], x: Array, steps: Array) -> tuple[Array, Array]:
    """Return values (3,) at which scores have no slope, and their standard errors, by Newton's method.

    ``steps`` (3,) are those of derivatives.
    """
    axes = np.diag(steps)

    def slopes_at(x: Array) -> Array:
        return np.stack([scores(x + step) - scores(x - step) for step in axes], axis=-1) / 2

    sigma = np.zeros(3)
    for _ in range(_ROUNDS):
        slopes = slopes_at(x)
        bends = []
        for step in axes:
            bends.append((slopes_at(x + step) - slopes_at(x - step)).mean(axis=0) / 2)
        mean = slopes.mean(axis=0)
        inverse = np.linalg.pinv(np.stack(bends))
        x = x - steps * np.clip(inverse @ mean, -3, 3)
        blocks = []
        for block in np.array_split(slopes - mean, _BLOCKS):
            blocks.append(block.sum(axis=0))
        sigma = steps * np.linalg.norm(np.stack(blocks) / len(slopes) @ inverse, axis=0)
    return x, sigma


def _is_limit(metres: float, per_m: float) -> bool:
    """Return whether depth has at most two digits, or is the largest number of a type in a file."""
    two_digits = float(f"{metres:.1e}")
    if abs(metres / two_digits - 1) < _SAME:
        return True
    return any(abs(metres / (number / per_m) - 1) < _SAME for number in _LIMITS)


def _values(pictures: PosedPictures, words: Words) -> Iterator[Finding]:
    """Yield what values of depth say: a maximum or minimum that stands for none, steps.

    The least and the greatest are true depth in level pictures of flat ground, of which a row has either:
    only limits of a type and round numbers of metres, as those of a sensor's range, are doubted.
    """
    values = pictures.depth[pictures.depth > 0]
    different = np.unique(values)
    if different.size < 2:
        return
    for name, end in (("greatest", different[-1]), ("least", different[0])):
        share = float((np.abs(values / end - 1) < _SAME).mean())
        if share > _PILED and _is_limit(float(end), words.per_m):
            remedy = f"if it stands for no surface, --missing with its number in the file ({end:.6g} m)"
            yield Finding("values of depth", f"{share:.1%} have the {name}, {end:.6g}", "warning", remedy)
    drawn = np.random.default_rng(0).choice(values, min(values.size, _SAMPLE), replace=False)
    different = np.unique(drawn)
    middle = float(np.median(drawn))
    if 1 < different.size < _STEPS * drawn.size:
        near = different[np.abs(different / middle - 1) < 0.1]
        step = float(np.median(np.diff(near if near.size > 1 else different)))
        value = f"{step:.3g} at {middle:.3g}"
        yield Finding.unless(
            step < _COARSE * middle, "steps of depth", value, "warning", "depth with more bits"
        )
