"""The seams of a cube map: six faces, and twelve views whose axes point at its edges.

At an edge the borders of two faces meet, and a third view has the edge in its middle. All three see the same
surfaces, so differences are due to the camera: a gain for each picture (exposure), and a loss that grows from
the middle to the corners (vignette).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from omniscv.diagnostics import Finding
from omniscv.diagnostics.self_calibration import GREY, Picture, inside, reproject, sample
from omniscv.diagnostics.server import RawCamera
from omniscv.geometry import Array

FACES = {
    "front": (0, 0), "left": (90, 0), "back": (180, 0), "right": (-90, 0), "up": (0, 90), "down": (0, -90),
}  # fmt: skip
"""Yaw to the left and pitch, degrees."""

EDGES = {
    ("front", "left"): (45, 0), ("left", "back"): (135, 0),
    ("back", "right"): (-135, 0), ("right", "front"): (-45, 0),
    ("front", "up"): (0, 45), ("left", "up"): (90, 45), ("back", "up"): (180, 45), ("right", "up"): (-90, 45),
    ("front", "down"): (0, -45), ("left", "down"): (90, -45),
    ("back", "down"): (180, -45), ("right", "down"): (-90, -45),
}  # fmt: skip
"""The faces on either side, and yaw and pitch of the view between them."""

_STRIP = 1 / 32  # width of the strip beside a seam where pictures are compared, of their width
_LEAST_PIXELS = 64
_DARK, _BRIGHT = 16, 240  # grey levels between which rounding and clipping do not matter
_SEAM_LEVELS, _SHARE = 2.0, 0.02
"""Grey levels of 255, and share of the light, below which a seam is invisible and may come from textures."""
_REMEDY = "--set source_options.fix_exposure=true"
_OTHERS = "vrun r.BloomQuality 0, r.LensFlareQuality 0, r.SSR.Quality 0, r.PostProcessAAQuality 0"
"""Other effects that make pictures of one surface differ (protocol reference, section 7.1)."""


@dataclass(frozen=True)
class Light:
    """Differences of light within a cube map; NaN where they cannot be measured."""

    seams: dict[tuple[str, str], float]  # by faces: the grey levels by which three pictures differ there
    vignette: float  # how much less light the corners have than the middle, 0 to 1
    exposure: float  # how much the gains of pictures of the same surfaces differ, 0 is equal


def measure(camera: RawCamera) -> Light:
    """Capture faces and edges, and compare them."""

    def picture(yaw_deg: float, pitch_deg: float) -> Picture:
        pose = camera.go(yaw_deg, pitch_deg)
        return Picture(camera.pixels("lit") @ GREY, pose)

    faces = {name: picture(*angles) for name, angles in FACES.items()}
    seams, overlaps = {}, []
    for pair, (yaw, pitch) in EDGES.items():
        edge = picture(yaw, pitch)
        sides = [_overlap(faces[name], edge, camera.fov_deg, upright=pitch == 0) for name in pair]
        seams[pair] = _seam(*sides)
        overlaps += sides
    return Light(seams, *_fit(overlaps))


def findings(light: Light) -> list[Finding]:
    """Return a finding for the exposure, one for the vignette, and one for each seam."""
    drift = f"vrun r.EyeAdaptationQuality 0, or {_REMEDY}; N2 and later: --set source_options.exposure=auto"
    shade = f"vrun r.Tonemapper.Quality 1, or {_REMEDY}, or record --overscan 512"
    first = [
        _share("exposure", light.exposure, "{:.1%} between pictures of one surface", drift),
        _share("vignette", light.vignette, "corners {:.1%} darker than the middle", shade),
    ]
    remedy = _REMEDY if any(finding.verdict == "bad" for finding in first) else _OTHERS
    return [*first, *(_step("|".join(pair), levels, remedy) for pair, levels in light.seams.items())]


class _Overlap(NamedTuple):
    """The N pixels of a face that the view at its edge also sees, in both pictures."""

    face: Array  # (N,) grey
    edge: Array
    t_face: Array  # (N,) squared distance from the picture's middle, 1 in the corners
    t_edge: Array
    near: NDArray[np.bool_]  # (N,) whether the pixel is beside the seam


def _overlap(face: Picture, edge: Picture, fov_deg: float, upright: bool) -> _Overlap:
    """Compare a face and an edge's view, whose middle column is the seam if upright, else its middle row."""
    view, beside = face.view(fov_deg), edge.view(fov_deg)
    uvz = reproject(view, beside)
    common = inside(uvz, beside)
    half = np.array((view.width, view.height)) / 2
    in_face = (np.argwhere(common)[:, ::-1] + 0.5) / half - 1  # -1 to 1 across each picture
    in_edge = uvz[common][:, :2] / half - 1
    near = np.abs(in_edge[:, 0 if upright else 1]) < 2 * _STRIP
    greys = face.pixels[common], sample(edge.pixels, uvz)[common]
    return _Overlap(*greys, (in_face**2).mean(axis=1), (in_edge**2).mean(axis=1), near)


def _seam(first: _Overlap, second: _Overlap) -> float:
    """Return the largest difference, in grey levels, between two of the three pictures of an edge."""
    if min(first.near.sum(), second.near.sum()) < _LEAST_PIXELS:
        return float("nan")
    a, b = (float(np.median((side.face - side.edge)[side.near])) for side in (first, second))
    return max(abs(a), abs(b), abs(a - b))


def _fit(overlaps: list[_Overlap]) -> tuple[float, float]:
    """Fit vignette and exposure to all overlaps, by ``face / edge = gain (1 - V t) / (1 - V t')``."""
    usable = []
    for side in overlaps:
        clear = (np.minimum(side.face, side.edge) > _DARK) & (np.maximum(side.face, side.edge) < _BRIGHT)
        if clear.sum() >= _LEAST_PIXELS:
            ratio = np.log(side.face[clear] / side.edge[clear])
            usable.append((ratio, side.t_face[clear], side.t_edge[clear]))
    if not usable:
        return float("nan"), float("nan")

    def residuals(vignette: float) -> list[Array]:
        return [r - np.log1p(-vignette * t) + np.log1p(-vignette * t_edge) for r, t, t_edge in usable]

    def misfit(vignette: float) -> float:
        """Use medians, because textures finer than pixels differ."""
        return float(np.mean([np.median(np.abs(row - np.median(row))) for row in residuals(vignette)]))

    vignette = float(minimize_scalar(misfit, bounds=(-0.3, 0.95), method="bounded").x)
    gains = [float(np.median(row)) for row in residuals(vignette)]
    return vignette, float(np.expm1(np.abs(gains).max()))


def _share(name: str, share: float, text: str, remedy: str) -> Finding:
    if np.isnan(share):
        return Finding(name, "too dark or too bright to measure", "warning", "give --position in a lit room")
    return Finding.unless(abs(share) <= _SHARE, name, text.format(round(share, 4) + 0.0), "bad", remedy)


def _step(name: str, levels: float, remedy: str) -> Finding:
    if np.isnan(levels):
        return Finding(f"seam {name}", "not visible", "bad", "see field of view")
    value = f"{levels:.1f} of 255 levels"
    return Finding.unless(levels <= _SEAM_LEVELS, f"seam {name}", value, "bad", remedy)
