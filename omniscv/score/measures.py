"""Measures of depth, each with its published definition, by pixels and by solid angle.

Of predictions p and truths t, metres, with weights that sum to 1: Eigen, Puhrsch and Fergus, Depth map
prediction from a single image, 2014, for ``abs_rel`` to ``delta3`` and ``silog`` (100 times the root of the
variance of ``log p - log t``, as KITTI's benchmark has it); Ornek and others 2022 use the finer deltas.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import one_of, shown
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask
from omniscv.score.alignment import align as aligned
from omniscv.score.areas import solid_angles

FORMS = ("range", "planar", "disparity")
"""What a prediction holds: metres along the ray, metres along the optical axis, or 1 / metres along the
ray."""


@dataclass(frozen=True)
class DepthMeasures:
    """Measures with one kind of weights.

    Attributes:
        abs_rel: mean of ``|p - t| / t``.
        sq_rel: mean of ``(p - t)^2 / t``, metres.
        rmse: root of the mean of ``(p - t)^2``, metres.
        rmse_log: the same of natural logarithms.
        silog: 100 times the standard deviation of ``log p - log t``.
        mae: mean of ``|p - t|``, metres.
        inlier3: share with ``max(p / t, t / p) < 1.03``.
        delta105, delta110: the same below 1.05 and 1.10.
        delta1, delta2, delta3: below 1.25, its square and its cube.
    """

    abs_rel: float
    sq_rel: float
    rmse: float
    rmse_log: float
    silog: float
    mae: float
    inlier3: float
    delta105: float
    delta110: float
    delta1: float
    delta2: float
    delta3: float


@dataclass(frozen=True)
class DepthScores:
    """The scores of one prediction.

    Attributes:
        by_pixel: each pixel counts once, as in papers.
        by_solid_angle: each pixel counts as much as it sees of the sphere.
        compared: pixels that both have.
        in_doubt: pixels with a prediction whose truth is in doubt: left out.
        missing: pixels with truth beyond doubt, without a prediction (0, negative, infinite or NaN).
        lost: pixels whose prediction is 0 or less after it was aligned with a shift: left out.
        alignment: how the prediction was aligned.
    """

    by_pixel: DepthMeasures
    by_solid_angle: DepthMeasures
    compared: int
    in_doubt: int
    missing: int
    lost: int = 0
    alignment: str = "none"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)


def depth(
    predicted: ArrayLike,
    truth: ArrayLike,
    camera: Camera,
    *,
    doubt: ArrayLike | None = None,
    form: str = "range",
    align: str = "none",
    unit_m: float = 1.0,
) -> DepthScores:
    """Return the scores of predicted depth.

    Args:
        predicted: (H, W); 0, negative, infinite and NaN are no values.
        truth: (H, W) metres along the ray; infinite where there is no surface.
        camera: of both pictures, with one optical centre.
        doubt: (H, W) bool, pixels whose truth is in doubt (:attr:`omniscv.OmniImage.doubt`); None: none is.
        form: what the prediction holds, one of :data:`FORMS`.
        align: one of :data:`omniscv.score.ALIGNMENTS`.
        unit_m: of the prediction, metres; of disparity, 1 / metres.

    Raises:
        ArgumentError: pictures of other sizes than the camera's, planar depth of a camera that sees beside
            its axis or behind, or no pixel that can be compared.
    """
    shape = (camera.height, camera.width)
    given = _picture("predicted", predicted, shape)
    true = _picture("truth", truth, shape)
    doubtful = np.zeros(shape, np.bool_) if doubt is None else np.asarray(doubt, np.bool_)
    along = as_range(given * unit_m, form, camera)
    has_truth = camera.valid() & np.isfinite(true) & (true > 0)
    has_value = np.isfinite(along) & (along > 0)
    compared = has_truth & has_value & ~doubtful
    if not compared.any():
        raise ArgumentError("predicted: expected a pixel with a value and a truth beyond doubt, got none")
    t = true[compared]
    areas = solid_angles(camera)[compared]
    alike = np.ones(len(t))
    p = aligned(along[compared], t, alike, align)
    p_by_area = aligned(along[compared], t, areas, align)
    positive = (p > 0) & (p_by_area > 0) & np.isfinite(p) & np.isfinite(p_by_area)
    if not positive.any():
        raise ArgumentError(f"align: expected depth above 0 after {align}, got none at any pixel")
    return DepthScores(
        by_pixel=measures(p[positive], t[positive], alike[positive]),
        by_solid_angle=measures(p_by_area[positive], t[positive], areas[positive]),
        compared=int(np.count_nonzero(positive)),
        lost=int(np.count_nonzero(~positive)),
        in_doubt=int(np.count_nonzero(has_truth & has_value & doubtful)),
        missing=int(np.count_nonzero(has_truth & ~has_value & ~doubtful)),
        alignment=align,
    )


def as_range(values: Array, form: str, camera: Camera) -> Array:
    """Return metres along rays of what a prediction holds; NaN where it has no value.

    Args:
        values: (H, W) metres, or 1 / metres of disparity.
        form: one of :data:`FORMS`.
        camera: of the picture.

    Raises:
        ArgumentError: planar depth of a camera that has none.
    """
    one_of("form", form, FORMS)
    if form == "range":
        return values
    with np.errstate(divide="ignore", invalid="ignore"):
        if form == "disparity":
            return np.asarray(np.where(values > 0, 1 / values, np.nan))
        rays = camera.unproject()
        along_axis = rays.directions[..., 2]
        if (along_axis[rays.valid] <= 0).any():
            raise ArgumentError(
                f"form: expected range or disparity, got planar: {camera.name!r} has no plane"
            )
        return np.asarray(values / along_axis)


def measures(p: Array, t: Array, weights: Array) -> DepthMeasures:
    """Return the measures of predictions and truths, (N,) metres above 0, with weights (N,) of any sum."""
    share = weights / weights.sum()
    off = p - t
    logs = np.log(p) - np.log(t)
    ratio = np.maximum(p / t, t / p)

    def mean(values: Array | Mask) -> float:
        return float((share * values).sum())

    mean_log = mean(logs)
    return DepthMeasures(
        abs_rel=mean(np.abs(off) / t),
        sq_rel=mean(off**2 / t),
        rmse=float(np.sqrt(mean(off**2))),
        rmse_log=float(np.sqrt(mean(logs**2))),
        silog=100 * float(np.sqrt(max(0.0, mean((logs - mean_log) ** 2)))),
        mae=mean(np.abs(off)),
        inlier3=mean(ratio < 1.03),
        delta105=mean(ratio < 1.05),
        delta110=mean(ratio < 1.10),
        delta1=mean(ratio < 1.25),
        delta2=mean(ratio < 1.25**2),
        delta3=mean(ratio < 1.25**3),
    )


def _picture(name: str, values: ArrayLike, shape: tuple[int, int]) -> Array:
    """Return a picture as float64 of a camera's size."""
    array = np.asarray(values, np.float64)
    if array.shape == (*shape, 1):
        array = array[..., 0]
    if array.shape != shape:
        expected = f"{name}: expected (H, W) = {shape}, as its camera has"
        raise ArgumentError(f"{expected}, got an array of shape {shown(array.shape)}")
    return array
