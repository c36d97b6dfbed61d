"""What a camera is, by turning it: what it saw before must be where its field of view says.

A camera that turns in place sees the same rays elsewhere in the picture: ``p_2 ~ K R_21 K^-1 p_1``. Only the
true focal length, and for depth the true meaning, bring the two pictures together.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from omniscv.captures.decode import SKY
from omniscv.captures.view import View
from omniscv.geometry import Array, Pose

_STEP_DEG = 2.0
_FOVS_DEG = np.arange(20.0, 151.0, _STEP_DEG)
_COARSE = 4
"""Every so many-th row and column decides which field of view is about right."""
_FLAT = 1e-3
"""Relative contrast below which a picture shows nothing to measure by."""
_OVERLAP = 0.1
"""The least share of the picture that both must see."""


class Look(NamedTuple):
    """A picture and where it was taken from."""

    pixels: NDArray[Any]
    pose: Pose


def view_of(look: Look, fov_deg: float) -> View:
    """The view of a picture, would it have that field of view."""
    height, width = look.pixels.shape[:2]
    return View(look.pose, fov_deg, width, height)


def places(view: View, seen_from: View, stride: int = 1) -> Array:
    """(H, W, 3): where a view's pixels are in another with the same centre: u, v in px, z > 0 in front.

    Args:
        view, seen_from: the two views.
        stride: only every so many-th row and column of ``view``.
    """
    v, u = np.mgrid[: view.height : stride, : view.width : stride] + 0.5
    f = view.focal_px
    rays_c = np.stack([(u - view.width / 2) / f, (v - view.height / 2) / f, np.ones_like(u)], axis=-1)
    return seen_from.project(view.pose.to_world(rays_c) - view.pose.position + seen_from.pose.position)


def inside(uvz: Array, view: View) -> NDArray[np.bool_]:
    """(H, W): which places are in the picture, with a neighbour on every side."""
    u, v, z = np.moveaxis(uvz, -1, 0)
    return np.asarray((z > 0) & (u >= 0.5) & (u <= view.width - 0.5) & (v >= 0.5) & (v <= view.height - 0.5))


def sample(pixels: NDArray[Any], uvz: Array) -> Array:
    """A picture at places, linear between pixels."""
    at = (uvz[..., :2] - 0.5).astype(np.float32)
    values = cv2.remap(np.asarray(pixels, np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    return np.asarray(values, np.float64)


def misfit(first: Look, second: Look, fov_deg: float, kind: str = "", stride: int = 1) -> float:
    """How badly one picture predicts the other: 0 not at all, about 1 if they have nothing in common.

    Args:
        first, second: pictures of one mode; colours (H, W, 3), or depth (H, W) with its kind.
        fov_deg: their horizontal field of view, supposed.
        kind: ``planar`` or ``ray``, supposed, for depth.
        stride: only every so many-th row and column counts.
    """
    views = [view_of(look, fov_deg) for look in (first, second)]
    uvz = places(views[1], views[0], stride)
    common = inside(uvz, views[0])
    if common.mean() < _OVERLAP:
        return 1.0
    a, b = (_shown(look, view, kind) for look, view in zip((first, second), views, strict=True))
    x, y = sample(a, uvz)[common], b[::stride, ::stride][common]
    if min(x.std() / max(x.mean(), 1e-9), y.std() / max(y.mean(), 1e-9)) < _FLAT:
        return 1.0
    return float(1 - np.corrcoef(x, y)[0, 1])


def fitted_fov(first: Look, second: Look, kind: str = "") -> tuple[float, float]:
    """The field of view, degrees, that brings two pictures together, and the misfit that is left."""
    misfits = [misfit(first, second, fov, kind, _COARSE) for fov in _FOVS_DEG]
    best = float(_FOVS_DEG[int(np.argmin(misfits))])
    found = minimize_scalar(
        lambda fov: misfit(first, second, fov, kind),
        bounds=(best - _STEP_DEG, best + _STEP_DEG),
        method="bounded",
        options={"xatol": 0.01},
    )
    return float(found.x), float(found.fun)


def _shown(look: Look, view: View, kind: str) -> Array:
    """(H, W) what does not change when the camera turns: grey, or one over the distance along the ray."""
    if not kind:
        return np.asarray(look.pixels @ (0.5, 0.3, 0.2))
    depth = np.asarray(look.pixels, np.float64)
    distance = depth * view.ray_lengths() if kind == "planar" else depth
    seen = (depth < SKY) & (depth > 0)
    return np.asarray(np.divide(1.0, distance, out=np.zeros_like(distance), where=seen))
