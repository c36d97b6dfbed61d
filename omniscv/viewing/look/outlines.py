"""Layouts and boxes of a frame as lines in its image, for a page to draw over it.

A line is a flat list ``[u0, v0, u1, v1, ...]``, px.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from omniscv.dataset import Frame
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.viewing.draw_boxes import Drawn, outline

_STEP = 6  # samples of a layout's curve, at most half a pixel apart, to one that is kept
_KINDS: tuple[Drawn, ...] = ("boxes", "boxes3d")


def boxes(frame: Frame) -> dict[str, list[dict[str, Any]]]:
    """Return the boxes in the image and in space, by kind: ``id``, ``name``, ``class``, ``lines``.

    Raises:
        ArgumentError: records of another form.
    """
    with _records(frame, "truth"):
        return _boxes(frame)


def _boxes(frame: Frame) -> dict[str, list[dict[str, Any]]]:
    return {
        kind: [
            {
                "id": record["instance_id"],
                "name": record["name"],
                "class": record.get("class"),
                "lines": [
                    part for line in outline(kind, frame.camera, record) for part in _parts(_thinned(line))
                ],
            }
            for record in frame.truth[kind]
        ]
        for kind in _KINDS
        if frame.truth.get(kind)
    }


def layout(frame: Frame) -> dict[str, Any] | None:
    """Return a frame's layout; None without one.

    ``edges`` have a kind, a line, and whether it is seen, in the empty room too; so have ``corners``, with a
    pixel. ``floor`` is (N, 2), the room from above, world frame, metres.

    Raises:
        ArgumentError: a record of another form.
    """
    with _records(frame, "layout"):
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
        for line in _parts(_thinned(np.array(piece["pixels"], dtype=float)))
    ]
    corners = [
        {"kind": each["kind"], "room": each["visible_room"], "seen": each["visible"] is not False,
         "pixel": each["pixel"]}
        for each in record["corners"]
        if each["in_image"]
    ]  # fmt: skip
    floor = [each["world"][:2] for each in record["corners"] if each["kind"] == "floor"]
    return {"edges": edges, "corners": corners, "floor": floor}


@contextmanager
def _records(frame: Frame, kind: str) -> Iterator[None]:
    """Raise what is wrong with a file of records as an ArgumentError that names it."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as cause:
        raise ArgumentError(f"{frame.files[kind]}: expected {kind} records, got: {cause!r}") from cause


def _thinned(pixels: Array) -> Array:
    """Every few points of a curve, and its end."""
    return pixels if len(pixels) < 3 else np.concatenate([pixels[:-1:_STEP], pixels[-1:]])


def _parts(line: Array) -> Iterable[list[float]]:
    """The parts of a line (N, 2) between points that are not in the image."""
    gaps = np.flatnonzero(~np.isfinite(line).all(axis=1))
    for part in np.split(line, gaps):
        known = part[np.isfinite(part).all(axis=1)]
        if len(known) > 1:
            yield np.round(known, 1).ravel().tolist()
