"""What a cube map's seams will look like: six faces, and twelve views that look straight at an edge.

At an edge two faces meet with their borders, and a third view has it in its middle. All three see the same
surfaces, so whatever they differ by is the camera's doing: a gain for each picture (exposure), and a loss
that grows from the middle to the corners (vignette).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from omniscv.captures.unreal.bare_camera import BareCamera
from omniscv.captures.unreal.finding import Finding
from omniscv.captures.unreal.turning import Look, inside, places, sample, view_of
from omniscv.geometry import Array

FACES = {
    "front": (0, 0),
    "left": (90, 0),
    "back": (180, 0),
    "right": (-90, 0),
    "up": (0, 90),
    "down": (0, -90),
}
"""Yaw to the left and pitch, degrees."""

EDGES = {
    ("front", "left"): (45, 0), ("left", "back"): (135, 0),
    ("back", "right"): (-135, 0), ("right", "front"): (-45, 0),
    ("front", "up"): (0, 45), ("left", "up"): (90, 45), ("back", "up"): (180, 45), ("right", "up"): (-90, 45),
    ("front", "down"): (0, -45), ("left", "down"): (90, -45),
    ("back", "down"): (180, -45), ("right", "down"): (-90, -45),
}  # fmt: skip
"""The faces on either side, and where the view between them looks."""

_STRIP = 1 / 32
"""How far beside a seam pictures are compared, of their width."""
_LEAST_PIXELS = 64
_DARK, _BRIGHT = 16, 240
"""Grey levels between which rounding and clipping do not matter."""
_SEAM_LEVELS = 2.0
"""A seam of fewer grey levels of 255 is not seen, and may come from textures."""
_SHARE = 0.02
"""The vignette or exposure difference that is 2 % of the light: some 2 or 3 grey levels."""
_CURE = "record --fix-exposure"
_OTHERS = "vrun r.BloomQuality 0, r.LensFlareQuality 0, r.SSR.Quality 0, r.PostProcessAAQuality 0"
"""What else differs between pictures of one surface (protocol reference, section 7.1)."""


@dataclass(frozen=True)
class Light:
    """What spoils the light of a cube map.

    Attributes:
        seams: by the faces' names, the grey levels by which the three pictures of an edge differ there; NaN
            where they do not see it.
        vignette: how much less light the corners have than the middle, 0 to 1; NaN where nothing was seen.
        exposure: how much the gains of pictures of the same surfaces differ, 0 is equal; NaN likewise.
    """

    seams: dict[tuple[str, str], float]
    vignette: float
    exposure: float


def measure(camera: BareCamera) -> Light:
    """Captures faces and edges, and compares them."""
    faces = {name: _look(camera, *angles) for name, angles in FACES.items()}
    seams, overlaps = {}, []
    for pair, (yaw, pitch) in EDGES.items():
        edge = _look(camera, yaw, pitch)
        both = [_overlap(faces[name], edge, camera.fov_deg, upright=pitch == 0) for name in pair]
        seams[pair] = _seam(*both)
        overlaps += both
    return Light(seams, *_fit(overlaps))


def findings(light: Light) -> list[Finding]:
    """One finding for exposure, one for vignette, one for each seam."""
    drift = f"vrun r.EyeAdaptationQuality 0, or {_CURE}"
    shade = f"vrun r.Tonemapper.Quality 1, or {_CURE}, or crop: --overscan"
    first = [
        _share("exposure", light.exposure, "{:.1%} between pictures of one surface", drift),
        _share("vignette", light.vignette, "corners {:.1%} darker than the middle", shade),
    ]
    cure = _CURE if any(finding.verdict == "bad" for finding in first) else _OTHERS
    return [*first, *(_step("|".join(pair), levels, cure) for pair, levels in light.seams.items())]


@dataclass(frozen=True)
class _Overlap:
    """What a face and the view at its edge both see, pixel by pixel of the face.

    Attributes:
        face, edge: (N,) grey in each.
        t_face, t_edge: (N,) squared distance from the picture's middle, 1 in the corners.
        near: (N,) whether it is beside the seam.
    """

    face: Array
    edge: Array
    t_face: Array
    t_edge: Array
    near: NDArray[np.bool_]


def _look(camera: BareCamera, yaw_deg: float, pitch_deg: float) -> Look:
    pose = camera.go(yaw_deg, pitch_deg)
    return Look(camera.pixels("lit") @ np.array((0.5, 0.3, 0.2)), pose)


def _overlap(face: Look, edge: Look, fov_deg: float, upright: bool) -> _Overlap:
    """The seam runs down the middle of the edge's view where it is upright, else across."""
    view, beside = view_of(face, fov_deg), view_of(edge, fov_deg)
    uvz = places(view, beside)
    common = inside(uvz, beside)
    rows, columns = np.nonzero(common)
    here = np.stack([columns, rows], axis=-1) + 0.5
    there = uvz[common][:, :2]
    half = np.array((view.width, view.height)) / 2
    from_seam = np.abs(there / half - 1)[:, 0 if upright else 1]
    return _Overlap(
        face=face.pixels[common],
        edge=sample(edge.pixels, uvz)[common],
        t_face=((here / half - 1) ** 2).mean(axis=1),
        t_edge=((there / half - 1) ** 2).mean(axis=1),
        near=from_seam < 2 * _STRIP,
    )


def _seam(first: _Overlap, second: _Overlap) -> float:
    """Grey levels between the pictures of an edge: either face against the view of it, or one another."""
    if min(first.near.sum(), second.near.sum()) < _LEAST_PIXELS:
        return float("nan")
    a, b = (float(np.median((each.face - each.edge)[each.near])) for each in (first, second))
    return max(abs(a), abs(b), abs(a - b))


def _fit(overlaps: list[_Overlap]) -> tuple[float, float]:
    """Vignette and exposure that explain all overlaps, by ``face / edge = gain (1 - V t) / (1 - V t')``."""
    usable = []
    for each in overlaps:
        clear = (np.minimum(each.face, each.edge) > _DARK) & (np.maximum(each.face, each.edge) < _BRIGHT)
        if clear.sum() >= _LEAST_PIXELS:
            ratio = np.log(each.face[clear] / each.edge[clear])
            usable.append((ratio, each.t_face[clear], each.t_edge[clear]))
    if not usable:
        return float("nan"), float("nan")

    def left(ratio: Array, t_face: Array, t_edge: Array, vignette: float) -> Array:
        return np.asarray(ratio - np.log1p(-vignette * t_face) + np.log1p(-vignette * t_edge))

    def misfit(vignette: float) -> float:
        """Medians: textures differ where they are finer than pixels."""
        rests = [left(*each, vignette) for each in usable]
        return float(np.mean([np.median(np.abs(rest - np.median(rest))) for rest in rests]))

    found = float(minimize_scalar(misfit, bounds=(-0.3, 0.95), method="bounded").x)
    gains = [float(np.median(left(*each, found))) for each in usable]
    return found, float(np.expm1(np.abs(gains).max()))


def _share(name: str, share: float, text: str, cure: str) -> Finding:
    if np.isnan(share):
        return Finding(name, "too dark or too bright to tell", "warning", "give --position in a lit place")
    bad = abs(share) > _SHARE
    return Finding(name, text.format(round(share, 4) + 0.0), "bad" if bad else "ok", cure if bad else "")


def _step(name: str, levels: float, cure: str) -> Finding:
    if np.isnan(levels):
        return Finding(f"seam {name}", "out of sight", "bad", "see field of view")
    value, bad = f"{levels:.1f} of 255 levels", levels > _SEAM_LEVELS
    return Finding(f"seam {name}", value, "bad" if bad else "ok", cure if bad else "")
