"""Checks of the layers of a frame: each as its row of the modalities says, and consistent with the others."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.errors import ArgumentError
from omniscv.frame import Frame

_UNIT = 1e-3  # how far the length of a normal may be off 1, or off 0


def layer_faults(frame: Frame) -> Iterator[str]:
    """Yield a line for every fault of a frame's layers."""
    layers: dict[str, NDArray[Any]] = {}
    size = (frame.camera.height, frame.camera.width)
    for row in modalities.layers():
        if row.name not in frame.files:
            continue
        try:
            layers[row.name] = frame.layer(row.name)
        except ArgumentError as wrong:
            yield str(wrong)
            continue
        if layers[row.name].shape[:2] != size:
            yield f"{frame.key}: {row.name}: expected {size} pixels, got {layers.pop(row.name).shape[:2]}"
    for name, faults in _CHECKS.items():
        if name in layers:
            for fault in faults(frame, layers):
                yield f"{frame.key}: {name}: {fault}"


def _depth(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    depth, valid = layers["depth"], frame.valid
    yield from _count(np.isnan(depth) | (depth < 0), "metres >= 0, or inf")
    yield from _count(valid & (depth == 0), "more than 0 m inside the field of view")
    yield from _count(~valid & (depth != 0), "0 outside the field of view")


def _labels(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    known = np.zeros(1 << 16, bool)
    known[[0, *frame.instances.values()]] = True
    yield from _count(~known[layers["labels"]], "instance ids of the dataset")
    yield from _count(~frame.valid & (layers["labels"] != 0), "0 outside the field of view")


def _classes(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    if frame.classes is None or "labels" not in layers:
        yield "expected no such layer without labels, and classes in the manifest"
        return
    wanted = frame.classes.ids(frame.instances)[layers["labels"]]
    yield from _count(layers["classes"] != wanted, "the class of the object in labels")


def _normals(frame: Frame, layers: dict[str, NDArray[Any]]) -> Iterator[str]:
    length = np.linalg.norm(layers["normals"].astype(np.float64), axis=-1)
    yield from _count(~((np.abs(length - 1) <= _UNIT) | (length <= _UNIT)), "unit vectors, or 0")


def _count(wrong: NDArray[np.bool_], wanted: str) -> Iterator[str]:
    if count := int(np.count_nonzero(wrong)):
        yield f"expected {wanted}, got {count} other pixels"


_CHECKS = {"depth": _depth, "labels": _labels, "classes": _classes, "normals": _normals}
