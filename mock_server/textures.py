"""Colours of surfaces by closed formulas of the world position and normal: the same from every viewpoint.

A texture is a kind, two colours and two numbers; ``kind`` is one of:

    plain     the first colour
    checker   the two in cubes of edge ``scale`` metres
    stripes   the two in slabs of ``scale`` metres across the horizontal direction ``angle_deg``
    tiles     the first, with lines of the second, ``scale`` metres apart
    wood      waves of the two along rings of ``scale`` metres about the X axis
    gradient  from the first at height 0 to the second at height ``scale``
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KINDS = ("plain", "checker", "stripes", "tiles", "wood", "gradient")


@dataclass(frozen=True)
class Texture:
    """A closed-form texture: index into KINDS, two colours 0..1, metres, radians."""

    kind: int
    first: tuple[float, float, float]
    second: tuple[float, float, float]
    scale: float
    angle: float


_LIGHT = np.array([0.35, 0.25, 0.9]) / np.linalg.norm([0.35, 0.25, 0.9])
_NUDGE = 1e-6  # metres: a wall that lies on a boundary of the pattern shows one colour, not rounding
_LINE = 0.04  # a tile's joint, part of its edge


def blend_weight(kind: int, scale: float, angle: float, points: Array, normals: Array) -> Array:
    """(N,) how much of the second colour each point has."""
    p = points - _NUDGE * normals
    name = KINDS[kind]
    if name == "checker":
        return np.asarray(np.floor(p / scale).sum(axis=-1) % 2)
    if name == "stripes":
        across = p[:, 0] * np.cos(angle) + p[:, 1] * np.sin(angle) + 0.31 * p[:, 2]
        return np.asarray(np.floor(across / scale) % 2)
    if name == "tiles":
        flat = np.abs(normals) < 0.5  # the two axes along the surface
        phase = np.abs((p / scale) % 1.0 - 0.5)
        return np.asarray(((phase > 0.5 - _LINE) & flat).any(axis=-1), dtype=np.float64)
    if name == "wood":
        ring = np.hypot(p[:, 1], p[:, 2] + 0.3) / scale + 0.15 * np.sin(0.9 * p[:, 0] / scale)
        return np.asarray(0.5 + 0.5 * np.sin(2 * np.pi * ring))
    if name == "gradient":
        return np.asarray(np.clip(p[:, 2] / scale, 0.0, 1.0))
    return np.zeros(len(points))


def shade(normals: Array) -> Array:
    """(N,) brightness 0.7..1 by the outward normal alone: no viewpoint in it."""
    return np.asarray(0.85 + 0.15 * (normals @ _LIGHT))


def paint(texture: Texture, points: Array, normals: Array) -> Array:
    """(N, 3) shaded colours of surface points."""
    weight = blend_weight(texture.kind, texture.scale, texture.angle, points, normals)[:, None]
    color = (1 - weight) * texture.first + weight * texture.second
    return np.asarray(color * shade(normals)[:, None])


def direction_pattern(directions: Array) -> Array:
    """The colour is the ray: ``0.5 + 0.5 d``."""
    return 0.5 + 0.5 * directions


@dataclass(frozen=True)
class Waves:
    """Fine sinusoids on the sphere: one wave along each world axis, of ``period`` radians where it is
    steepest, in red, green and blue."""

    period: float
    amplitude: float = 0.47

    def __call__(self, directions: Array) -> Array:
        return np.asarray(0.5 + self.amplitude * np.sin(2 * np.pi / self.period * directions))
