"""Scores of predicted normals: angles to the true ones, by pixels and by solid angle.

Source of the measures: Fouhey, Gupta and Hebert, Data-driven 3D primitives for single image understanding,
2013: mean, median, and shares below 11.25, 22.5 and 30 degrees.
"""

import itertools
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import shown
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask
from omniscv.score.areas import seen_pixels, solid_angles
from omniscv.score.mistakes import Mistake

_MUCH_BETTER = 0.5  # mean angle in another frame, relative to that in the frame that was said
_CLEARLY = 0.7  # the same of a free turn, relative to that in the best frame of exchanged axes
_LEAST_DEG = 5.0  # mean angle from which on another frame is looked for
_GRID = 8192  # pixels at which frames are compared


@dataclass(frozen=True)
class NormalMeasures:
    """Measures of angles with one kind of weights.

    Attributes:
        mean_deg, median_deg: degrees.
        rmse_deg: root of the mean of squares, degrees.
        below5, below11, below22, below30: shares below 5, 11.25, 22.5 and 30 degrees.
    """

    mean_deg: float
    median_deg: float
    rmse_deg: float
    below5: float
    below11: float
    below22: float
    below30: float


@dataclass(frozen=True)
class NormalScores:
    """The scores of one picture of normals.

    Attributes:
        by_pixel, by_solid_angle: the measures.
        compared: pixels that both have.
        in_doubt: pixels with a prediction whose truth is in doubt: left out.
        missing: pixels with truth, without a prediction (a vector of no length, or not finite).
    """

    by_pixel: NormalMeasures
    by_solid_angle: NormalMeasures
    compared: int
    in_doubt: int
    missing: int

    def to_dict(self) -> dict[str, object]:
        """Return plain values."""
        return asdict(self)


def normals(
    predicted: ArrayLike, truth: ArrayLike, camera: Camera, doubt: ArrayLike | None = None
) -> NormalScores:
    """Return the scores of predicted normals.

    Args:
        predicted: (H, W, 3) vectors of any length, camera frame (x right, y down, z ahead).
        truth: (H, W, 3) unit vectors, camera frame; 0 where unknown.
        camera: of both pictures, with one optical centre.
        doubt: (H, W) bool, pixels that are left out.

    Raises:
        ArgumentError: pictures of other sizes than the camera's, or no pixel that can be compared.
    """
    p, t, where, counts = _unit_vectors(predicted, truth, camera, doubt)
    angles = _angles_deg(p[where], t[where])
    areas = solid_angles(camera)[where]
    return NormalScores(
        by_pixel=_measures(angles, np.ones(len(angles))),
        by_solid_angle=_measures(angles, areas),
        compared=len(angles),
        in_doubt=counts[0],
        missing=counts[1],
    )


def find_frame(
    predicted: ArrayLike, truth: ArrayLike, camera: Camera, doubt: ArrayLike | None = None
) -> list[Mistake]:
    """Return the axes that predicted normals have instead of the camera's; empty where they have these.

    All 48 orders and signs of axes are tried, and a turn about some axis by any angle, as normals in the
    world frame have.

    Args:
        predicted, truth, camera, doubt: as :func:`normals` takes them.
    """
    p, t, where, _ = _unit_vectors(predicted, truth, camera, doubt)
    step = max(1, np.count_nonzero(where) // _GRID)
    p = p[where][::step]
    t = t[where][::step]
    weights = solid_angles(camera)[where][::step]
    weights = weights / weights.sum()
    as_said = float(weights @ _angles_deg(p, t))
    if as_said < _LEAST_DEG:
        return []
    best: Mistake | None = None
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            angle = float(weights @ _angles_deg(p[:, order] * np.array(signs), t))
            if angle < _MUCH_BETTER * as_said and (best is None or angle < best.so):
                best = Mistake("frame", as_said, angle, _axes(order, signs))
    turned = float(weights @ _angles_deg(p @ _rotation(p, t, weights).T, t))
    least = _MUCH_BETTER * as_said if best is None else _CLEARLY * best.so
    if turned < least:
        best = Mistake("frame", as_said, turned, "turned, as in the world frame")
    return [] if best is None else [best]


def _unit_vectors(
    predicted: ArrayLike, truth: ArrayLike, camera: Camera, doubt: ArrayLike | None
) -> tuple[Array, Array, Mask, tuple[int, int]]:
    """Return unit vectors, where both are known beyond doubt, and how many are in doubt and missing."""
    shape = (camera.height, camera.width)
    p = _picture("predicted", predicted, shape)
    t = _picture("truth", truth, shape)
    doubtful = np.zeros(shape, np.bool_) if doubt is None else np.asarray(doubt, np.bool_)
    length = np.linalg.norm(p, axis=-1)
    has_value = np.isfinite(length) & (length > 0)
    has_truth = seen_pixels(camera) & (np.abs(t).sum(axis=-1) > 0)
    where = has_value & has_truth & ~doubtful
    if not where.any():
        raise ArgumentError("predicted: expected a pixel with a normal and a truth beyond doubt, got none")
    unit = np.where(has_value[..., None], p, 0) / np.where(has_value, length, 1)[..., None]
    in_doubt = int(np.count_nonzero(has_value & has_truth & doubtful))
    return unit, t, where, (in_doubt, int(np.count_nonzero(~has_value & has_truth & ~doubtful)))


def _picture(name: str, values: ArrayLike, shape: tuple[int, int]) -> Array:
    """Return a picture of vectors as float64; ArgumentError with its ``name`` for another one."""
    detach = getattr(values, "detach", None)
    array = np.asarray(values if detach is None else detach().cpu(), np.float64)
    if array.shape != (*shape, 3):
        expected = f"{name}: expected (H, W, 3) = {(*shape, 3)}, as its camera has"
        raise ArgumentError(f"{expected}, got an array of shape {shown(array.shape)}")
    return array


def _angles_deg(p: Array, t: Array) -> Array:
    """Return the angles between unit vectors (N, 3), degrees; exact for small ones, too."""
    across = np.linalg.norm(p - t, axis=-1)
    along = np.linalg.norm(p + t, axis=-1)
    return np.asarray(np.degrees(2 * np.arctan2(across, along)))


def _measures(angles: Array, weights: Array) -> NormalMeasures:
    """Return the measures of angles (N,), degrees, with weights of any sum."""
    share = weights / weights.sum()
    order = np.argsort(angles)
    middle = min(int(np.searchsorted(np.cumsum(share[order]), 0.5)), len(order) - 1)
    shares = [float(share @ (angles < limit)) for limit in (5, 11.25, 22.5, 30)]
    return NormalMeasures(
        float(share @ angles),
        float(angles[order[middle]]),
        float(np.sqrt(share @ (angles * angles))),
        *shares,
    )


def _rotation(p: Array, t: Array, weights: Array) -> Array:
    """Return the rotation that turns vectors (N, 3) into others best. Source: Kabsch, 1976."""
    left, _, right = np.linalg.svd((weights[:, None] * t).T @ p)
    handedness = np.linalg.det(left) * np.linalg.det(right)
    return np.asarray(left @ np.diag([1, 1, handedness]) @ right)


def _axes(order: tuple[int, ...], signs: tuple[int, ...]) -> str:
    """Return axes for people, such as ``x, -y, -z``."""
    names = []
    for axis, sign in zip(order, signs, strict=True):
        names.append(("-" if sign < 0 else "") + "xyz"[axis])
    return ", ".join(names)
