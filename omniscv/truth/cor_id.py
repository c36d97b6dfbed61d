"""The corners of a room in an upright panorama, as HorizonNet and its kin order them.

``cor_id`` is (2N, 2) px with the centre of pixel 0 at 0: pairs of a ceiling's corner and the floor's below
it, in one column, occluded ones too, clockwise from above (to the right), the leftmost first.
Source: sunset1995/HorizonNet, README_PREPARE_DATASET.md, dataset.py, misc/post_proc.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import numbers
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.truth.room_surfaces import inside

CAMERA_HEIGHT_M = 1.6
"""What the plan is scaled to: a panorama does not show how high its camera is."""

_LEVEL = 1e-6  # rad


def refused(camera: Camera) -> str | None:
    """Return why the form cannot carry a camera; None where it can."""
    if camera.name == "equirectangular":
        return None
    return f"expected an upright equirectangular panorama, got {camera.name}"


def cor_id(room: Room, camera: Camera, pose: Pose) -> Array:
    """Return (2N, 2) the corners of a room in an upright panorama; see the module.

    Raises:
        ArgumentError: another camera, one that is not upright, or one outside the room.
    """
    if reason := refused(camera):
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
    rows[0][:, 0] = rows[1][:, 0]  # to the last digit: readers compare them
    pairs = np.roll(np.stack(rows, axis=1), -int(rows[1][:, 0].argmin()), axis=0)
    return np.asarray(pairs.reshape(-1, 2))


def room_seen(corners: ArrayLike, width: int, height: int) -> Room:
    """Return the room that corners describe, around a camera at the origin that looks along X, 1.6 m up.

    The ceiling's height is the mean of what the pairs give, as HorizonNet's evaluation has it.

    Args:
        corners: (2N, 2) as :func:`cor_id` returns them.
        width, height: of the panorama, px.

    Raises:
        ArgumentError: no pairs of a ceiling above the horizon and a floor below it, in one column.
    """
    found = numbers("cor_id", corners, (None, 2))
    ceiling, floor = found[0::2], found[1::2]
    paired = len(ceiling) == len(floor) and np.abs(ceiling[:, 0] - floor[:, 0]).max() <= width / 100
    if not paired or len(floor) < 3:
        raise ArgumentError(
            "cor_id: expected at least 3 pairs of a ceiling's and a floor's corner, in columns"
        )
    theta = ((floor[:, 0] + 0.5) / width - 0.5) * 2 * np.pi
    up, down = (np.pi * (0.5 - (part[:, 1] + 0.5) / height) for part in (ceiling, floor))
    if (up <= 0).any() or (down >= 0).any():
        raise ArgumentError("cor_id: expected ceilings above the horizon and floors below it")
    away = -CAMERA_HEIGHT_M / np.tan(down)
    plan = np.column_stack([away * np.cos(theta), -away * np.sin(theta)])[::-1]
    names = tuple(f"Wall_{i + 1}" for i in range(len(plan)))
    return Room(plan, -CAMERA_HEIGHT_M, float((away * np.tan(up)).mean()), names, "Floor", "Ceiling")
