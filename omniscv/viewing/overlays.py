"""Truth drawn over an image: layouts, and boxes in the image, on the sphere, in space.

Straight lines are drawn as the curves that the camera makes of them.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import one_of
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.scene_geometry import BOX_EDGES, ObjectBox
from omniscv.truth.spherical import SphericalBox

BoxKind = Literal["boxes", "bfov", "rbfov", "boxes3d"]
Picture = NDArray[np.uint8]
RGB = tuple[int, int, int]

_STEPS = 48  # of an edge
_FAR_M = 1e4  # distance of directions: practically infinite for optical centres a metre apart
_SUBPIXEL_BITS = 4

_COLORS = {"floor": (255, 190, 40), "ceiling": (60, 200, 255), "vertical": (110, 255, 110)}
_GREY = (150, 150, 150)
_BEHIND_FURNITURE = 0.75  # of the colour's strength
_DASH_PX = 10


def draw_boxes(
    picture: Picture, camera: Camera, truth: Mapping[str, Any], what: Sequence[BoxKind] = ("boxes",)
) -> Picture:
    """Return a copy of a picture with boxes drawn over it, with a colour and the name of each object.

    Args:
        picture: (H, W, 3) uint8 RGB, as ``lit``.
        camera: of the picture.
        truth: the records of a frame: ``frame.truth``.
        what: the boxes to draw; ``rbfov`` are the rotated ones of ``bfov``.

    Raises:
        ArgumentError: another word in ``what``.
    """
    drawn = picture.copy()
    width = max(1, round(camera.width / 800))
    for kind in what:
        one_of("what", kind, get_args(BoxKind))
        for record in truth.get("bfov" if kind == "rbfov" else kind, ()):
            color, lines = _color(record["instance_id"]), box_lines(kind, camera, record)
            for line in lines:
                _draw_line(drawn, line, color, width, camera.wraps)
            _draw_name(drawn, lines, record["name"], color)
    return drawn


def box_lines(kind: BoxKind, camera: Camera, record: Mapping[str, Any]) -> list[Array]:
    """Return the lines of a box in an image, (N, 2) px each; NaN where the image does not show them."""
    if kind == "boxes":
        return _rectangle(camera, record.get("bbox_wrap", record["bbox"]))
    if kind == "boxes3d":
        center, R_c_b, size = (np.array(record[key]) for key in ("center_camera", "R_camera_box", "size"))
        corners = ObjectBox(center, R_c_b, size, record["source"]).corners_w()
        return [camera.project(np.linspace(a, b, _STEPS))[0] for a, b in corners[np.array(BOX_EDGES)]]
    box = SphericalBox.of(record[kind])
    if box.kind == "lonlat":
        return []
    sides = itertools.pairwise([*box.corners(), box.corners()[0]])
    return [camera.project(_FAR_M * np.linspace(a, b, _STEPS))[0] for a, b in sides]


def _rectangle(camera: Camera, bbox: Sequence[float]) -> list[Array]:
    """The four sides. Columns beyond the right border continue at the left."""
    x, y, w, h = bbox
    corners = np.array([(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)], dtype=float)
    sides = [np.linspace(a, b, _STEPS) for a, b in itertools.pairwise(corners)]
    return [np.column_stack([side[:, 0] % camera.width, side[:, 1]]) for side in sides]


def _draw_line(drawn: Picture, line: Array, color: RGB, width: int, wraps: bool) -> None:
    """Draw the parts of a line that are in the image, without the jumps over a panorama's seam."""
    for a, b in itertools.pairwise(line):
        if np.isnan(a + b).any() or (wraps and abs(a[0] - b[0]) > drawn.shape[1] / 2):
            continue
        start, end = _fixed([a, b]).tolist()
        cv2.line(drawn, start, end, color, width, cv2.LINE_AA, _SUBPIXEL_BITS)


def _draw_name(drawn: Picture, lines: list[Array], name: str, color: RGB) -> None:
    """Write a name at the upper left end of lines."""
    points = np.concatenate([np.empty((0, 2)), *lines])
    points = points[~np.isnan(points[:, 0])]
    if len(points):
        u, v = points[points.sum(axis=1).argmin()]
        size = max(0.35, drawn.shape[1] / 2400)
        at = int(u), int(max(12.0, v - 3))
        cv2.putText(drawn, name, at, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)


def _color(instance: int) -> RGB:
    """A bright colour: hues a golden angle apart."""
    hue = np.array([[[instance * 0.618033988 % 1.0 * 179, 220, 255]]]).astype(np.uint8)
    r, g, b = cv2.cvtColor(hue, cv2.COLOR_HSV2RGB)[0, 0].tolist()
    return r, g, b


def draw_layout(picture: Picture, record: Mapping[str, Any]) -> Picture:
    """Return a copy of a picture with a layout drawn over it.

    Edges of the floor are amber, of the ceiling blue, between walls green; dashed behind furniture, thin and
    grey behind walls of the room. Corners are rings, filled where they are visible.

    Args:
        picture: (H, W, 3) uint8 RGB.
        record: of the layout in the image; see :func:`omniscv.truth.project_layout`.

    Raises:
        ArgumentError: another picture.
    """
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        got = f"{picture.dtype} of shape {picture.shape}"
        raise ArgumentError(f"picture: expected (H, W, 3) uint8, got {got}")
    drawn = np.ascontiguousarray(picture).copy()
    width = max(1, round(min(picture.shape[:2]) / 256))
    edges = [(edge["kind"], piece) for edge in record["edges"] for piece in edge["pieces"]]
    for kind, piece in sorted(edges, key=lambda edge: bool(edge[1]["visible_room"])):  # hidden ones below
        _draw_piece(drawn, piece, _COLORS[kind], width)
    for corner in record["corners"]:
        if corner["in_image"]:
            _draw_corner(drawn, corner, width)
    return drawn


def _draw_piece(drawn: Picture, piece: Mapping[str, Any], color: RGB, width: int) -> None:
    pixels = np.array(piece["pixels"])
    if not piece["visible_room"]:
        _draw_curve(drawn, pixels, _GREY, 1)
    elif piece["visible"] in (True, None):
        _draw_curve(drawn, pixels, color, width)
    else:
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1)))
        dash = np.floor(along / (_DASH_PX * width)).astype(int)
        r, g, b = (round(_BEHIND_FURNITURE * channel) for channel in color)
        for index in range(0, int(dash[-1]) + 1, 2):
            _draw_curve(drawn, pixels[dash == index], (r, g, b), width)


def _draw_curve(drawn: Picture, pixels: Array, color: RGB, width: int) -> None:
    cv2.polylines(drawn, [_fixed(pixels)], False, color, width, cv2.LINE_AA, _SUBPIXEL_BITS)


def _draw_corner(drawn: Picture, corner: Mapping[str, Any], width: int) -> None:
    color = _COLORS[corner["kind"]] if corner["visible_room"] else _GREY
    filled = corner["visible_room"] and corner["visible"] in (True, None)
    center, radius = _fixed(corner["pixel"]).tolist(), (2 + 2 * width) << _SUBPIXEL_BITS
    cv2.circle(drawn, center, radius, color, -1 if filled else width, cv2.LINE_AA, _SUBPIXEL_BITS)


def _fixed(pixels: Any) -> NDArray[np.int32]:
    """Pixels in OpenCV's fixed point, whose pixel 0 has its centre at 0."""
    return np.round((np.asarray(pixels) - 0.5) * (1 << _SUBPIXEL_BITS)).astype(np.int32)
