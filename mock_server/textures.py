"""Surface colours by closed formulas of position and normal, the same from every viewpoint.

A texture is a kind, two colours and two numbers; ``kind`` is one of:

    plain     the first colour
    checker   the two in cubes of edge ``scale`` metres
    stripes   the two in slabs of ``scale`` metres across the horizontal direction ``angle_deg``
    tiles     the first, with lines of the second, ``scale`` metres apart
    wood      waves of the two along rings of ``scale`` metres about the X axis
    gradient  from the first at height 0 to the second at height ``scale``
    noise     mixtures of the two that repeat nowhere: octaves from ``scale`` metres down, by a seed
    image     a picture, repeated: on walls upright, on level surfaces with X up
"""

import hashlib
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mock_server.compiled import njit

Array = NDArray[np.float64]

KINDS = ("plain", "checker", "stripes", "tiles", "wood", "gradient", "noise", "image")


@dataclass(frozen=True)
class Texture:
    """A closed-form texture: one of KINDS, two colours 0..1, metres, radians."""

    kind: str
    first: tuple[float, ...]
    second: tuple[float, ...]
    scale: float
    angle: float


@dataclass(frozen=True)
class Noise(Texture):
    """Of a number of octaves, each half as large as the one before."""

    seed: int
    octaves: int


@dataclass(frozen=True)
class Picture(Texture):
    """A picture of ``scale`` metres across; equal pictures have one digest."""

    digest: str
    pixels: NDArray[np.uint8] = field(repr=False, compare=False)


_LIGHT = np.array([0.35, 0.25, 0.9]) / np.linalg.norm([0.35, 0.25, 0.9])
_MOST_BYTES = 1 << 26
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
    p = points - _NUDGE * normals
    scale = texture.scale
    colors = np.array([texture.first, texture.second])
    if texture.kind == "wood":
        ring = np.hypot(p[:, 1], p[:, 2] + 0.3) / scale + 0.15 * np.sin(0.9 * p[:, 0] / scale)
        color = _between(colors, 0.5 + 0.5 * np.sin(2 * np.pi * ring))
    elif isinstance(texture, Noise):
        shares = np.empty(len(p))
        _noise(p / scale, texture.seed, texture.octaves, shares)
        color = _between(colors, shares)
    elif isinstance(texture, Picture):
        color = _pictured(texture.pixels, p / scale, normals)
    elif texture.kind == "gradient":
        color = _between(colors, np.clip(p[:, 2] / scale, 0.0, 1.0))
    else:
        color = colors.take(_second(texture, p, normals), axis=0)
    color *= shade
    return color


@njit("float64[:, ::1], int64, int64, out float64[::1]", nogil=True)
def _noise(points, seed, octaves, shares):  # type: ignore[no-untyped-def]
    """Write (N,) 0..1: values at the corners of a grid, drawn by a hash, and smoothly between them."""
    for n in range(len(points)):
        total, most, size = 0.0, 0.0, 1.0
        for octave in range(octaves):
            lows = np.empty(3, np.int64)
            parts = np.empty(3)
            for k in range(3):
                at = points[n, k] * size + 0.37 * octave
                lows[k] = int(np.floor(at))
                part = at - lows[k]
                parts[k] = part * part * (3 - 2 * part)
            value = 0.0
            for corner in range(8):
                hashed, weight = np.uint64(seed * 1000 + octave + 1), 1.0
                for k in range(3):
                    high = corner >> k & 1
                    hashed = (hashed ^ np.uint64(lows[k] + high)) * np.uint64(0x9E3779B97F4A7C15)
                    hashed ^= hashed >> np.uint64(29)
                    weight *= parts[k] if high else 1 - parts[k]
                hashed *= np.uint64(0xBF58476D1CE4E5B9)
                value += weight * (hashed >> np.uint64(40)) / 16777216.0
            strength = 0.7**octave
            total, most, size = total + strength * value, most + strength, 2 * size
        # Sums of octaves lie near their middle: stretched, the colours are used up.
        shares[n] = min(max(0.5 + 2.0 * (total / most - 0.5), 0.0), 1.0)


def _pictured(pixels: NDArray[np.uint8], p: Array, normals: Array) -> Array:
    """Return (N, 3) colours of a picture as wide as 1 in p, upright on walls and not mirrored."""
    height, width = pixels.shape[:2]
    level = np.abs(normals[:, 2]) > 0.7071
    x, y, z = p.T
    right = np.where(level, -y * np.sign(normals[:, 2]), p[:, 0] * -normals[:, 1] + y * normals[:, 0])
    up = np.where(level, x, z) * width / height
    u = right % 1.0 * width - 0.5
    v = -up % 1.0 * height - 0.5
    i = np.floor(u).astype(int)
    j = np.floor(v).astype(int)
    a = (u - i)[:, None]
    b = (v - j)[:, None]

    def pixel(row: NDArray[np.intp], column: NDArray[np.intp]) -> Array:
        """Return (N, 3) colours 0..1 at a ``row`` and a ``column`` of the repeated picture."""
        return np.asarray(pixels[row % height, column % width] / 255.0)

    upper = (1 - a) * pixel(j, i) + a * pixel(j, i + 1)
    lower = (1 - a) * pixel(j + 1, i) + a * pixel(j + 1, i + 1)
    return np.asarray((1 - b) * upper + b * lower)


@lru_cache(32)
def read_picture(path: str) -> tuple[str, NDArray[np.uint8]]:
    """Return the digest and the pixels (H, W, 3) of a picture file.

    Raises:
        ValueError: no picture, or one of more than 64 MB.
    """
    import cv2

    try:
        with open(path, "rb") as file:
            content = file.read(_MOST_BYTES)
    except OSError as cause:
        raise ValueError(f"expected the file of a picture, got {path!r}: {cause.strerror}") from cause
    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR_RGB) if content else None
    if pixels is None:
        raise ValueError(f"expected the file of a picture, PNG or JPEG, got {path!r}")
    return hashlib.sha256(pixels.tobytes()).hexdigest(), np.asarray(pixels, np.uint8)


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
