"""Self-calibration from pure rotation: a camera's field of view, kind of depth, exposure and vignette.

A turned camera sees the same rays elsewhere: ``p_2 ~ K R_21 K^-1 p_1``. Only the true focal length, and for
depth the true meaning, align the two pictures.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from omniscv.diagnostics import Finding
from omniscv.geometry import Array, Pose, pinhole
from omniscv.sources.base import View
from omniscv.sources.codecs import UNREAL_SKY

GREY = np.array((0.5, 0.3, 0.2))  # weights that make grey levels of RGB
_UNALIGNED = 0.3  # a misfit above which pictures cannot be aligned
_CLEARLY = 2.5  # the ratio of misfits from which another field of view than the reported one is the true one
_STEP_DEG = 2.0
_FOVS_DEG = np.arange(20.0, 151.0, _STEP_DEG)
_COARSE = 4  # stride of rows and columns for the approximate field of view
_FLAT = 1e-3  # relative contrast below which a picture has nothing to align
_OVERLAP = 0.1  # the least share of the picture that both must see

_LEAST_PIXELS = 64
# Grey levels between which rounding and clipping do not matter:
_DARK = 16
_BRIGHT = 240
_SHARE = 0.02  # of the light, below which a difference may come from textures
_FIX = "--set source_options.fix_exposure=true"


class Picture(NamedTuple):
    """Pixels and the pose they were taken from."""

    pixels: NDArray[Any]
    pose: Pose

    def view(self, fov_deg: float) -> View:
        """Return the view, supposing a field of view."""
        height, width = self.pixels.shape[:2]
        return View(self.pose, fov_deg, width, height)


def reproject(view: View, into: View, stride: int = 1) -> Array:
    """Return (H, W, 3) where a view's pixels are in another with the same centre: u, v in px, z depth.

    Args:
        view: whose pixels are projected.
        into: the other view.
        stride: only every so many rows and columns of ``view`` are used.
    """
    v, u = np.mgrid[: view.height : stride, : view.width : stride] + 0.5
    rays_c = pinhole.rays(np.stack([u, v], axis=-1), view.projection)
    return into.project(view.pose.to_world(rays_c) - view.pose.position + into.pose.position)


def inside(uvz: Array, view: View) -> NDArray[np.bool_]:
    """Return (H, W) which coordinates ``uvz`` are in a ``view``'s picture, with a neighbour on every side."""
    u, v, z = np.moveaxis(uvz, -1, 0)
    return np.asarray((z > 0) & (u >= 0.5) & (u <= view.width - 0.5) & (v >= 0.5) & (v <= view.height - 0.5))


def sample(pixels: NDArray[Any], uvz: Array) -> Array:
    """Return the values of a picture's ``pixels`` at coordinates ``uvz`` (H, W, 3), px, bilinear."""
    at = (uvz[..., :2] - 0.5).astype(np.float32)
    values = cv2.remap(np.asarray(pixels, np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    return np.asarray(values, np.float64)


def misfit(first: Picture, second: Picture, fov_deg: float, kind: str = "", stride: int = 1) -> float:
    """Return how badly one picture predicts the other: 0 is exact, about 1 has nothing in common.

    Args:
        first, second: colours (H, W, 3), or depth (H, W).
        fov_deg: horizontal field of view to suppose.
        kind: of depth to suppose, ``planar`` or ``ray``; empty for colours.
        stride: of rows and columns that are compared.
    """
    first_view = first.view(fov_deg)
    second_view = second.view(fov_deg)
    uvz = reproject(second_view, first_view, stride)
    common = inside(uvz, first_view)
    if common.mean() < _OVERLAP:
        return 1.0
    predicted = sample(_invariant(first, first_view, kind), uvz)[common]
    actual = _invariant(second, second_view, kind)[::stride, ::stride][common]
    if min(_contrast(predicted), _contrast(actual)) < _FLAT:
        return 1.0
    return float(1 - np.corrcoef(predicted, actual)[0, 1])


def _contrast(values: Array) -> float:
    return float(values.std() / max(values.mean(), 1e-9))


def fitted_fov(pairs: Sequence[tuple[Picture, Picture]], reported: float, kind: str = "") -> float | None:
    """Return the field of view, degrees, that aligns pairs of turned pictures; None where none is aligned.

    Thin bars before the sky, or an even ground, are aligned by many fields of view: the reported one stands
    unless another is clearly better.

    Args:
        pairs: of pictures, before and after a turn.
        reported: field of view, degrees.
        kind: as for :func:`misfit`.
    """
    pairs = [pair for pair in pairs if misfit(*pair, reported, kind, _COARSE) < 1]
    if not pairs:
        return None

    def total(fov_deg: float, stride: int = 1) -> float:
        """Return the mean misfit of all pairs for a ``fov_deg``, of every ``stride``-th row and column."""
        return float(np.mean([misfit(*pair, fov_deg, kind, stride) for pair in pairs]))

    best = reported
    beside = min(total(reported - _STEP_DEG, _COARSE), total(reported + _STEP_DEG, _COARSE))
    if total(reported, _COARSE) > beside:
        best = min(_FOVS_DEG, key=lambda fov_deg: total(fov_deg, _COARSE))
    near = (best - _STEP_DEG, best + _STEP_DEG)
    fit = minimize_scalar(total, bounds=near, method="bounded", options={"xatol": 0.01})
    if fit.fun > _UNALIGNED:
        return None
    if abs(fit.x - reported) > 1 and total(reported) < _CLEARLY * fit.fun:
        return reported
    return float(fit.x)


def _invariant(picture: Picture, view: View, kind: str) -> Array:
    """Return (H, W) what a turn leaves unchanged: grey, or one over the distance along the ray."""
    if not kind:
        return np.asarray(picture.pixels @ GREY)
    depth = np.asarray(picture.pixels, np.float64)
    distance = depth * view.ray_lengths() if kind == "planar" else depth
    surface = (depth < UNREAL_SKY) & (depth > 0)
    return np.asarray(np.divide(1.0, distance, out=np.zeros_like(distance), where=surface))


def light_findings(pairs: Iterable[tuple[Picture, Picture]], fov_deg: float) -> list[Finding]:
    """Return a finding for the exposure and one for the vignette, from pairs of grey pictures (H, W).

    Of one surface, ``first / second = gain (1 - V t) / (1 - V t')``, with a gain for each pair (exposure) and
    a share V that corners lose (vignette); t, t' are squared distances from the middles, 1 in the corners.
    All have the horizontal field of view ``fov_deg``.
    """
    overlaps = []
    for first, second in pairs:
        overlap = _overlap(first, second, fov_deg)
        if overlap is not None:
            overlaps.append(overlap)
    if not overlaps:
        value = "too dark or too bright to measure"
        remedy = "give --position in a lit room"
        return [Finding(name, value, "warning", remedy) for name in ("exposure", "vignette")]
    vignette, exposure = _fit(overlaps)
    drift = f"none for recordings of N2 and later; vrun r.EyeAdaptationQuality 0, or {_FIX}"
    value = f"{exposure:.1%} between pictures of one surface"
    shade = f"vrun r.Tonemapper.Quality 1, or {_FIX}, or record --overscan 512"
    darker = f"corners {vignette:.1%} darker than the middle"
    return [
        Finding.unless(exposure <= _SHARE, "exposure", value, "bad", drift),
        Finding.unless(abs(vignette) <= _SHARE, "vignette", darker, "bad", shade),
    ]


def _overlap(first: Picture, second: Picture, fov_deg: float) -> tuple[Array, Array, Array] | None:
    """Return log ratio of grey levels, t and t', each (N,); None for too few pixels."""
    view = first.view(fov_deg)
    other = second.view(fov_deg)
    uvz = reproject(view, other)
    common = inside(uvz, other)
    greys = np.stack([first.pixels[common], sample(second.pixels, uvz)[common]])
    clear = (greys.min(axis=0) > _DARK) & (greys.max(axis=0) < _BRIGHT)
    if clear.sum() < _LEAST_PIXELS:
        return None
    half = np.array((view.width, view.height)) / 2
    xy = (np.argwhere(common)[:, ::-1] + 0.5) / half - 1  # -1 to 1
    xy_other = uvz[common][:, :2] / half - 1
    t = (xy[clear] ** 2).mean(axis=1)
    t_other = (xy_other[clear] ** 2).mean(axis=1)
    return np.log(greys[0] / greys[1])[clear], t, t_other


def _fit(overlaps: list[tuple[Array, Array, Array]]) -> tuple[float, float]:
    """Return the vignette and the largest gain less 1, to four decimals."""

    def residuals(vignette: float) -> list[Array]:
        rows = []
        for ratio, t, t_other in overlaps:
            rows.append(ratio - np.log1p(-vignette * t) + np.log1p(-vignette * t_other))
        return rows

    def spread(vignette: float) -> float:  # by medians, because textures finer than pixels differ
        deviations = []
        for row in residuals(vignette):
            deviations.append(np.median(np.abs(row - np.median(row))))
        return float(np.mean(deviations))

    vignette = float(minimize_scalar(spread, bounds=(-0.3, 0.95), method="bounded").x)
    gain = float(np.expm1(max(abs(np.median(row)) for row in residuals(vignette))))
    return round(vignette, 4) + 0.0, round(gain, 4) + 0.0  # no negative zero
