"""The corners of a room in an upright panorama, as HorizonNet and its kin order them.

``cor_id`` is (2N, 2) px with the centre of pixel 0 at 0. It holds pairs of a corner of the ceiling and the
floor's corner below it, in one column, occluded ones too, clockwise from above (to the right), the leftmost
first.
Source: sunset1995/HorizonNet, README_PREPARE_DATASET.md, dataset.py, misc/post_proc.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import numbers
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.truth.layout_record import room_of
from omniscv.truth.room_surfaces import inside

CAMERA_HEIGHT_M = 1.6
"""Height that plans are scaled to, because a panorama does not show the height of its camera."""

_LEVEL = 1e-6  # rad


def refuses(camera: Camera) -> str | None:
    """Return why corners in columns cannot describe a camera's images; None if they can."""
    if camera.name == "equirectangular":
        return None
    return f"expected an upright equirectangular panorama, got {camera.name}"


def cor_id(room: Room, camera: Camera, pose: Pose) -> Array:
    """Return (2N, 2) px, the corners of a room in an upright panorama; see the module.

    Raises:
        ArgumentError: another camera, one that is not upright, or one outside the room.
    """
    if reason := refuses(camera):
        raise ArgumentError(reason)
    if np.abs(pose.R_w_c[:, 1] - [0, 0, -1]).max() > _LEVEL:
        _, pitch, roll = pose.angles()
        got = f"pitch {pitch:.6g} and roll {roll:.6g} degrees"
        raise ArgumentError(f"expected an upright camera, got {got}; render it with both 0")
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
    """Return the lines ``x y`` px of the corners of a panorama, as ``label_cor/STEM.txt`` holds them.

    Args:
        layout: record of :mod:`omniscv.truth.layout_record`.
        camera, pose: of the panorama.

    Raises:
        ArgumentError: no record of a layout, or as :func:`cor_id`.
    """
    return "".join(f"{x:.3f} {y:.3f}\n" for x, y in cor_id(room_of(layout), camera, pose).tolist())


def room_seen(corners: ArrayLike, width: int, height: int) -> Room:
    """Return the room that corners describe, around a camera at the origin that looks along X, 1.6 m up.

    The ceiling's height is the mean over the pairs, as in HorizonNet's evaluation.

    Args:
        corners: (2N, 2) as :func:`cor_id` returns them.
        width, height: of the panorama, px.

    Raises:
        ArgumentError: no pairs of a ceiling above the horizon and a floor below it, in one column.
    """
    pixels = numbers("cor_id", corners, (None, 2))
    ceiling, floor = pixels[0::2], pixels[1::2]
    paired = len(ceiling) == len(floor) and np.abs(ceiling[:, 0] - floor[:, 0]).max() <= width / 100
    if not paired or len(floor) < 3:
        raise ArgumentError(
            "cor_id: expected at least 3 pairs of a ceiling's and a floor's corner, in columns"
        )
    theta = ((floor[:, 0] + 0.5) / width - 0.5) * 2 * np.pi
    up, down = (np.pi * (0.5 - (row[:, 1] + 0.5) / height) for row in (ceiling, floor))
    if (up <= 0).any() or (down >= 0).any():
        raise ArgumentError("cor_id: expected ceilings above the horizon and floors below it")
    away = -CAMERA_HEIGHT_M / np.tan(down)
    plan = np.column_stack([away * np.cos(theta), -away * np.sin(theta)])[::-1]
    names = tuple(f"Wall_{i + 1}" for i in range(len(plan)))
    return Room(plan, -CAMERA_HEIGHT_M, float((away * np.tan(up)).mean()), names, "Floor", "Ceiling")
