"""``checks: beat``: what captures of another size say of the same pixels.

A structure that meets all pixels of a picture at nearly the same phase looks smooth there; not in the other.
"""

from collections.abc import Container
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.geometry.arrays import Ints

_WINDOW_PX, _DENSE = (7, 7), 0.2
"""px of the image, and the share of them that only the finer capture marks, from which on all are marked: an
object's edge is a line, of which the finer capture marks a part."""

Layers = dict[str, NDArray[Any]]


def compare(modes: Container[str], layers: Layers, finer: Layers, at: Ints, shape: tuple[int, ...]) -> None:
    """Widen ``depth_error`` and ``label_edge`` of an image (H, W) to those of finer captures, and where the
    two differ in some modes. Layers are flat, and ``at`` are the flat indices of the pixels."""
    lost = np.zeros(len(at), np.bool_)
    if "depth" in modes:
        error, other = layers["depth_error"][at], finer["depth_error"][at]
        with np.errstate(invalid="ignore"):  # of two rays that meet nothing
            apart = np.abs(layers["depth"][at] - finer["depth"][at]) > error + other
        layers["depth_error"][at] = np.where(apart, np.inf, np.maximum(error, other))
        lost = apart | (np.isinf(other) & np.isfinite(error))
    if "object_mask" in modes:
        edge, found = layers["label_edge"], np.zeros((2, *shape), np.float32)
        differ = (layers["object_mask"][at] != finer["object_mask"][at]).reshape(len(at), -1).any(axis=1)
        lost |= finer["label_edge"][at] | differ
        found.reshape(2, -1)[:, at] = lost & ~edge[at], np.ones(len(at))
        many, of_all = (cv2.blur(each, _WINDOW_PX).reshape(-1)[at] for each in found)
        edge[at] |= lost | (many > _DENSE * of_all)
