"""Measures of predicted layouts against the truth, as published.

Corners in upright panoramas: :func:`layout_scores`; sources: sunset1995/HorizonNet eval_general.py
(intersection over union, depth), zhigangjiang/LGT-Net evaluation/accuracy.py (corner and pixel error).
CFL's maps: :func:`map_scores`; source: cfernandezlab/CFL test_CFL.py.
Plans are intersected by shapely (the extra ``evaluate``).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import shown
from omniscv.cameras import create
from omniscv.errors import ArgumentError, OmniscvError
from omniscv.geometry.pose import R_LEVEL, Array
from omniscv.geometry.scene_geometry import Room
from omniscv.truth.layout_labels import room_seen
from omniscv.truth.room_in_image import first_hits

_CLOSE = 1.25  # ratio of depths that count as equal
# CFL's thresholds, which differ on purpose
_TRUE_FROM = 0.01
_PREDICTED_ABOVE = 0.1


class LayoutScores(NamedTuple):
    """Scores of one panorama.

    Attributes:
        iou_2d: intersection over union of the plans, 0 to 1.
        iou_3d: intersection over union of the volumes, 0 to 1.
        corner_error: mean distance of corners, percent of the image's diagonal; None for unequal counts.
        pixel_error: percent of pixels with another of ceiling, wall and floor.
        rmse_m: of the depth along rays, metres, for a camera 1.6 m above the floor.
        delta_1: share of pixels whose depths are within a factor of 1.25.
    """

    iou_2d: float
    iou_3d: float
    corner_error: float | None
    pixel_error: float
    rmse_m: float
    delta_1: float


class MapScores(NamedTuple):
    """Scores of one map of edges or corners; all 0 to 1."""

    precision: float
    recall: float
    accuracy: float
    f1: float
    iou: float


def layout_scores(found: ArrayLike, truth: ArrayLike, width: int = 1024, height: int = 512) -> LayoutScores:
    """Return the measures of predicted corners against the true ones.

    Args:
        found: (2N, 2) px as :mod:`omniscv.truth.layout_labels` orders them; the depth of a column is that of
            the nearest wall, the ceiling is level.
        truth: the true corners, in the same form.
        width: of the panorama, px.
        height: of the panorama, px.

    Raises:
        ArgumentError: corners that no upright panorama has, or whose plan crosses itself.
        OmniscvError: shapely is not installed.
    """
    room = room_seen(found, width, height)
    true_room = room_seen(truth, width, height)
    area, true_area, shared = _areas(room, true_room)
    room_height = room.ceiling_z - room.floor_z
    true_height = true_room.ceiling_z - true_room.floor_z
    volumes = area * room_height + true_area * true_height
    volume = shared * min(room_height, true_height)
    depth, kind = _depth(room, width, height)
    true_depth, true_kind = _depth(true_room, width, height)
    ratio = np.maximum(depth / true_depth, true_depth / depth)
    return LayoutScores(
        iou_2d=shared / (area + true_area - shared),
        iou_3d=volume / (volumes - volume),
        corner_error=_corner_error(np.asarray(found), np.asarray(truth), width, height),
        pixel_error=100 * float((kind != true_kind).mean()),
        rmse_m=float(np.sqrt(((depth - true_depth) ** 2).mean())),
        delta_1=float((ratio < _CLOSE).mean()),
    )


def map_scores(found: ArrayLike, truth: ArrayLike) -> MapScores:
    """Return CFL's measures of a predicted map against the true one.

    Predictions count above 0.1, the truth from 0.01, so a map against itself has a precision of 1 and a
    recall below 1.

    Args:
        found: (H, W) 0 to 1.
        truth: (H', W') uint8, resized to the size of ``found`` as Pillow does, like CFL.

    Raises:
        ArgumentError: arrays of another kind.
    """
    from PIL import Image

    prediction = np.asarray(found)
    expected = np.asarray(truth)
    if prediction.ndim != 2 or expected.ndim != 2 or expected.dtype != np.uint8:
        kinds = shown((prediction.shape, expected.shape, expected.dtype.name))
        raise ArgumentError(f"maps: expected (H, W) numbers and a uint8 (H, W) map, got {kinds}")
    size = prediction.shape[::-1]
    resized = np.asarray(Image.fromarray(expected).resize(size)) / 255.0
    positive = prediction > _PREDICTED_ABOVE
    true = resized >= _TRUE_FROM
    both = int((positive & true).sum())
    either = int((positive | true).sum())
    precision = _ratio(both, positive.sum())
    recall = _ratio(both, true.sum())
    f1 = _ratio(2 * precision * recall, precision + recall)
    return MapScores(precision, recall, float((positive == true).mean()), f1, _ratio(both, either))


def _ratio(part: float, whole: float) -> float:
    return float(part / whole) if whole else 0.0


def _areas(first: Room, second: Room) -> tuple[float, float, float]:
    """Return the areas of the plans of two rooms, and of their intersection, square metres."""
    try:
        from shapely import Polygon
    except ImportError as cause:
        raise OmniscvError("layout_scores: expected shapely; install omniscv[evaluate]") from cause
    plan = Polygon(first.corners_w)
    other = Polygon(second.corners_w)
    if not (plan.is_valid and other.is_valid):
        raise ArgumentError("cor_id: expected corners in the order of a plan that does not cross itself")
    return plan.area, other.area, plan.intersection(other).area


def _depth(room: Room, width: int, height: int) -> tuple[Array, NDArray[np.int16]]:
    """(H, W) metres along the rays, and 0, 1, 2 of wall, floor, ceiling."""
    directions_w = create("equirectangular", width, height).unproject().directions @ R_LEVEL.T
    hits = first_hits(room, np.zeros(3), directions_w)
    return hits.distance, np.maximum(hits.surface - np.int16(len(room.corners_w) - 1), np.int16(0))


def _corner_error(found: Array, truth: Array, width: int, height: int) -> float | None:
    """Return the mean distance of corners, percent of the image's diagonal; None for unequal counts."""
    if found.shape != truth.shape:
        return None
    distance = np.linalg.norm(_from_the_left(found) - _from_the_left(truth), axis=1).mean()
    return 100 * float(distance / np.hypot(width, height))


def _from_the_left(corners: Array) -> Array:
    """Return corners (2N, 2) in the same cyclic order, from the pair whose floor is leftmost."""
    return np.roll(corners, -2 * int(corners[1::2, 0].argmin()), axis=0)
