"""What networks learn of a layout: maps of its edges and corners, as CFL's, for every camera, and the corners
of a room in an upright panorama, as HorizonNet and its kin order them.

``cor_id`` is (2N, 2) px with the centre of pixel 0 at 0. It holds pairs of a corner of the ceiling and the
floor's corner below it, in one column, occluded ones too, clockwise from above (to the right), the leftmost
first.
Source: sunset1995/HorizonNet, README_PREPARE_DATASET.md, dataset.py, misc/post_proc.py.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import numbers
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.truth.layout_record import room_of
from omniscv.truth.room_in_image import first_hits, inside, radians_per_pixel

Map = NDArray[np.uint8]

# of the pixels around the horizon, as in published maps
_EDGE_SIGMA = 0.0054
_CORNER_SIGMA = 0.0107
_REACH = np.sqrt(2 * np.log(255 / 0.5))  # sigmas; beyond, 255 times a Gaussian rounds to 0
# blur radii, of the longer side
_ORIGINAL_EDGE = 0.0065
_ORIGINAL_CORNER = 0.009
_CANNY = 100, 200
_LEVELS = 5  # of each channel: steps of 63 exceed Canny's thresholds

CAMERA_HEIGHT_M = 1.6
"""Height that plans are scaled to, because a panorama does not show the height of its camera."""
_LEVEL = 1e-6  # rad


# -- maps -------------------------------------------------------------------------------------------------


def exact_maps(
    record: Mapping[str, Any],
    camera: Camera,
    edge_sigma: float = _EDGE_SIGMA,
    corner_sigma: float = _CORNER_SIGMA,
) -> tuple[Map, Map]:
    """Return (H, W) uint8 maps of edges and corners that no wall hides: ``255 exp(-d^2 / 2 sigma^2)``.

    d is the distance, px, to the nearest sample of a curve or the nearest corner, also across the seam of a
    panorama. Maps are 0 outside the view.

    Args:
        record: of the layout.
        camera: of the image.
        edge_sigma: of edges, as a share of the pixels of a full turn at the image's middle.
        corner_sigma: of corners, as such a share.

    Raises:
        ArgumentError: no record of a layout.
    """
    curves = []
    corners = []
    try:
        for edge in record["edges"]:
            for piece in edge["pieces"]:
                if piece["visible_room"]:
                    curves += piece["pixels"]
        for corner in record["corners"]:
            if corner["in_image"] and corner["visible_room"]:
                corners.append(corner["pixel"])
    except KeyError as cause:
        raise ArgumentError(f"layout: expected a record of a layout, without {cause}") from cause
    turn = 2 * np.pi / radians_per_pixel(camera)
    valid = camera.valid()
    edge_map = _blobs(np.array(curves), turn * edge_sigma, camera, valid)
    return edge_map, _blobs(np.array(corners), turn * corner_sigma, camera, valid)


def original_maps(record: Mapping[str, Any], camera: Camera, pose: Pose) -> tuple[Map, Map]:
    """Return (H, W) uint8 maps of edges and of corners by the recipe of the published ones.

    They come from an image in which each wall, the floor and the ceiling has a colour, so it must fill its
    rectangle. Edges are Canny's; corners are where 3 x 3 pixels have three colours. Both are dilated by a
    pixel, blurred, scaled to 255. They are not exact. Unlike the published maps, they have no artefacts at
    the seam and the border.

    Args:
        record: of the layout.
        camera: of the image.
        pose: of the camera, world frame.

    Raises:
        ArgumentError: no record of a layout, or a camera that leaves pixels without a ray.
    """
    import cv2

    room = room_of(record)
    rays = camera.unproject()
    if not rays.valid.all():
        raise ArgumentError("layout: expected an image that fills its rectangle for the original recipe")
    surface = first_hits(room, pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T).surface
    longer = max(surface.shape)
    border = longer // 8  # wider than the blur
    mode = cv2.BORDER_WRAP if camera.wraps else cv2.BORDER_REPLICATE
    padded = cv2.copyMakeBorder(surface, 0, 0, border, border, mode)
    padded = cv2.copyMakeBorder(padded, border, border, 0, 0, cv2.BORDER_REPLICATE)
    digits = [(padded + 1) // _LEVELS**power % _LEVELS for power in range(3)]
    faces = np.stack(digits, axis=-1).astype(np.uint8) * np.uint8(255 // (_LEVELS - 1))
    edges = cv2.Canny(faces, *_CANNY)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(padded, 1, "edge"), (3, 3))
    ordered = np.sort(around.reshape(*padded.shape, 9), axis=-1)
    colors = 1 + np.count_nonzero(np.diff(ordered, axis=-1), axis=-1)
    corners = np.where(colors >= 3, 255, 0).astype(np.uint8)
    edge_map = _blurred(edges, _ORIGINAL_EDGE * longer, border)
    return edge_map, _blurred(corners, _ORIGINAL_CORNER * longer, border)


def _blurred(drawn: NDArray[np.uint8], radius_px: float, border_px: int) -> Map:
    """Return a map of what is drawn: dilated by a pixel, blurred, without its border, scaled to 255."""
    import cv2
    from PIL import Image, ImageFilter

    dilated = Image.fromarray(cv2.dilate(drawn, np.ones((3, 3), np.uint8)))
    blurred = np.asarray(dilated.filter(ImageFilter.GaussianBlur(radius_px)), np.float64)
    inner = blurred[border_px:-border_px, border_px:-border_px]
    return np.asarray(np.round(255 * inner / max(inner.max(), 1)), np.uint8)


def _blobs(points: Array, sigma: float, camera: Camera, valid: NDArray[np.bool_]) -> Map:
    """255 times the maximum of Gaussians around points (P, 2) px."""
    import cv2
    from scipy.spatial import cKDTree

    drawn = np.zeros((camera.height, camera.width), np.uint8)
    if not len(points):
        return drawn
    reach = sigma * _REACH
    wrap = camera.wraps
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


# -- corners ----------------------------------------------------------------------------------------------


def refuses(camera: Camera) -> str | None:
    """Return why corners in columns cannot describe a camera's images; None if they can."""
    is_panorama = camera.name == "equirectangular"
    return None if is_panorama else f"expected an upright equirectangular panorama, got {camera.name}"


def cor_id(room: Room, camera: Camera, pose: Pose) -> Array:
    """Return (2N, 2) px, the corners of a ``room`` in an upright panorama; see the module.

    ``camera`` is that of the panorama, ``pose`` its pose in the world.

    Raises:
        ArgumentError: another camera, one that is not upright, or one outside the room.
    """
    if reason := refuses(camera):
        raise ArgumentError(reason)
    if np.abs(pose.R_w_c[:, 1] - [0, 0, -1]).max() > _LEVEL:
        _, pitch, roll = pose.angles()
        tilt = f"pitch {pitch:.6g} and roll {roll:.6g} degrees"
        raise ArgumentError(f"expected an upright camera, got {tilt}; render it with both 0")
    x, y, z = pose.position.tolist()
    if not (room.floor_z < z < room.ceiling_z and inside(room, [x, y])):
        raise ArgumentError(f"expected a camera within the room, got one at {x:.6g}, {y:.6g}, {z:.6g}")
    clockwise = room.corners_w[::-1]
    rows = []
    for height in (room.ceiling_z, room.floor_z):
        corners_w = np.column_stack([clockwise, np.full(len(clockwise), height)])
        rows.append(camera.project(pose.to_camera(corners_w))[0] - 0.5)
    rows[0][:, 0] = rows[1][:, 0]  # equal to the last digit, because readers compare them
    pairs = np.roll(np.stack(rows, axis=1), -int(rows[1][:, 0].argmin()), axis=0)
    return np.asarray(pairs.reshape(-1, 2))


def corner_lines(layout: Mapping[str, Any], camera: Camera, pose: Pose) -> str:
    """Return :func:`lines_of` the corners of a ``layout``, a record, as :func:`cor_id` has them.

    ``camera`` is that of the panorama, ``pose`` its pose in the world.
    """
    return lines_of(cor_id(room_of(layout), camera, pose))


def lines_of(corners: Array) -> str:
    """Return the lines ``x y`` px of corners (2N, 2), as ``label_cor/STEM.txt`` holds them."""
    return "".join(f"{x:.3f} {y:.3f}\n" for x, y in corners.tolist())


def room_seen(corners: ArrayLike, width: int, height: int) -> Room:
    """Return the room around a camera at the origin, 1.6 m up, that looks along X in a panorama.

    The ceiling's height is the mean over the pairs of corners, as in HorizonNet's evaluation.

    Args:
        corners: (2N, 2) px of the panorama, as :func:`cor_id` orders them.
        width: of the panorama, px.
        height: of the panorama, px.

    Raises:
        ArgumentError: no pairs of a ceiling above the horizon and a floor below it, in one column.
    """
    pixels = numbers("cor_id", corners, (None, 2))
    ceiling = pixels[0::2]
    floor = pixels[1::2]
    paired = len(ceiling) == len(floor) and np.abs(ceiling[:, 0] - floor[:, 0]).max() <= width / 100
    if not paired or len(floor) < 3:
        raise ArgumentError("cor_id: expected at least 3 pairs of corners, a ceiling's above a floor's")
    theta = ((floor[:, 0] + 0.5) / width - 0.5) * 2 * np.pi
    up = np.pi * (0.5 - (ceiling[:, 1] + 0.5) / height)
    down = np.pi * (0.5 - (floor[:, 1] + 0.5) / height)
    if (up <= 0).any() or (down >= 0).any():
        raise ArgumentError("cor_id: expected ceilings above the horizon and floors below it")
    away = -CAMERA_HEIGHT_M / np.tan(down)
    plan = np.column_stack([away * np.cos(theta), -away * np.sin(theta)])[::-1]
    names = tuple(f"Wall_{number}" for number in range(1, len(plan) + 1))
    return Room(plan, -CAMERA_HEIGHT_M, float((away * np.tan(up)).mean()), names, "Floor", "Ceiling")
