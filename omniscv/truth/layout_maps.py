"""Maps of a layout's edges and corners, as CFL learns them, for every camera."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.job.recipe import Visibility
from omniscv.truth.layout_curves import radians_per_pixel
from omniscv.truth.layout_record import room_of
from omniscv.truth.room_surfaces import first_hits

Map = NDArray[np.uint8]

_EDGE_SIGMA, _CORNER_SIGMA = 0.0054, 0.0107  # of the pixels around the horizon, as in published maps
_REACH = np.sqrt(2 * np.log(255 / 0.5))  # sigmas; beyond, 255 times a Gaussian rounds to 0
_ORIGINAL_EDGE, _ORIGINAL_CORNER = 0.0065, 0.009  # blur radii, of the longer side
_CANNY = 100, 200
_LEVELS = 5  # of each channel: steps of 63 exceed Canny's thresholds


def exact_maps(
    record: Mapping[str, Any],
    camera: Camera,
    edge_sigma: float = _EDGE_SIGMA,
    corner_sigma: float = _CORNER_SIGMA,
    visibility: Visibility = "room",
) -> tuple[Map, Map]:
    """Return (H, W) uint8 maps of edges and of corners: ``255 exp(-d^2 / 2 sigma^2)``.

    d is the distance, px, to the nearest sample of a curve or the nearest corner, also across the seam of a
    panorama. Outside the field of view maps are 0.

    Args:
        record: of the layout in the image; see :mod:`omniscv.truth.layout_record`.
        camera: of the image.
        edge_sigma, corner_sigma: share of the pixels of a full turn at the image's middle.
        visibility: ``room``: what no wall hides; ``full``: what nothing hides; ``all``.

    Raises:
        ArgumentError: no record, or one without ``visible`` for ``full``.
    """
    flag = {"room": "visible_room", "full": "visible", "all": None}[visibility]
    try:
        pieces = [piece for edge in record["edges"] for piece in edge["pieces"] if _shows(piece, flag)]
        curves = [pixel for piece in pieces for pixel in piece["pixels"]]
        corners = [
            corner["pixel"] for corner in record["corners"] if corner["in_image"] and _shows(corner, flag)
        ]
    except KeyError as cause:
        raise ArgumentError(f"layout: expected a record of a layout, without {cause}") from cause
    turn, valid = 2 * np.pi / radians_per_pixel(camera), camera.valid()
    edge_map = _blobs(np.array(curves), turn * edge_sigma, camera, valid)
    return edge_map, _blobs(np.array(corners), turn * corner_sigma, camera, valid)


def original_maps(record: Mapping[str, Any], camera: Camera, pose: Pose) -> tuple[Map, Map]:
    """Return (H, W) uint8 maps of edges and of corners by the recipe of the published ones.

    They come from an image in which each wall, the floor and the ceiling has a colour. Edges are Canny's;
    corners are where 3 x 3 pixels have three colours. Both are dilated by a pixel, blurred, scaled to 255.
    They are not exact. Unlike the published maps, they have no artefacts at the seam and the border.

    Args:
        record: of the layout in the image.
        camera, pose: of the image.

    Raises:
        ArgumentError: no record of a prism, or an image with pixels outside the field of view.
    """
    import cv2
    from PIL import Image, ImageFilter

    room, rays = room_of(record), camera.unproject()
    if not rays.valid.all():
        raise ArgumentError("layout: expected an image that fills its rectangle for the original recipe")
    surface = first_hits(room, pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T).surface
    longer = max(surface.shape)
    border = longer // 8  # wider than the blur
    mode = cv2.BORDER_WRAP if camera.wraps else cv2.BORDER_REPLICATE
    padded = cv2.copyMakeBorder(surface, 0, 0, border, border, mode)
    padded = cv2.copyMakeBorder(padded, border, border, 0, 0, cv2.BORDER_REPLICATE)
    digits = [(padded + 1) // _LEVELS**k % _LEVELS for k in range(3)]
    faces = np.stack(digits, axis=-1).astype(np.uint8) * np.uint8(255 // (_LEVELS - 1))
    maps = []
    for drawn, radius in (
        (cv2.Canny(faces, *_CANNY), _ORIGINAL_EDGE),
        (np.where(_colors_around(padded) >= 3, 255, 0).astype(np.uint8), _ORIGINAL_CORNER),
    ):
        dilated = Image.fromarray(cv2.dilate(drawn, np.ones((3, 3), np.uint8)))
        blurred = np.asarray(dilated.filter(ImageFilter.GaussianBlur(radius * longer)), np.float64)
        inner = blurred[border:-border, border:-border]
        maps.append(np.round(255 * inner / max(inner.max(), 1)).astype(np.uint8))
    return maps[0], maps[1]


def _colors_around(surface: NDArray[np.int16]) -> NDArray[np.int64]:
    """(H, W) the number of surfaces in the 3 x 3 pixels around each pixel."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(surface, 1, "edge"), (3, 3))
    ordered = np.sort(around.reshape(*surface.shape, 9), axis=-1)
    return np.asarray(1 + np.count_nonzero(np.diff(ordered, axis=-1), axis=-1))


def _shows(entry: Mapping[str, Any], flag: str | None) -> bool:
    if flag is not None and entry[flag] is None:
        raise ArgumentError("layout: expected a layout with visible corners and edges, made with depth")
    return flag is None or bool(entry[flag])


def _blobs(points: Array, sigma: float, camera: Camera, valid: NDArray[np.bool_]) -> Map:
    """255 times the maximum of Gaussians around points (P, 2) px."""
    import cv2
    from scipy.spatial import cKDTree

    drawn = np.zeros((camera.height, camera.width), np.uint8)
    if not len(points):
        return drawn
    reach, wrap = sigma * _REACH, camera.wraps
    column, row = np.minimum(points.astype(int), [camera.width - 1, camera.height - 1]).T
    drawn[row, column] = 1
    margin = int(np.ceil(reach)) + 2 if wrap else 0
    padded = cv2.copyMakeBorder(1 - drawn, 0, 0, margin, margin, cv2.BORDER_WRAP)
    away = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    rows, columns = np.nonzero((away[:, margin : margin + camera.width] <= reach + 1) & valid)
    if wrap:
        points = np.column_stack([points[:, 0] % camera.width, points[:, 1]])
    tree = cKDTree(points, boxsize=np.array([float(camera.width) if wrap else 0.0, 0.0]))
    distance, _ = tree.query(np.column_stack([columns, rows]) + 0.5, distance_upper_bound=reach)
    blobs = np.zeros(drawn.shape, np.uint8)
    blobs[rows, columns] = np.round(255 * np.exp(-0.5 * (distance / sigma) ** 2)).astype(np.uint8)
    return blobs
