"""How many instants of an exposure show motion without steps.

The mean of N instants shows an edge that moves by p px as N steps of p / N px. Behind the box of a pixel the
largest error is p / (8 N^2) of the contrast, for steps of at most 1 px: below 1 / 128, 2 levels of 255, if N
is at least p and 4 sqrt(p). Captures with one sample a pixel have jagged edges, so N is twice as many.
"""

import math
from collections.abc import Sequence

import numpy as np

from omniscv.cameras import Camera
from omniscv.geometry import Pose
from omniscv.geometry.motion import Motion
from omniscv.planning import densities

SURFACE_M = 1.0
"""Distance at which surfaces are taken to be, for what a moving camera sees of them."""
_NEAREST_M = 0.25  # to an object that moves
_OBJECT_M = 0.5  # from an object's middle to what of it is seen
_FEWEST, _MOST = 3, 999


def instants(motion_px: float) -> int:
    """Return how many instants, an odd number, show a motion of so many px."""
    count = math.ceil(2 * max(motion_px, 4 * math.sqrt(motion_px)))
    return min(max(count | 1, _FEWEST), _MOST)


def motion_px(
    camera: Camera,
    poses: tuple[Pose, Pose],
    motions: Sequence[Motion],
    times: tuple[float, float],
) -> float:
    """Return how far things move in an image, px, where its pixels are as wide as in its middle.

    Args:
        camera: of the image.
        poses: of the camera, at the start and at the end.
        motions: of objects.
        times: start and end, seconds.
    """
    start, end = poses
    turned = _angle(start.rotation, end.rotation)
    radians = turned + float(np.linalg.norm(end.position - start.position)) / SURFACE_M
    for motion in motions:
        before, after = (motion.at(time) for time in times)
        moved = float(np.linalg.norm(after.position - before.position))
        moved += _OBJECT_M * _angle(before.rotation, after.rotation)
        away = min(float(np.linalg.norm(pose.position - start.position)) for pose in (before, after))
        radians = max(radians, turned + moved / max(away - _OBJECT_M, _NEAREST_M))
    return radians * densities.pixels_per_radian(camera)


def _angle(one: np.ndarray, other: np.ndarray) -> float:
    """Return the angle between two rotations, radians."""
    return math.acos(min(1.0, max(-1.0, (float(np.trace(one.T @ other)) - 1) / 2)))
