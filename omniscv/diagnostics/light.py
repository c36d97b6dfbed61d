"""Exposure and vignette, from views of one centre that overlap.

Both pictures of an overlap show the same surfaces, so the ratio of their grey levels is due to the camera:
``first / second = gain (1 - V t) / (1 - V t')``, with a gain for each pair (exposure) and a share V that the
corners lose (vignette); t and t' are the squared distances from the pictures' middles, 1 in the corners.
"""

from collections.abc import Iterable

import numpy as np
from scipy.optimize import minimize_scalar

from omniscv.diagnostics import Finding
from omniscv.diagnostics.self_calibration import Picture, inside, reproject, sample
from omniscv.geometry import Array

_LEAST_PIXELS = 64
_DARK, _BRIGHT = 16, 240  # grey levels between which rounding and clipping do not matter
_SHARE = 0.02  # of the light, below which a difference may come from textures
_FIX = "--set source_options.fix_exposure=true"


def findings(pairs: Iterable[tuple[Picture, Picture]], fov_deg: float) -> list[Finding]:
    """Return a finding for the exposure and one for the vignette, from pairs of grey pictures (H, W)."""
    overlaps = (_overlap(*pair, fov_deg) for pair in pairs)
    vignette, exposure = _fit([overlap for overlap in overlaps if overlap is not None])
    drift = f"none for recordings of N2 and later; vrun r.EyeAdaptationQuality 0, or {_FIX}"
    shade = f"vrun r.Tonemapper.Quality 1, or {_FIX}, or record --overscan 512"
    return [
        _finding("exposure", exposure, "{:.1%} between pictures of one surface", drift),
        _finding("vignette", vignette, "corners {:.1%} darker than the middle", shade),
    ]


def _overlap(first: Picture, second: Picture, fov_deg: float) -> tuple[Array, Array, Array] | None:
    """Return log ratio of grey levels, t and t', each (N,); None for too few pixels."""
    view, other = first.view(fov_deg), second.view(fov_deg)
    uvz = reproject(view, other)
    common = inside(uvz, other)
    greys = np.stack([first.pixels[common], sample(second.pixels, uvz)[common]])
    clear = (greys.min(axis=0) > _DARK) & (greys.max(axis=0) < _BRIGHT)
    if clear.sum() < _LEAST_PIXELS:
        return None
    half = np.array((view.width, view.height)) / 2
    across = (np.argwhere(common)[:, ::-1] + 0.5) / half - 1, uvz[common][:, :2] / half - 1  # -1 to 1
    t, t_other = ((xy[clear] ** 2).mean(axis=1) for xy in across)
    return np.log(greys[0] / greys[1])[clear], t, t_other


def _fit(overlaps: list[tuple[Array, Array, Array]]) -> tuple[float, float]:
    """Return the vignette and the largest gain less 1; NaN without overlaps."""
    if not overlaps:
        return float("nan"), float("nan")

    def residuals(vignette: float) -> list[Array]:
        return [
            ratio - np.log1p(-vignette * t) + np.log1p(-vignette * t_other) for ratio, t, t_other in overlaps
        ]

    def misfit(vignette: float) -> float:
        """Use medians, because textures finer than pixels differ."""
        return float(np.mean([np.median(np.abs(row - np.median(row))) for row in residuals(vignette)]))

    vignette = float(minimize_scalar(misfit, bounds=(-0.3, 0.95), method="bounded").x)
    return vignette, float(np.expm1(max(abs(np.median(row)) for row in residuals(vignette))))


def _finding(name: str, share: float, text: str, remedy: str) -> Finding:
    if np.isnan(share):
        return Finding(name, "too dark or too bright to measure", "warning", "give --position in a lit room")
    return Finding.unless(abs(share) <= _SHARE, name, text.format(round(share, 4) + 0.0), "bad", remedy)
