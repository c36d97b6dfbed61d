"""What pictures with poses and depth say of themselves: their convention, and what is off within it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import one_of
from omniscv.diagnostics import Finding
from omniscv.diagnostics.posed_faults import (
    COLOR,
    COLOR_X,
    COLOR_Y,
    LEAST_FRAMES,
    OF_COLOR,
    OF_PANORAMA,
    PAIRS,
    PARAMETERS,
    ROLLING,
    TIME,
    WIDTH,
    Fault,
    Fit,
    Normal,
)
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.geometry import Array
from omniscv.sources.base import Request, Source
from omniscv.sources.recording.asking import read_pictures, words_of
from omniscv.sources.recording.conventions import Verdict, Words, ask, placed
from omniscv.sources.recording.overlap import Indices, PosedPictures, Shot, agreement, moves
from omniscv.sources.recording.posed_frames import Options
from omniscv.sources.recording.sequences import find_sequence, sequences

_POINTS, _TOLERANCE = 900, 0.03
_CLEAR, _CLEARER = 4.0, 0.05  # standard errors, and correlation, by which other colours fit better
_PILED, _BEHIND, _OF_SIGMA, _LEAST_OFF = 2e-3, 0.05, 6.0, 0.03
_STEPS, _COARSE = 0.2, 0.01  # distinct values of all; a step, as a share of depth
_SAMPLE = 200_000
_FEWER = 0.8  # of the differences of colours, which remain if they are put right
_AT_SOURCE = "check the file of poses, and the lens, that belong to these pictures"


def examine_folder(path: Path, layout: str = "auto", **said: Any) -> list[Finding]:
    """Return findings on a folder of frames with poses and depth, which is read as an import reads it.

    Raises:
        ArgumentError: no such folder, or no depth in it.
    """
    if not layout.endswith((".yaml", ".yml")):
        one_of("layout", layout, ("auto", *sequences()))
    sequence = find_sequence(path, layout, Options(**said))
    words = words_of(sequence) if sequence else None
    if sequence is None or words is None:
        expected = "expected a recording, captures, or frames with poses and depth"
        raise ArgumentError(f"{path}: {expected}, got others; --layout my.yaml describes a folder")
    pictures = read_pictures(sequence, PAIRS, WIDTH)
    return [Finding("frames", line) for line in sequence.lines()] + examine_pictures(pictures, words)


def examine_views(source: Source) -> list[Finding]:
    """Return findings on the views of a recording that have depth, from several centres; else none."""
    views = [view for view in source.recorded_in("depth") if view.fov_deg < 150]
    centers = {tuple(view.pose.position) for view in views}
    if len(centers) < 2:
        return []

    def read(i: int, width: int) -> Shot | None:
        view, pixels = views[i], dict[str, Any]()
        for mode in ("depth", "lit"):
            if view in source.recorded_in(mode):
                try:
                    (capture,) = source.capture([Request(view, mode, source.state)])
                except MissingCaptureError:
                    continue
                pixels[mode] = capture.pixels
        return (
            Shot.of(pixels["depth"], pixels.get("lit"), view.projection, width) if "depth" in pixels else None
        )

    R = np.stack([view.pose.R_w_c for view in views])
    t = np.stack([view.pose.position for view in views])
    fov = float(np.radians(min(view.fov_deg for view in views)))
    return examine_pictures(PosedPictures.read(R, t, read, fov, PAIRS, WIDTH), Words())


def examine_pictures(pictures: PosedPictures | None, words: Words) -> list[Finding]:
    """Return the convention that pictures support, and what is off within it."""
    if pictures is None:
        return [
            Finding("convention", "no two frames overlap", "warning", "frames that see the same surfaces")
        ]
    verdict = ask(pictures, words)
    value = verdict.line().removeprefix("pictures").lstrip(": ")
    findings = [
        Finding.unless(not verdict.contradicts, "convention", value, "bad", f"write {_advice(verdict)}")
    ]
    if verdict.why or verdict.best is None:
        return [
            Finding("convention", value, "warning", "frames that see the same surfaces"),
            *_values(pictures),
        ]
    along = verdict.best.convention.along
    R, t = placed(verdict.best.convention, words, pictures)
    findings += _colors(pictures, R, t, along)
    if len(R) >= LEAST_FRAMES:
        findings += _faults(Fit(pictures, R, t, along))
    else:
        findings.append(Finding("faults", f"none is named from fewer than {LEAST_FRAMES} frames"))
    return [*findings, *_values(pictures)]


def _advice(verdict: Verdict) -> str:
    return verdict.advice("layout") if verdict.contradicts else ""


def _faults(fit: Fit) -> Iterator[Finding]:
    found, normal = find(fit)
    for fault in found:
        what = PARAMETERS[fault.parameter]
        value = (
            f"off by {what.scale * fault.size:+.3g} +- {what.scale * fault.sigma:.1g} {what.unit}".rstrip()
        )
        if fault.others:
            names = " or ".join(PARAMETERS[other].name for other in fault.others)
            value += f"; or explained by {names}"
        yield Finding(what.name, value, "bad", _AT_SOURCE)
    if normal is None:
        yield Finding("faults", "too few points are seen twice", "warning", "frames that overlap more")
        return
    if not found:
        yield Finding("lens, scale and time", "nothing is off beyond doubt")
    noise = np.nanmedian(np.abs(normal.depth[np.abs(normal.depth) < _LEAST_OFF])) * 1.4826
    turn, move = np.degrees(normal.pose[0]), normal.pose[3]
    yield Finding("noise", f"depth {noise:.2%}; poses of pairs {turn:.2g} degrees, {move:.2g} of its unit")
    yield _moving(normal, float(noise))


def find(fit: Fit) -> tuple[list[Fault], Normal | None]:
    """Return the faults of pictures: of depth and poses, then of colours."""
    possible = [*OF_PANORAMA] if fit.pictures.panorama else [*range(13)]
    possible = [i for i in possible if fit.is_video or i not in (TIME, ROLLING)]
    of_depth, of_color = [i for i in possible if i not in OF_COLOR], [i for i in possible if i in OF_COLOR]
    found, theta, normal = fit.faults(np.zeros(13), of_depth, True, False)
    if fit.pictures.grey is None or normal is None:
        return found, normal
    before = fit.color_cost(theta)
    colors, theta, _ = fit.faults(_near_colors(fit, theta, of_color), of_color, False, True)
    clearly = fit.color_cost(theta) < _FEWER * before
    return [*found, *(colors if clearly else [])], normal


def _near_colors(fit: Fit, theta: Array, candidates: list[int]) -> Array:
    """Return parameters near which colours fit: they may lie far beside depth."""
    start = best = fit.color_cost(theta)
    result = theta
    for share in (1.0, 0.4):
        for c, reach, count in ((COLOR, 0.14, 15), (COLOR_X, 6, 9), (COLOR_Y, 6, 9)):
            for by in share * np.linspace(-reach, reach, count) if c in candidates else ():
                trial = result.copy()
                trial[c] += by
                if (value := fit.color_cost(trial)) < best - 0.002:
                    best, result = value, trial
    return result if best <= _FEWER * start else theta


def _moving(normal: Normal, noise: float) -> Finding:
    off = normal.depth[np.isfinite(normal.depth)]
    share = float((off > max(_OF_SIGMA * noise, _LEAST_OFF)).mean())
    remedy = "things move, or poses are wrong in places: frames of a still world"
    return Finding.unless(share < _BEHIND, "surfaces that are gone", f"{share:.1%}", "warning", remedy)


def _colors(pictures: PosedPictures, R: Array, t: Array, along: bool) -> Iterator[Finding]:
    """Yield whether colours belong to depth: as they are, not mirrored, and of the same frame."""
    if pictures.grey is None:
        return
    motion = moves(R[pictures.frames], t[pictures.frames], pictures.pairs)
    flips = {"": (1, 1), "mirrored": (1, -1), "upside down": (-1, 1), "turned by 180 degrees": (-1, -1)}
    shifts = [
        by for by in range(-3, 4) if by == 0 or np.isin(pictures.frames + by, pictures.frames).mean() > 0.6
    ]
    scores = dict[tuple[str, int], Array]()
    for (name, (down, across)), by in product(flips.items(), shifts):
        at = np.abs(pictures.frames[:, None] - (pictures.frames + by)).argmin(axis=0)
        grey = np.ascontiguousarray(pictures.grey[at][:, ::down, ::across])
        scores[name, by] = _correlation(pictures, grey, motion, along)
    best = max(scores, key=lambda key: float(scores[key].mean()))
    better = scores[best] - scores["", 0]
    margin, sigma = better.mean(), better.std() / np.sqrt(len(better)) + 1e-9
    said = f"correlation {scores['', 0].mean():.2f}"
    if best == ("", 0) or margin < max(_CLEARER, _CLEAR * sigma):
        yield Finding("colours over depth", said)
        return
    name, by = best
    late = f"of {abs(by)} frames {'later' if by > 0 else 'earlier'}" if by else ""
    value = (
        f"{' and '.join(word for word in (name, late) if word)}: {scores[best].mean():.2f}; as said {said}"
    )
    yield Finding("colours over depth", value, "bad", "give each depth the colours of its own frame")


def _correlation(pictures: PosedPictures, grey: Any, motion: Array, along: bool) -> Array:
    points = replace(pictures, grey=grey).points(_POINTS)
    second: Indices = pictures.pairs[:, 1].copy()
    how = (along, pictures.panorama, _TOLERANCE)
    return np.asarray(agreement(points, motion, second, pictures.depth, grey, pictures.lenses, how)[:, 1])


def _values(pictures: PosedPictures) -> Iterator[Finding]:
    """Yield what values of depth say: a maximum or minimum that stands for none, steps."""
    values = pictures.depth[pictures.depth > 0]
    if not values.size:
        return
    piled = [(name, end) for name, end in (("greatest", values.max()), ("least", values.min()))]
    for name, end in piled:
        share = float((np.abs(values / end - 1) < 1e-6).mean())
        if share > _PILED and values.min() < values.max():
            remedy = f"if it stands for no surface, --missing with its number in the file ({end:.6g} m)"
            yield Finding("values of depth", f"{share:.1%} have the {name}, {end:.6g}", "warning", remedy)
    drawn = np.random.default_rng(0).choice(values, min(values.size, _SAMPLE), replace=False)
    different = np.unique(drawn)
    if 1 < different.size < _STEPS * drawn.size:
        near = different[np.abs(different / np.median(drawn) - 1) < 0.1]
        step = float(np.median(np.diff(near))) if near.size > 1 else float(np.median(np.diff(different)))
        share = step / float(np.median(drawn))
        value = f"{step:.3g} at {np.median(drawn):.3g}"
        yield Finding.unless(share < _COARSE, "steps of depth", value, "warning", "depth with more bits")
