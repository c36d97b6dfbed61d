"""Straight lines of the world in an upright panorama: segments of great circles, known by their normals."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import create
from omniscv.geometry.pose import Array

_FACE_FOV_DEG = 100.0  # so that the faces overlap: a line is whole in one of them
_SHORTEST_RAD = np.radians(2.0)
_SIDES = ((0, 0), (90, 0), (180, 0), (270, 0), (0, 90), (0, -90))  # yaw to the right, nose up, degrees


class Segments(NamedTuple):
    """Segments of great circles, camera frame (x right, y down, z forward).

    Attributes:
        starts, ends: (S, 3) unit rays.
        normals: (S, 3) unit, of the plane through the camera's centre and the line.
        lengths: (S,) radians.
    """

    starts: Array
    ends: Array
    normals: Array
    lengths: Array


def line_segments(lit: NDArray[np.uint8]) -> Segments:
    """Return the straight segments in a panorama.

    OpenCV's detector (von Gioi et al., LSD, 2010) finds them in perspective faces, where lines are straight,
    once in lightness and once in each colour axis of L*a*b*: walls of equal grey meet in colour.

    Args:
        lit: (H, W, 3) RGB of an upright equirectangular panorama.
    """
    import cv2

    height, width = lit.shape[:2]
    panorama = create("equirectangular", width, height)
    size = int(np.ceil(width / np.pi * np.tan(np.radians(_FACE_FOV_DEG / 2))))
    face = create("pinhole", size, size, fov_deg=_FACE_FOV_DEG)
    rays = face.unproject().directions
    detector = cv2.createLineSegmentDetector()
    starts, ends = list[Array](), list[Array]()
    padded = cv2.copyMakeBorder(lit, 1, 1, 1, 1, cv2.BORDER_WRAP)
    padded[0], padded[-1] = padded[1], padded[-2]
    for yaw_deg, pitch_deg in _SIDES:
        R_c_f = _turn(np.radians(yaw_deg), np.radians(pitch_deg))
        pixels = panorama.project(rays @ R_c_f.T)[0].astype(np.float32) + np.float32(0.5)
        seen = cv2.remap(padded, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR)
        for channel in cv2.split(cv2.cvtColor(seen, cv2.COLOR_RGB2Lab)):
            found = _detected(detector, channel)
            for part, ray in ((starts, found[:, :2]), (ends, found[:, 2:])):
                part.append(face.unproject(ray).directions @ R_c_f.T)
    return _great_circles(np.concatenate(starts), np.concatenate(ends))


def _detected(detector: Any, channel: NDArray[np.uint8]) -> Array:
    """(S, 4) u, v of both ends, px."""
    found = detector.detect(channel)[0]
    if found is None:
        return np.zeros((0, 4))
    return np.asarray(found, np.float64).reshape(-1, 4) + 0.5  # the detector's pixels have integer centres


def _great_circles(starts: Array, ends: Array) -> Segments:
    across = np.cross(starts, ends)
    sine = np.linalg.norm(across, axis=1)
    lengths = np.arctan2(sine, (starts * ends).sum(axis=1))
    kept = lengths >= _SHORTEST_RAD
    return Segments(starts[kept], ends[kept], across[kept] / sine[kept, None], lengths[kept])


def _turn(yaw: float, pitch: float) -> Array:
    """R_c_f of a face that is turned to the right, then nose up, radians."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    return np.asarray(about_y @ about_x)
