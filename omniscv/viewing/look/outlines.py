"""Layouts and boxes of a frame as lines in its image, for a page to draw over it.

A line is a flat list ``[u0, v0, u1, v1, ...]``, px.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from omniscv.dataset import Frame
from omniscv.geometry import Array
from omniscv.viewing.overlays import BoxKind, box_lines

_STEP = 6  # every so many samples of a curve, at most half a pixel apart, are kept
_KINDS: tuple[BoxKind, ...] = ("boxes", "boxes3d")


def boxes(frame: Frame) -> dict[str, list[dict[str, Any]]]:
    """Return the boxes in the image and in space, by kind: ``id``, ``name``, ``class``, ``lines``."""
    kinds = [kind for kind in _KINDS if frame.truth.get(kind)]
    return {kind: [_box(frame, kind, record) for record in frame.truth[kind]] for kind in kinds}


def _box(frame: Frame, kind: BoxKind, record: Mapping[str, Any]) -> dict[str, Any]:
    lines = [part for line in box_lines(kind, frame.camera, record) for part in _parts(line)]
    name, instance = record["name"], record["instance_id"]
    return {"id": instance, "name": name, "class": record.get("class"), "lines": lines}


def layout(frame: Frame) -> dict[str, Any] | None:
    """Return a frame's layout; None without one.

    ``edges`` have ``kind``, ``line``, and visibility in the empty room and in the furnished one: ``room``,
    ``seen``; ``corners`` have ``pixel`` in place of ``line``. ``floor`` is (N, 2), the room from above, world
    frame, metres.
    """
    return _layout(frame.layout) if frame.layout else None


def _layout(record: Mapping[str, Any]) -> dict[str, Any]:
    edges = [
        {
            "kind": edge["kind"],
            "room": piece["visible_room"],
            "seen": piece["visible"] is not False,
            "line": line,
        }
        for edge in record["edges"]
        for piece in edge["pieces"]
        for line in _parts(np.array(piece["pixels"], dtype=float))
    ]
    corners = [
        {
            "kind": corner["kind"],
            "room": corner["visible_room"],
            "seen": corner["visible"] is not False,
            "pixel": corner["pixel"],
        }
        for corner in record["corners"]
        if corner["in_image"]
    ]
    floor = [corner["world"][:2] for corner in record["corners"] if corner["kind"] == "floor"]
    return {"edges": edges, "corners": corners, "floor": floor}


def _parts(pixels: Array) -> Iterable[list[float]]:
    """The parts of a line (N, 2) px between points that are not in the image, of every few points."""
    line = pixels if len(pixels) < 3 else np.concatenate([pixels[:-1:_STEP], pixels[-1:]])
    gaps = np.flatnonzero(~np.isfinite(line).all(axis=1))
    for part in np.split(line, gaps):
        known = part[np.isfinite(part).all(axis=1)]
        if len(known) > 1:
            yield np.round(known, 1).ravel().tolist()
