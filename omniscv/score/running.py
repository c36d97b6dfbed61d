"""Score a folder of predictions, image by image, in the memory of one image."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number, one_of, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats
from omniscv.score import groups
from omniscv.score.alignment import Fit, Line
from omniscv.score.areas import solid_angles
from omniscv.score.depth_scores import Compared, DepthScores, as_range, compare, select
from omniscv.score.edges import boundary_f1
from omniscv.score.groups import Groups
from omniscv.score.labels import LabelScores, PanopticImage, labels, panoptic_image, panoptic_set
from omniscv.score.mistakes import Mistake, find_mistakes
from omniscv.score.normals import NormalScores, find_frame, normals
from omniscv.score.points import cloud, points
from omniscv.score.projection import seen_by
from omniscv.score.protocols import PROTOCOLS, protocol
from omniscv.score.reading import INSTANCES, WHAT, Lens, Truth, file_of, prediction, read, truths

WEIGHTS = ("by_pixel", "by_solid_angle")
"""Kinds of weights."""
ALSO = ("edges", "points")
"""Figures of depth that are made on demand: they take longer."""
PER = ("image", "set")
"""What has one alignment."""


@dataclass(frozen=True)
class Options:
    """How predictions are read and scored.

    Attributes:
        what: one of :data:`omniscv.score.reading.WHAT`.
        form: what predicted depth holds: ``range``, ``planar``, ``disparity``.
        align: one of :data:`omniscv.score.ALIGNMENTS`.
        per: what has one alignment, one of :data:`PER`.
        unit_m: of predictions, metres.
        intervals: whether figures have intervals where the truth has bounds; None: where there is no
            alignment, with which they take seconds for an image.
        bounded: whether pixels in doubt are compared where the truth has a bound; see
            :func:`omniscv.score.depth`.
        also: some of :data:`ALSO`.
        protocol: one of :data:`omniscv.score.protocols.PROTOCOLS`; empty: none.
        cameras: names of a dataset's cameras whose frames count; empty: all.
        camera: of truth that is files; None: a dataset or images say theirs.
        truth_unit_m: of such files, metres.
        predicted_camera: of predictions, which are compared where their own pixels are; None: the truth's.
        rotation: (3, 3) from the predictions' camera frame to that of the truth; None: the same.
    """

    what: str = "depth"
    form: str = "range"
    align: str = "none"
    per: str = "image"
    unit_m: float = 1.0
    intervals: bool | None = None
    bounded: bool = False
    also: tuple[str, ...] = ()
    protocol: str = ""
    cameras: tuple[str, ...] = ()
    camera: Lens | None = None
    truth_unit_m: float = 1.0
    predicted_camera: Lens | None = None
    rotation: Array | None = None

    def __post_init__(self) -> None:
        one_of("what", self.what, WHAT)
        one_of("per", self.per, PER)
        number("unit", self.unit_m, above=0)
        number("truth unit", self.truth_unit_m, above=0)
        for name in self.also:
            one_of("also", name, ALSO)
        if self.protocol:
            one_of("protocol", self.protocol, PROTOCOLS)
            form = PROTOCOLS[self.protocol].form
            if form != self.form:
                expected = f"form: expected {form}, as the protocol {self.protocol} has it"
                raise ArgumentError(f"{expected}, got {self.form!r}")
        if self.what != "depth" and self.predicted_camera is not None:
            raise ArgumentError(f"predicted camera: expected depth, got {self.what}, which has axes or ids")

    @property
    def has_intervals(self) -> bool:
        """Whether figures have intervals, where the truth has bounds."""
        if self.intervals is None:
            return self.align == "none"
        return self.intervals


@dataclass(frozen=True)
class Scored:
    """An image that was scored.

    Attributes:
        name: of the image.
        scores: of its depth, labels or normals.
        mistakes: what the prediction reads as instead.
        resampled: what was done to its size; empty for nothing.
        scene: what it shows.
        extra: figures of edges and points, and those of a protocol, by name.
        groups: where errors of depth are; None for others.
    """

    name: str
    scores: DepthScores | LabelScores | NormalScores | PanopticImage
    mistakes: list[Mistake] = field(default_factory=list)
    resampled: str = ""
    scene: str = ""
    extra: dict[str, float] = field(default_factory=dict)
    groups: Groups | None = None

    def figures(self, weights: str) -> dict[str, float]:
        """Return the measures by name, with one of :data:`WEIGHTS`."""
        measures = getattr(self.scores, weights)
        figures = {}
        for item in fields(measures):
            value = getattr(measures, item.name)
            if isinstance(value, int | float):
                figures[item.name] = float(value)
        return figures

    def within(self, weights: str) -> dict[str, tuple[float, float]]:
        """Return what the measures can be, (least, greatest), by name; empty where that is not known."""
        interval = getattr(self.scores, f"{weights}_within", None)
        if interval is None:
            return {}
        bounds = {}
        for name in self.figures(weights):
            bounds[name] = getattr(interval.low, name), getattr(interval.high, name)
        return bounds

    @property
    def worst(self) -> float:
        """What images are sorted by: AbsRel, the mean angle, or one less mIoU or PQ, by solid angle."""
        figures = self.figures("by_solid_angle")
        for name in ("miou", "pq"):
            if name in figures:
                return 1 - figures[name]
        return figures.get("abs_rel", figures.get("mean_deg", 0.0))


@dataclass(frozen=True, eq=False)
class Map:
    """Where an image is wrong.

    Attributes:
        name: of the image.
        error: (H, W) float32 relative error of depth, angle by 100 degrees, or 0 and 1 of labels; NaN where
            nothing is compared.
        picture: returns the image's colours, (H, W, 3); None where it has none.
    """

    name: str
    error: Floats
    picture: Callable[[], NDArray[Any] | None]


def score(
    predictions: Path,
    truth: str | Path,
    done: Callable[[int], None] = lambda count: None,
    keep: Callable[[Scored, Map], None] = lambda scored, error: None,
    **options: Any,
) -> list[Scored]:
    """Return the scores of a folder of predictions.

    Args:
        predictions: a folder with a file for each image, or one file.
        truth: a dataset, a folder that ``render`` wrote, or with ``camera`` files or one file.
        done: called with the count of images after each.
        keep: called with each image's scores and the map of its errors.
        options: see :class:`Options`.

    Raises:
        ArgumentError: an image without a prediction, or one that cannot be compared.
    """
    chosen = Options(**options)
    lines = None
    if chosen.per == "set" and chosen.align != "none":
        lines = _lines_of_set(predictions, truth, chosen)
    scored = []
    for image in _truths(truth, chosen):
        with within(image.name):
            item, error = _scored(predictions, image, chosen, lines)
        scored.append(item)
        keep(item, error)
        done(len(scored))
    return scored


def _truths(truth: str | Path, options: Options) -> Iterator[Truth]:
    """Return the truth of each image."""
    return truths(truth, options.what, options.camera, options.truth_unit_m, options.cameras)


def _lines_of_set(predictions: Path, truth: str | Path, options: Options) -> tuple[Line, Line]:
    """Return the alignments of all images together, by pixel and by solid angle."""
    fits = Fit(options.align), Fit(options.align)
    for image in _truths(truth, options):
        pair = _pair(predictions, image, options)
        where = pair.compared.where
        p = pair.along[where]
        t = pair.truth.values[where]
        fits[0].add(p, t, np.ones(len(p)))
        fits[1].add(p, t, solid_angles(pair.truth.camera)[where])
    return fits[0].line(), fits[1].line()


@dataclass(frozen=True, eq=False)
class _Pair:
    """A prediction of depth and its truth, in one camera.

    Attributes:
        stored: (H, W) as it is stored.
        along: (H, W) metres along rays.
        truth: by the camera of both.
        compared: the pixels.
        resampled: what was done to its size.
    """

    stored: Array
    along: Array
    truth: Truth
    compared: Compared
    resampled: str


def _pair(predictions: Path, truth: Truth, options: Options) -> _Pair:
    """Return a prediction with the truth that its pixels see."""
    if options.predicted_camera is None:
        stored, resampled = prediction(predictions, truth)
    else:
        stored, truth = _crossed(predictions, truth, options.predicted_camera, options)
        resampled = f"compared at the pixels of {truth.camera.name!r}"
    along = as_range(stored * options.unit_m, options.form, truth.camera)
    compared = select(
        along,
        truth.values,
        truth.camera,
        doubt=truth.doubt,
        error=truth.error if options.has_intervals or options.bounded else None,
        bounded=options.bounded,
    )
    return _Pair(stored, along, truth, compared, resampled)


def _crossed(predictions: Path, truth: Truth, lens: Lens, options: Options) -> tuple[Array, Truth]:
    """Return a prediction by another camera, and the truth along its rays."""
    stored = read(file_of(predictions, truth.name, "depth"))
    camera = lens(stored.shape[1], stored.shape[0])
    seen = seen_by(truth.values, truth.doubt, truth.error, truth.camera, camera, options.rotation)
    error = None if truth.error is None else seen.error
    return stored, replace(truth, camera=camera, values=seen.depth, doubt=seen.doubt, error=error)


def _scored(
    predictions: Path, truth: Truth, options: Options, lines: tuple[Line, Line] | None
) -> tuple[Scored, Map]:
    """Return the scores of an image, and where it is wrong."""
    if not truth.camera.central:
        expected = f"expected a camera with one optical centre, got {truth.camera.name!r}"
        raise ArgumentError(f"{expected}: choose a dataset's cameras with --cameras")
    if options.what == "labels":
        return _scored_labels(predictions, truth)
    if options.what == "panoptic":
        return _scored_instances(predictions, truth)
    if options.what == "normals":
        return _scored_normals(predictions, truth)
    pair = _pair(predictions, truth, options)
    truth = pair.truth
    scores, aligned = compare(pair.along, truth.values, truth.camera, pair.compared, options.align, lines)
    mistakes = []
    if options.align == "none" and options.predicted_camera is None:
        mistakes = find_mistakes(pair.along, truth.values, truth.camera, truth.doubt)
    where = np.isfinite(aligned)
    item = Scored(
        truth.name,
        scores,
        mistakes,
        pair.resampled,
        truth.scene,
        dict(_extra(pair, aligned, where, options)),
        groups.group(aligned, truth.values, where, truth.camera),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.abs(aligned - truth.values) / truth.values
    return item, _map(truth, error)


def _map(truth: Truth, error: Array) -> Map:
    """Return where an image is wrong; its truth is not kept."""
    return Map(truth.name, error.astype(np.float32), truth.picture)


def _extra(pair: _Pair, aligned: Array, where: NDArray[Any], options: Options) -> Iterator[tuple[str, float]]:
    """Yield figures that are made on demand, by name."""
    truth = pair.truth
    if "edges" in options.also:
        # Where surfaces end the truth is in doubt by a pixel, but that is where edges are.
        has_both = np.isfinite(truth.values) & (truth.values > 0) & np.isfinite(pair.along) & (pair.along > 0)
        yield "boundary_f1", boundary_f1(pair.along, truth.values, has_both, truth.camera.wraps)
    if "points" in options.also:
        clouds = cloud(aligned, truth.camera, where), cloud(truth.values, truth.camera, where)
        for name, value in points(*clouds).figures().items():
            yield name, value
    if options.protocol:
        stored = pair.stored if options.form == "disparity" else pair.along
        for name, value in protocol(options.protocol, stored, truth.values, pair.compared.where).items():
            yield f"{options.protocol}: {name}", value


def _scored_labels(predictions: Path, truth: Truth) -> tuple[Scored, Map]:
    """Return the scores of an image's labels, and which are wrong."""
    values, resampled = prediction(predictions, truth, "labels")
    scores = labels(values, truth.values, truth.camera, truth.doubt)
    error = np.where(truth.doubt | (truth.values == 0), np.nan, values != truth.values)
    return Scored(truth.name, scores, [], resampled, truth.scene), Map(
        truth.name, error.astype(np.float32), truth.picture
    )


def _scored_instances(predictions: Path, truth: Truth) -> tuple[Scored, Map]:
    """Return the scores of an image's instances, and which classes are wrong."""
    values, resampled = prediction(predictions, truth, "panoptic")
    scores = panoptic_image(
        values,
        truth.values,
        truth.camera,
        truth.doubt,
        truth.class_of,
        lambda instance: instance // INSTANCES,
    )
    classes = np.vectorize(truth.class_of, otypes=[np.int64])(truth.values)
    error = np.where(truth.doubt | (truth.values == 0), np.nan, values // INSTANCES != classes)
    return Scored(truth.name, scores, [], resampled, truth.scene), Map(
        truth.name, error.astype(np.float32), truth.picture
    )


def _scored_normals(predictions: Path, truth: Truth) -> tuple[Scored, Map]:
    """Return the scores of an image's normals, and their angles."""
    values, resampled = prediction(predictions, truth, "normals")
    scores = normals(values, truth.values, truth.camera, truth.doubt)
    mistakes = find_frame(values, truth.values, truth.camera, truth.doubt)
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = values / np.linalg.norm(values, axis=-1, keepdims=True)
    cosine = np.clip((unit * truth.values).sum(axis=-1), -1, 1)
    is_known = ~truth.doubt & (np.abs(truth.values).sum(axis=-1) > 0)
    error = np.where(is_known, np.degrees(np.arccos(cosine)) / 100, np.nan)
    return Scored(truth.name, scores, mistakes, resampled, truth.scene), Map(
        truth.name, error.astype(np.float32), truth.picture
    )


def mean(scored: Sequence[Scored]) -> dict[str, dict[str, float]]:
    """Return the means over images of all measures, by the kind of weights; PQ is that of the set."""
    means: dict[str, dict[str, float]] = {}
    instances = [item.scores for item in scored if isinstance(item.scores, PanopticImage)]
    if instances:
        of_set = panoptic_set(instances)
        for weights, scores in zip(WEIGHTS, of_set, strict=True):
            means[weights] = {"pq": scores.pq, "sq": scores.sq, "rq": scores.rq}
        return means
    for weights in WEIGHTS:
        means[weights] = {}
        for measure in scored[0].figures(weights):
            values = [item.figures(weights)[measure] for item in scored]
            means[weights][measure] = float(np.mean(values))
    return means


def mean_within(scored: Sequence[Scored]) -> dict[str, dict[str, tuple[float, float]]]:
    """Return what those means can be by truths within their bounds, (least, greatest), by the kind of
    weights; nothing for a kind that an image has no interval of."""
    means: dict[str, dict[str, tuple[float, float]]] = {}
    for weights in WEIGHTS:
        bounds = [item.within(weights) for item in scored]
        if not all(bounds):
            continue
        means[weights] = {}
        for measure in bounds[0]:
            low, high = np.mean([bound[measure] for bound in bounds], axis=0)
            means[weights][measure] = float(low), float(high)
    return means


def mean_extra(scored: Sequence[Scored]) -> dict[str, float]:
    """Return the means over images of figures that were made on demand."""
    means = {}
    for name in scored[0].extra:
        means[name] = float(np.mean([item.extra[name] for item in scored]))
    return means


def all_groups(scored: Sequence[Scored]) -> Groups | None:
    """Return the sums of all images' groups; None for what has none."""
    total: Groups | None = None
    for item in scored:
        if item.groups is not None:
            total = item.groups if total is None else total + item.groups
    return total
