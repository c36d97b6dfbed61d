"""Boxes drawn over an image: in the image, on the sphere, in space; curves where the camera bends lines."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import one_of
from omniscv.cameras import Camera
from omniscv.geometry import Array
from omniscv.geometry.scene_geometry import BOX_EDGES, ObjectBox
from omniscv.truth.spherical import SphericalBox

Drawn = Literal["boxes", "bfov", "rbfov", "boxes3d"]
Picture = NDArray[np.uint8]

_STEPS = 48  # of an edge
_FAR_M = 1e4  # where directions are drawn: as good as infinitely far for optical centres a metre apart
_SUBPIXEL_BITS = 4


def draw_boxes(
    picture: Picture, camera: Camera, truth: Mapping[str, Any], what: Sequence[Drawn] = ("boxes",)
) -> Picture:
    """Return a copy of a picture with boxes drawn over it, each object in its own colour, with its name.

    Args:
        picture: (H, W, 3) uint8 RGB, as ``lit``.
        camera: of the picture.
        truth: the records of a frame: ``frame.truth``.
        what: which to draw; ``rbfov`` are the rotated ones of ``bfov``.

    Raises:
        ArgumentError: another word in ``what``.
    """
    drawn = picture.copy()
    width = max(1, round(camera.width / 800))
    for kind in what:
        one_of("what", kind, get_args(Drawn))
        for record in truth.get("bfov" if kind == "rbfov" else kind, ()):
            color, lines = _color(record["instance_id"]), outline(kind, camera, record)
            for line in lines:
                _draw(drawn, line, color, width, camera.wraps)
            _name(drawn, lines, record["name"], color)
    return drawn


def outline(kind: Drawn, camera: Camera, record: Mapping[str, Any]) -> list[Array]:
    """Return the lines of a box in an image, (N, 2) px each; NaN where the image does not show them."""
    return _LINES[kind](camera, record)


def _rectangle(camera: Camera, record: Mapping[str, Any]) -> list[Array]:
    """The four sides, which may go over the right border: their columns are counted on."""
    x, y, w, h = record.get("bbox_wrap", record["bbox"])
    corners = np.array([(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)], dtype=float)
    sides = [np.linspace(a, b, _STEPS) for a, b in itertools.pairwise(corners)]
    return [np.column_stack([side[:, 0] % camera.width, side[:, 1]]) for side in sides]


def _upright(camera: Camera, record: Mapping[str, Any]) -> list[Array]:
    return _on_sphere(camera, SphericalBox.of(record["bfov"]))


def _rotated(camera: Camera, record: Mapping[str, Any]) -> list[Array]:
    return _on_sphere(camera, SphericalBox.of(record["rbfov"]))


def _on_sphere(camera: Camera, box: SphericalBox) -> list[Array]:
    if box.kind == "lonlat":
        return []
    corners = box.corners()
    sides = [_between(a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return [_projected(camera, _FAR_M * side) for side in sides]


def _in_space(camera: Camera, record: Mapping[str, Any]) -> list[Array]:
    center, R_c_b, size = (np.array(record[key]) for key in ("center_camera", "R_camera_box", "size"))
    corners = ObjectBox(center, R_c_b, size, record["source"]).corners_w()
    return [_projected(camera, _between(*corners[edge])) for edge in BOX_EDGES]


_LINES = {"boxes": _rectangle, "bfov": _upright, "rbfov": _rotated, "boxes3d": _in_space}


def _between(a: Array, b: Array) -> Array:
    return np.linspace(a, b, _STEPS)


def _projected(camera: Camera, points_c: Array) -> Array:
    """(N, 2) px, NaN where no pixel sees a point."""
    return camera.project(points_c)[0]


def _draw(picture: Picture, line: Array, color: tuple[int, int, int], width: int, wraps: bool) -> None:
    """Draw the parts of a line that are in the image; none goes across a panorama to its other end."""
    for a, b in itertools.pairwise(line):
        if np.isnan(a + b).any() or (wraps and abs(a[0] - b[0]) > picture.shape[1] / 2):
            continue
        ends = np.round((np.stack([a, b]) - 0.5) * (1 << _SUBPIXEL_BITS)).astype(int).tolist()
        cv2.line(picture, ends[0], ends[1], color, width, cv2.LINE_AA, _SUBPIXEL_BITS)


def _name(picture: Picture, lines: list[Array], name: str, color: tuple[int, int, int]) -> None:
    """Write a name at the upper left end of what was drawn."""
    points = np.concatenate([np.empty((0, 2)), *lines])
    points = points[~np.isnan(points[:, 0])]
    if len(points):
        u, v = points[points.sum(axis=1).argmin()]
        size = max(0.35, picture.shape[1] / 2400)
        place = int(u), int(max(12.0, v - 3))
        cv2.putText(picture, name, place, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)


def _color(instance: int) -> tuple[int, int, int]:
    """A bright colour: hues a golden angle apart."""
    hue = np.array([[[instance * 0.618033988 % 1.0 * 179, 220, 255]]]).astype(np.uint8)
    r, g, b = cv2.cvtColor(hue, cv2.COLOR_HSV2RGB)[0, 0].tolist()
    return r, g, b
