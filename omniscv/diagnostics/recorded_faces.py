"""Examine the cubes of a recording: do their faces agree at the edges, and what would mend it?

A slip is a face that is turned by a fraction of a degree: fine texture is shifted along its edges. Oblique
lines move along an edge with every row, too, so what the rows of one face say is subtracted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.compose.seams import SIDES, Cube, estimate_gains
from omniscv.diagnostics import Finding
from omniscv.errors import MissingCaptureError
from omniscv.geometry import Array, Pose, cube_rotations
from omniscv.planning import RecordedViews
from omniscv.sources.base import Request, Source, View

_STEP = 2.0  # levels across an edge that show
_BAD_STEP = 10.0
_BLUR_PX = 15  # on both sides: slower changes along an edge are no texture
_BLUR = np.full(2 * _BLUR_PX + 1, 1 / (2 * _BLUR_PX + 1))
_ROWS = 3  # from which the direction of lines is taken
_MOST_SLIP = 1 / 128  # of a face's width
_TEXTURE, _ALIKE = 1.0, 0.6  # levels of texture, and correlation, that show a shift
_SLIP_PX, _NOISE_PX = 0.6, 0.1  # pictures without anti-aliasing shift texture by half a pixel
_LEAST_PX = 512  # of a face: smaller ones are turned by less than their pixels show
_SLIP_DEG, _PROVEN = 0.05, 2  # the least turn, and the edges on which it is seen
_AT_SOURCE = "record with manual exposure, without vignette, bloom and screen-space reflections"


class Place(NamedTuple):
    """What the faces of one optical centre say.

    Attributes:
        center: (x, y, z) metres.
        steps: (12,) levels across the edges, less those inside faces.
        gains: factors of light that would bring faces together; None if they explain too little.
        explained: share of the steps that gains explain.
        slips: by the name of the nearest face, degrees by which it is turned.
    """

    center: tuple[float, ...]
    steps: Array
    gains: Array | None
    explained: float
    slips: dict[str, float]


def examine_recording(source: Source) -> list[Finding]:
    """Return what the cubes of colours in a recording say of seams, exposure and slips."""
    places = list(measure_places(source))
    if not places:
        return [Finding("seams", "no cube of six faces in colour")]
    steps = np.concatenate([place.steps for place in places])
    worst = max(places, key=lambda place: float(place.steps.max()))
    at = ", ".join(f"{value:.4g}" for value in worst.center)
    value = (
        f"{len(places)} cubes: steps across edges {np.median(steps):.2f} levels (median), "
        f"{np.quantile(steps, 0.9):.1f} (90 %), {steps.max():.1f} at ({at}) m"
    )
    remedy = f"{_AT_SOURCE}; or render with seams: close"
    if steps.max() <= _STEP:
        found = Finding("seams", value)
    else:
        found = Finding("seams", value, "bad" if steps.max() > _BAD_STEP else "warning", remedy)
    return [found, *_exposure(places), *_slips(places)]


def measure_places(source: Source) -> Iterator[Place]:
    """Yield what is measured at each optical centre with six faces in colour."""
    views = source.recorded_views() or ()
    recorded = RecordedViews(views)
    for center in recorded.centers():
        six = [View(Pose(np.array(center), R_w_c), 90, 1, 1) for _, R_w_c in cube_rotations()]
        faces = recorded.faces(np.array(center), six)
        try:
            captures = list(source.capture(Request(view, "lit", source.state) for view in faces))
        except MissingCaptureError:
            continue  # recorded in other modes only
        cube = Cube.of([capture.view for capture in captures], [capture.pixels for capture in captures])
        if cube is not None:
            transfer = source.capabilities.transfer
            gains = estimate_gains(cube, "srgb" if transfer == "unknown" else transfer)
            yield Place(
                center, cube.steps(), gains.gains if gains.proven else None, gains.explained, slips(cube)
            )


def slips(cube: Cube) -> dict[str, float]:
    """Return the faces that are turned against the others, proven on two edges, and by how many degrees.

    Nothing for faces of less than 512 px.
    """
    if cube.pixels.shape[1] < _LEAST_PX:
        return {}
    turns, seen = turns_of(cube)
    names, axes = zip(*((name, R_w_c[:, 2]) for name, R_w_c in cube_rotations()), strict=True)
    angles = np.degrees(np.linalg.norm(turns, axis=1))
    return {
        names[int(np.argmax(axes @ view.pose.R_w_c[:, 2]))]: float(angle)
        for view, angle, edges in zip(cube.views, angles, seen, strict=True)
        if angle > _SLIP_DEG and edges >= _PROVEN
    }


def turns_of(cube: Cube) -> tuple[Array, NDArray[np.int64]]:
    """Return how faces are turned against the others, by the shift of fine texture along their edges.

    Returns:
        (6, 3) rotation vectors, world frame, radians, of few faces; and (6,) on how many edges each turn is
        seen.
    """
    edges, rows, shifts = [], [], []
    for edge in cube.edges:
        a, b = (lines.mean(axis=-1) for lines in cube.lines(edge, _ROWS + 1))
        moved = [_shift_along(a[0], b[0]), _shift_along(a[-1], a[0]), _shift_along(b[0], b[-1])]
        if not np.isnan(moved).any():
            view = cube.views[edge.a]
            middle = view.pose.R_w_c @ np.add(SIDES[edge.side_a], (0, 0, 1))
            along = view.pose.R_w_c @ np.cross((0, 0, 1), SIDES[edge.side_a])
            # A face that is turned by w shows a direction d where d - w x d would be.
            row = np.zeros((6, 3))
            row[edge.a] = np.cross(middle, along) * view.focal_px
            row[edge.b] = -row[edge.a]
            edges.append(edge)
            rows.append(row)
            shifts.append(moved[0] - (moved[1] + moved[2]) / (2 * _ROWS))
    if not rows:
        return np.zeros((6, 3)), np.zeros(6, np.int64)
    A, y = np.array(rows), np.array(shifts)
    turns = _few_turns(A, y)
    of_face = (A * turns).sum(axis=2)  # (edges, 6) px that each face's turn explains
    explained = np.abs(of_face.sum(axis=1) - y) < np.abs(y) / 2
    proof = (np.abs(y) > _SLIP_PX) & explained
    return turns, (proof[:, None] & (np.abs(of_face) > np.abs(y)[:, None] / 2)).sum(axis=0)


def _shift_along(a: Array, b: Array) -> float:
    """Px by which b (s,) shows the texture of a (s,) farther along; NaN where there is too little."""
    one, other = (
        line - np.convolve(np.pad(line, _BLUR_PX, "edge"), _BLUR, "valid")[: len(line)] for line in (a, b)
    )
    most = max(2, round(_MOST_SLIP * len(a)))
    inner = one[most : len(a) - most]
    alike = []
    for shift in range(-most, most + 1):
        there = other[most + shift : len(a) - most + shift]
        alike.append((inner * there).sum() / max(np.sqrt((inner**2).sum() * (there**2).sum()), 1e-9))
    best = int(np.argmax(alike))
    if inner.std() < _TEXTURE or alike[best] < _ALIKE or not 0 < best < 2 * most:
        return float("nan")
    before, here, after = alike[best - 1 : best + 2]
    return float(best - most + (before - after) / (2 * (before - 2 * here + after)))


def _few_turns(A: Array, y: Array) -> Array:
    """(6, 3) turns of few faces that explain shifts y: least squares, reweighted by the size of each turn."""
    flat = A.reshape(len(A), 18)
    x, weights = np.zeros(18), np.ones(18)
    for _ in range(20):
        scaled = flat * weights
        x = weights * (scaled.T @ np.linalg.solve(scaled @ scaled.T + _NOISE_PX**2 * np.eye(len(A)), y))
        size = np.linalg.norm(x.reshape(6, 3), axis=1)
        weights = np.repeat(np.sqrt((size + 1e-6) / (size.max() + 1e-6)), 3)
    return x.reshape(6, 3)


def _exposure(places: Sequence[Place]) -> Iterator[Finding]:
    drifts = [place.gains for place in places if place.gains is not None]
    explained = max(place.explained for place in places)
    if not drifts:
        yield Finding("exposure", f"explains {100 * explained:.0f} % of the steps at most")
        return
    most = max(float(gains.max() / gains.min()) for gains in drifts)
    value = f"differs by up to {most:.3g} between faces of one centre, at {len(drifts)} of {len(places)}"
    yield Finding("exposure", value, "warning", "record with manual exposure; or render with seams: gains")


def _slips(places: Sequence[Place]) -> Iterator[Finding]:
    by_face: dict[str, list[float]] = {}
    for place in places:
        for name, angle in place.slips.items():
            by_face.setdefault(name, []).append(angle)
    for name, angles in by_face.items():
        value = (
            f"the {name} face is turned by {np.median(angles):.2f} degrees at {len(angles)} of {len(places)}"
        )
        yield Finding(
            "slip", value, "warning", "check the pose that was set against the one that was captured"
        )
