"""Straight lines in space by Pluecker coordinates.

A line through the point p along the direction l is ``(l, m)``, ``m = p x l``: six numbers up to scale, with
``l . m = 0`` (Klein's quadric). A ray from o along d meets it where ``d . m + (o x d) . l = 0``.
"""

from __future__ import annotations

import numpy as np

from omniscv.geometry.pose import Array


def through(points: Array, directions: Array) -> Array:
    """Return lines (..., 6) through points (..., 3) along directions (..., 3), of unit direction."""
    along = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.concatenate([along, np.cross(points, along)], axis=-1)


def incidence(origins: Array, directions: Array) -> Array:
    """Return rows (..., 6) whose product with a line is 0 where a ray meets it; metres if both are unit."""
    return np.concatenate([np.cross(origins, directions), directions], axis=-1)


def on_klein(line: Array) -> Array:
    """Return the line (6,) of unit direction nearest to six numbers with the same direction."""
    length = float(np.linalg.norm(line[:3]))
    along, moment = line[:3] / length, line[3:] / length
    return np.concatenate([along, moment - along * (along @ moment)])


def nearest_to_origin(line: Array) -> Array:
    """Return (3,) the point of a line (6,) of unit direction that is nearest to the origin."""
    return np.asarray(np.cross(line[:3], line[3:]))


def nearest_to_rays(line: Array, origins: Array, directions: Array) -> Array:
    """Return (N, 3) the points of a line (6,) of unit direction that are nearest to rays (N, 3), unit."""
    middle = nearest_to_origin(line)
    cosine, offset = directions @ line[:3], origins - middle
    along = (offset @ line[:3] - cosine * (offset * directions).sum(axis=-1)) / (1 - cosine**2)
    return np.asarray(middle + along[:, None] * line[:3])


def distance_to(line: Array, points: Array) -> Array:
    """Return (N,) the distances of points (N, 3) from a line (6,) of unit direction."""
    return np.asarray(np.linalg.norm(np.cross(points, line[:3]) - line[3:], axis=-1))


def angle_deg(a: Array, b: Array) -> float:
    """Return the angle between two directions (3,), whichever way they point, 0 to 90 degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(a @ b))))
