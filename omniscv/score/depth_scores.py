"""Scores of depth by pixels and by solid angle, with what the truth leaves open."""

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import one_of, shown
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask
from omniscv.score.alignment import ALIGNMENTS, Line, fitted
from omniscv.score.areas import seen_pixels, solid_angles
from omniscv.score.intervals import Interval, Truths, interval
from omniscv.score.measures import DepthMeasures, measures, measures_by

FORMS = ("range", "planar", "disparity")
"""What a prediction holds: metres along the ray, metres along the optical axis, or 1 / metres along the
ray."""


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
        by_pixel_within: what the measures can be by truths within their bounds; None without bounds, and
            where such a truth lets the alignment lose pixels.
        by_solid_angle_within: the same by solid angle.
    """

    by_pixel: DepthMeasures
    by_solid_angle: DepthMeasures
    compared: int
    in_doubt: int
    missing: int
    lost: int = 0
    alignment: str = "none"
    by_pixel_within: Interval | None = None
    by_solid_angle_within: Interval | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        plain = asdict(self)
        for name in ("by_pixel_within", "by_solid_angle_within"):
            within = getattr(self, name)
            if within is not None:
                plain[name] = {"low": asdict(within.low), "high": asdict(within.high)}
        return plain


class Compared(NamedTuple):
    """The pixels of a picture that are compared, with what is known of them.

    Attributes:
        where: (H, W) bool.
        in_doubt, missing: counts of pixels that are left out; see :class:`DepthScores`.
        error: (H, W) metres that the truth may be off; None: unknown.
    """

    where: Mask
    in_doubt: int
    missing: int
    error: Array | None


def depth(
    predicted: ArrayLike,
    truth: ArrayLike,
    camera: Camera,
    *,
    doubt: ArrayLike | None = None,
    error: ArrayLike | None = None,
    bounded: bool = False,
    form: str = "range",
    align: str = "none",
    unit_m: float = 1.0,
) -> DepthScores:
    """Return the scores of predicted depth.

    Args:
        predicted: (H, W); 0, negative, infinite and NaN are no values. A torch tensor is taken, too.
        truth: (H, W) metres along the ray; infinite where there is no surface.
        camera: of both pictures, with one optical centre.
        doubt: (H, W) bool, pixels whose truth is in doubt (:attr:`omniscv.OmniImage.doubt`); None: none is.
        error: (H, W) metres that the truth may be off (:attr:`omniscv.OmniImage.depth_error`), for intervals;
            None: no intervals.
        bounded: whether pixels in doubt are compared where ``error`` bounds them below their depth; intervals
            then say what they leave open.
        form: what the prediction holds, one of :data:`FORMS`.
        align: one of :data:`omniscv.score.ALIGNMENTS`.
        unit_m: of the prediction, metres; of disparity, 1 / metres.

    Raises:
        ArgumentError: pictures of other sizes than the camera's, planar depth of a camera that sees beside
            its axis or behind, ``bounded`` without an error, or no pixel that can be compared.
    """
    one_of("align", align, ALIGNMENTS)
    shape = (camera.height, camera.width)
    along = as_range(picture("predicted", predicted, shape) * unit_m, form, camera)
    true = picture("truth", truth, shape)
    compared = select(along, true, camera, doubt=doubt, error=error, bounded=bounded)
    return compare(along, true, camera, compared, align)[0]


class _Aligned(NamedTuple):
    """Pixels (N,) after alignment.

    Attributes:
        by_pixel, by_area: predictions, metres, aligned with either kind of weights.
        t: truths, metres.
        alike, areas: the weights.
    """

    by_pixel: Array
    by_area: Array
    t: Array
    alike: Array
    areas: Array

    def measures(self, is_one: bool) -> list[DepthMeasures]:
        """Return the measures by pixel and by solid angle; ``is_one``: both alignments are the same."""
        if is_one:
            return measures_by(self.by_pixel, self.t, (self.alike, self.areas))
        of_pixels = measures(self.by_pixel, self.t, self.alike)
        return [of_pixels, measures(self.by_area, self.t, self.areas)]


def compare(
    along: Array,
    true: Array,
    camera: Camera,
    compared: Compared,
    align: str = "none",
    lines: tuple[Line, Line] | None = None,
) -> tuple[DepthScores, Array]:
    """Return the scores of an image, and its aligned depth (H, W), NaN where nothing is compared.

    Args:
        along: (H, W) predicted metres along rays.
        true: (H, W) metres along rays.
        camera: of both.
        compared: the pixels.
        align: one of :data:`omniscv.score.ALIGNMENTS`.
        lines: the alignments of a whole set, by pixel and by solid angle; None: of this image.

    Raises:
        ArgumentError: no pixel has depth after it is aligned.
    """
    where = compared.where
    t = true[where]
    p = along[where]
    areas = solid_angles(camera)[where]
    alike = np.ones(len(t))
    if lines is None:
        lines = fitted(p, t, alike, align), fitted(p, t, areas, align)
    by_pixel = lines[0].apply(p)
    by_area = lines[1].apply(p)
    kept = (by_pixel > 0) & (by_area > 0) & np.isfinite(by_pixel) & np.isfinite(by_area)
    if not kept.any():
        raise ArgumentError(f"align: expected depth above 0 after {align}, got none at any pixel")
    within: list[Interval | None] = [None, None]
    if compared.error is not None and kept.all():
        bounds = t - compared.error[where], t + compared.error[where]
        within = [interval(p, Truths(*bounds, weights), align) for weights in (alike, areas)]
    aligned = np.full(true.shape, np.nan)
    aligned[where] = by_area if kept.all() else np.where(kept, by_area, np.nan)
    pairs = _Aligned(by_pixel, by_area, t, alike, areas)
    if not kept.all():
        pairs = _Aligned(*(values[kept] for values in pairs))
    of_pixels, of_areas = pairs.measures(is_one=lines[0] == lines[1])
    scores = DepthScores(
        by_pixel=of_pixels,
        by_solid_angle=of_areas,
        compared=len(pairs.t),
        lost=int(np.count_nonzero(~kept)),
        in_doubt=compared.in_doubt,
        missing=compared.missing,
        alignment=align,
        by_pixel_within=within[0],
        by_solid_angle_within=within[1],
    )
    return scores, aligned


def select(
    along: Array,
    truth: Array,
    camera: Camera,
    *,
    doubt: ArrayLike | None = None,
    error: ArrayLike | None = None,
    bounded: bool = False,
) -> Compared:
    """Return which pixels are compared.

    Args:
        along: (H, W) predicted metres along rays.
        truth: (H, W) metres along rays.
        camera: of both.
        doubt, error, bounded: see :func:`depth`.

    Raises:
        ArgumentError: ``bounded`` without an error, or no pixel.
    """
    doubtful = np.zeros(truth.shape, np.bool_) if doubt is None else np.asarray(doubt, np.bool_)
    off = None if error is None else picture("error", error, truth.shape)
    if bounded:
        if off is None:
            raise ArgumentError("bounded: expected the truth's error, got none: give error")
        doubtful = ~(off < truth)
    elif off is not None:
        doubtful = doubtful | ~(off < truth)
    has_truth = seen_pixels(camera) & np.isfinite(truth) & (truth > 0)
    has_value = np.isfinite(along) & (along > 0)
    where = has_truth & has_value & ~doubtful
    if not where.any():
        raise ArgumentError("predicted: expected a pixel with a value and a truth beyond doubt, got none")
    return Compared(
        where,
        int(np.count_nonzero(has_truth & has_value & doubtful)),
        int(np.count_nonzero(has_truth & ~has_value & ~doubtful)),
        off,
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


def picture(name: str, values: ArrayLike, shape: tuple[int, int]) -> Array:
    """Return a picture as float64 of a camera's size; ArgumentError with its ``name`` for another one."""
    detach = getattr(values, "detach", None)  # a torch tensor that has a gradient or lies on a GPU
    array = np.asarray(values if detach is None else detach().cpu(), np.float64)
    if array.shape == (*shape, 1):
        array = array[..., 0]
    if array.shape != shape:
        expected = f"{name}: expected (H, W) = {shape}, as its camera has"
        raise ArgumentError(f"{expected}, got an array of shape {shown(array.shape)}")
    return array
