"""Surface colours by closed formulas of position and normal, the same from every viewpoint.

A texture is a kind, two colours and two numbers; ``kind`` is one of:

    plain     the first colour
    checker   the two in cubes of edge ``scale`` metres
    stripes   the two in slabs of ``scale`` metres across the horizontal direction ``angle_deg``
    tiles     the first, with lines of the second, ``scale`` metres apart
    wood      waves of the two along rings of ``scale`` metres about the X axis
    gradient  from the first at height 0 to the second at height ``scale``
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KINDS = ("plain", "checker", "stripes", "tiles", "wood", "gradient")


@dataclass(frozen=True)
class Texture:
    """A closed-form texture: one of KINDS, two colours 0..1, metres, radians."""

    kind: str
    first: tuple[float, ...]
    second: tuple[float, ...]
    scale: float
    angle: float


_LIGHT = np.array([0.35, 0.25, 0.9]) / np.linalg.norm([0.35, 0.25, 0.9])
_NUDGE = 1e-6  # metres: a wall on a boundary of the pattern shows one colour, not rounding
_LINE = 0.04  # a tile's joint, part of its edge


def paint(texture: Texture, points: Array, normals: Array, facing: Array) -> Array:
    """Return (N, 3) colours of surface points.

    Args:
        texture: a texture, fixed to the object as it is described.
        points, normals: (N, 3) there.
        facing: (N, 3) the normals in the world, which shade the colours by 0.7..1.
    """
    shade = (0.85 + 0.15 * (facing @ _LIGHT))[:, None]
    if texture.kind == "plain":
        return np.asarray(texture.first * shade)
    p, scale = points - _NUDGE * normals, texture.scale
    colors = np.array([texture.first, texture.second])
    if texture.kind == "wood":
        ring = np.hypot(p[:, 1], p[:, 2] + 0.3) / scale + 0.15 * np.sin(0.9 * p[:, 0] / scale)
        color = _between(colors, 0.5 + 0.5 * np.sin(2 * np.pi * ring))
    elif texture.kind == "gradient":
        color = _between(colors, np.clip(p[:, 2] / scale, 0.0, 1.0))
    else:
        color = colors.take(_second(texture, p, normals), axis=0)
    color *= shade
    return color


def _between(colors: Array, weight: Array) -> Array:
    """Return (N, 3) mixtures of two colours by the weight of the second."""
    return np.asarray((1 - weight[:, None]) * colors[0] + weight[:, None] * colors[1])


def _second(texture: Texture, p: Array, normals: Array) -> NDArray[np.intp]:
    """Return (N,) indices of the two colours: 0 the first, 1 the second."""
    scale = texture.scale
    if texture.kind == "checker":
        cell = np.floor(p[:, 0] / scale) + np.floor(p[:, 1] / scale) + np.floor(p[:, 2] / scale)
        return np.asarray(cell % 2, dtype=np.intp)
    if texture.kind == "stripes":
        across = p[:, 0] * np.cos(texture.angle) + p[:, 1] * np.sin(texture.angle) + 0.31 * p[:, 2]
        return np.asarray(np.floor(across / scale) % 2, dtype=np.intp)
    joint = np.abs((p / scale) % 1.0 - 0.5) > 0.5 - _LINE
    along = np.abs(normals) < 0.5  # the two axes along the surface
    return np.asarray((joint & along).any(axis=-1), dtype=np.intp)


def direction_pattern(directions: Array) -> Array:
    """Return the colours ``0.5 + 0.5 d`` of unit directions (N, 3)."""
    return 0.5 + 0.5 * directions


def waves(directions: Array, period_rad: float) -> Array:
    """Return sinusoids of unit directions (N, 3): in red, green and blue one wave along each world axis, of
    ``period_rad`` where it is steepest."""
    return np.asarray(0.5 + 0.47 * np.sin(2 * np.pi / period_rad * directions))
