"""Scores of predicted labels: mIoU, mAcc and panoptic quality.

Sources: Everingham and others, The Pascal visual object classes challenge, 2015 (intersection over union of a
class); Long, Shelhamer and Darrell, Fully convolutional networks, 2015 (mean accuracy); Kirillov and others,
Panoptic segmentation, 2019 (PQ).

A truth in doubt may be the label of a neighbour. Such pixels are left out of the figures. The interval of an
IoU lets them have any label that the truth has within one pixel.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import shown
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Ints, Mask
from omniscv.score.areas import seen_pixels, solid_angles

UNKNOWN = 0
"""A true label of nothing: left out."""


@dataclass(frozen=True)
class LabelMeasures:
    """Measures with one kind of weights.

    Attributes:
        miou: mean over the labels of the truth of intersection over union.
        macc: mean over these of the share of their pixels that are right.
        accuracy: share of pixels that are right.
        miou_low, miou_high: what ``miou`` can be by doubtful pixels.
        iou: by label.
    """

    miou: float
    macc: float
    accuracy: float
    miou_low: float
    miou_high: float
    iou: dict[int, float]


@dataclass(frozen=True)
class LabelScores:
    """The scores of one picture of labels.

    Attributes:
        by_pixel, by_solid_angle: the measures.
        compared: pixels with a true label beyond doubt.
        in_doubt: pixels whose true label is in doubt: left out.
    """

    by_pixel: LabelMeasures
    by_solid_angle: LabelMeasures
    compared: int
    in_doubt: int

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)


def labels(
    predicted: ArrayLike, truth: ArrayLike, camera: Camera, doubt: ArrayLike | None = None
) -> LabelScores:
    """Return the scores of predicted labels.

    Args:
        predicted: (H, W) whole numbers.
        truth: (H, W) whole numbers, 0 where nothing is known.
        camera: of both pictures, with one optical centre.
        doubt: (H, W) bool, pixels whose label may be a neighbour's.

    Raises:
        ArgumentError: pictures of other sizes than the camera's, no whole numbers, or no label to compare.
    """
    shape = (camera.height, camera.width)
    p = _picture("predicted", predicted, shape)
    t = _picture("truth", truth, shape)
    doubtful = np.zeros(shape, np.bool_) if doubt is None else np.asarray(doubt, np.bool_)
    has_truth = seen_pixels(camera) & (t != UNKNOWN)
    compared = has_truth & ~doubtful
    if not compared.any():
        raise ArgumentError("truth: expected a pixel with a label beyond doubt, got none")
    doubtful = seen_pixels(camera) & doubtful
    return LabelScores(
        by_pixel=_measures(p, t, compared, doubtful, np.ones(shape)),
        by_solid_angle=_measures(p, t, compared, doubtful, solid_angles(camera)),
        compared=int(np.count_nonzero(compared)),
        in_doubt=int(np.count_nonzero(doubtful & has_truth)),
    )


def _picture(name: str, values: ArrayLike, shape: tuple[int, int]) -> Ints:
    """Return a picture of labels; ArgumentError with its ``name`` for another one."""
    detach = getattr(values, "detach", None)
    array = np.asarray(values if detach is None else detach().cpu())
    if array.shape == (*shape, 1):
        array = array[..., 0]
    if array.shape != shape:
        expected = f"{name}: expected (H, W) = {shape}, as its camera has"
        raise ArgumentError(f"{expected}, got an array of shape {shown(array.shape)}")
    whole = array.astype(np.int64)
    if array.dtype.kind not in "iub" and not np.array_equal(whole, array):
        raise ArgumentError(f"{name}: expected whole numbers, got {array.dtype}")
    return whole


def _measures(p: Ints, t: Ints, compared: Mask, doubtful: Mask, weights: Array) -> LabelMeasures:
    """Return the measures with weights (H, W)."""
    iou = {}
    low = []
    high = []
    right = []
    for label in np.unique(t[compared]):
        of_p = p == label
        of_t = t == label
        both = weights[compared & of_p & of_t].sum()
        either = weights[compared & (of_p | of_t)].sum()
        can_be = doubtful & _near(of_t)
        iou[int(label)] = float(both / either)
        right.append(both / weights[compared & of_t].sum())
        low.append(both / (either + weights[doubtful & (of_p | can_be)].sum()))
        won = weights[can_be & of_p].sum()
        high.append((both + won) / (either + weights[doubtful & of_p].sum()))
        high[-1] = max(high[-1], both / either)
    share = weights[compared] / weights[compared].sum()
    return LabelMeasures(
        miou=float(np.mean(list(iou.values()))),
        macc=float(np.mean(right)),
        accuracy=float(share @ (p == t)[compared]),
        miou_low=float(np.mean(low)),
        miou_high=float(np.mean(high)),
        iou=iou,
    )


def _near(mask: Mask) -> Mask:
    """Return the pixels within one pixel of a mask's."""
    import cv2

    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)), np.bool_)


Sums = dict[int, list[float]]
"""By class: the IoUs of matches, how many matches there are, and instances without one: predicted, true."""


@dataclass(frozen=True)
class PanopticScores:
    """Panoptic quality.

    Attributes:
        pq: mean over classes of the sum of IoUs of matches over matches and half of what is not matched.
        sq: mean over classes of the mean IoU of matches.
        rq: mean over classes of the F1 score of matches.
        by_class: PQ of each class of either picture.
    """

    pq: float
    sq: float
    rq: float
    by_class: dict[int, float]


@dataclass(frozen=True)
class PanopticImage:
    """The panoptic quality of one picture, with the sums of which that of a set is made.

    Attributes:
        by_pixel, by_solid_angle: the measures.
        compared: pixels with a true instance beyond doubt.
        in_doubt: pixels whose true instance is in doubt: taken as unknown.
        sums: by pixel and by solid angle.
    """

    by_pixel: PanopticScores
    by_solid_angle: PanopticScores
    compared: int
    in_doubt: int
    sums: tuple[Sums, Sums]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, without the sums."""
        values = asdict(self)
        del values["sums"]
        return values


def panoptic_image(
    predicted: ArrayLike,
    truth: ArrayLike,
    camera: Camera,
    doubt: ArrayLike,
    class_of: Callable[[int], int],
    predicted_class_of: Callable[[int], int],
) -> PanopticImage:
    """Return the panoptic quality of a picture by a camera.

    Args:
        predicted: (H, W) instance ids; 0: none.
        truth: (H, W) instance ids; 0: unknown.
        camera: of both pictures, with one optical centre.
        doubt: (H, W) bool, pixels whose instance may be a neighbour's.
        class_of: returns the class of a true instance.
        predicted_class_of: returns that of a predicted one.

    Raises:
        ArgumentError: pictures of other sizes than the camera's, or no instance to compare.
    """
    shape = (camera.height, camera.width)
    doubtful = np.asarray(doubt, np.bool_)
    seen = seen_pixels(camera)
    of_truth = _picture("truth", truth, shape)
    p = np.where(seen, _picture("predicted", predicted, shape), 0)
    t = np.where(seen & ~doubtful, of_truth, UNKNOWN)
    if not t.any():
        raise ArgumentError("truth: expected a pixel with an instance beyond doubt, got none")
    classes = {int(instance): class_of(int(instance)) for instance in np.unique(t)}
    predicted_classes = {int(instance): predicted_class_of(int(instance)) for instance in np.unique(p)}
    by_pixel = _sums(p, t, predicted_classes, classes, np.ones(shape))
    by_solid_angle = _sums(p, t, predicted_classes, classes, solid_angles(camera))
    return PanopticImage(
        by_pixel=_panoptic(by_pixel),
        by_solid_angle=_panoptic(by_solid_angle),
        compared=int(np.count_nonzero(t)),
        in_doubt=int(np.count_nonzero(seen & doubtful & (of_truth != UNKNOWN))),
        sums=(by_pixel, by_solid_angle),
    )


def panoptic_set(images: Sequence[PanopticImage]) -> tuple[PanopticScores, PanopticScores]:
    """Return the quality of all pictures together, by pixel and by solid angle: of their summed matches."""
    totals: tuple[Sums, Sums] = ({}, {})
    for image in images:
        for total, sums in zip(totals, image.sums, strict=True):
            for of_class, row in sums.items():
                before = total.get(of_class, [0.0, 0.0, 0.0, 0.0])
                total[of_class] = [a + b for a, b in zip(before, row, strict=True)]
    return _panoptic(totals[0]), _panoptic(totals[1])


def panoptic(
    predicted: ArrayLike,
    truth: ArrayLike,
    predicted_classes: Mapping[int, int],
    classes: Mapping[int, int],
    weights: Array | None = None,
) -> PanopticScores:
    """Return the panoptic quality of predicted instances.

    Instances of one class match where their IoU is above one half. Pixels without a true instance (0) count
    for no IoU, and predicted instances that lie there by more than half are no mistakes.

    Args:
        predicted: (H, W) instance ids; 0: none.
        truth: (H, W) instance ids; 0: unknown.
        predicted_classes: class of each predicted instance.
        classes: class of each true instance.
        weights: (H, W) of pixels; None: 1.

    Raises:
        ArgumentError: pictures of different sizes, or an instance without a class.
    """
    p = np.asarray(predicted).astype(np.int64)
    t = np.asarray(truth).astype(np.int64)
    if p.shape != t.shape:
        raise ArgumentError(f"predicted: expected a picture of shape {t.shape}, got {p.shape}")
    pixel_weights = np.ones(p.shape) if weights is None else weights
    return _panoptic(_sums(p, t, predicted_classes, classes, pixel_weights))


def _sums(
    p: Ints, t: Ints, predicted_classes: Mapping[int, int], classes: Mapping[int, int], weights: Array
) -> Sums:
    """Return what the quality of pictures of instances is made of; arguments as of :func:`panoptic`."""
    for instance in np.unique(t).tolist():
        if instance != UNKNOWN:
            _class_of(instance, classes, "truth")
    for instance in np.unique(p).tolist():
        if instance != 0:
            _class_of(instance, predicted_classes, "predicted")
    shared = _shared(p, t, weights)
    of_p = _sizes(shared, 0)
    of_t = _sizes(shared, 1)
    sums: Sums = {}
    matched: set[tuple[int, int]] = set()
    for (i, j), area in shared.items():
        if i == 0 or j == UNKNOWN or predicted_classes[i] != classes[j]:
            continue
        iou = area / (of_p[i] - shared.get((i, UNKNOWN), 0.0) + of_t[j] - area)
        if iou > 0.5:
            row = sums.setdefault(classes[j], [0.0, 0.0, 0.0, 0.0])
            row[0] += iou
            row[1] += 1
            matched.add((i, j))
    for instance in {*of_t} - {UNKNOWN} - {j for _, j in matched}:
        sums.setdefault(classes[instance], [0.0, 0.0, 0.0, 0.0])[3] += 1
    for instance in {*of_p} - {0} - {i for i, _ in matched}:
        if shared.get((instance, UNKNOWN), 0.0) <= of_p[instance] / 2:
            sums.setdefault(predicted_classes[instance], [0.0, 0.0, 0.0, 0.0])[2] += 1
    return sums


def _shared(p: Ints, t: Ints, weights: Array) -> dict[tuple[int, int], float]:
    """Return the weights that each predicted and each true instance share."""
    pairs, index = np.unique(np.stack([p.ravel(), t.ravel()]), axis=1, return_inverse=True)
    areas = np.bincount(index.ravel(), weights.ravel())
    return {(int(i), int(j)): float(area) for (i, j), area in zip(pairs.T, areas, strict=True)}


def _sizes(shared: Mapping[tuple[int, int], float], which: int) -> dict[int, float]:
    """Return the weight of each instance of one picture."""
    sizes: dict[int, float] = {}
    for pair, area in shared.items():
        sizes[pair[which]] = sizes.get(pair[which], 0.0) + area
    return sizes


def _class_of(instance: int, classes: Mapping[int, int], name: str) -> int:
    """Return the class of an instance; ArgumentError for none."""
    if instance not in classes:
        raise ArgumentError(f"{name}: expected a class of instance {instance}, got none")
    return classes[instance]


def _panoptic(sums: Mapping[int, list[float]]) -> PanopticScores:
    """Return the means over classes."""
    by_class = {}
    qualities = []
    recognitions = []
    for of_class, (total, matches, alone, lost) in sums.items():
        recognition = matches / (matches + alone / 2 + lost / 2) if matches + alone + lost else 0.0
        quality = total / matches if matches else 0.0
        by_class[of_class] = quality * recognition
        qualities.append(quality)
        recognitions.append(recognition)
    if not by_class:
        return PanopticScores(0.0, 0.0, 0.0, {})
    pq = float(np.mean(list(by_class.values())))
    return PanopticScores(pq, float(np.mean(qualities)), float(np.mean(recognitions)), by_class)
