"""Ways into the limits of camera models, and the round-trip error along them.

Error: ``|project(point on the ray of p) - p|`` in px, the largest of a few dozen pixels p, for a limit that
is approached from 1 to 1e-16 of itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array

SIZE = 512
AZIMUTHS = np.linspace(-np.pi, np.pi, 13)[1:] - 0.1


def fan(camera: Camera, parts: Array) -> Array:
    """(N, 2) pixels at parts of the last valid radius, all around the centre."""
    along = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], axis=-1)
    return np.asarray(camera.center + last_radius(camera) * np.multiply.outer(parts, along).reshape(-1, 2))


def last_radius(camera: Camera) -> float:
    """The largest valid radius, px, by bisection along a row: from the outside, knowing no formula."""
    low, high = 1e-12 * SIZE, SIZE / 2  # (the middle itself may be a tip)
    if camera.valid(np.add(camera.center, (high, 0))):
        return high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if camera.valid(np.add(camera.center, (middle, 0))) else (low, middle)
    return low


@dataclass(frozen=True)
class Approach:
    """A way into a limit: ``left`` runs from 1 to 0; below 0 lies what is beyond."""

    limit: str
    camera: Callable[[float], Camera]
    pixels: Callable[[Camera, float], Array] = lambda camera, left: fan(
        camera, np.array([0.1, 0.5, 0.9, 1 - 1e-12])
    )
    metres: Callable[[float], float] = lambda left: 10.0
    past: float = -1e-12
    known_px: Callable[[Array], Array] | None = None  # what float64 keeps of the points themselves

    def error_px(self, left: float) -> float:
        """The largest error, or NaN where no pixel is valid."""
        camera = self.camera(left)
        pixels = self.pixels(camera, left)
        rays = camera.unproject(pixels)
        again, seen = camera.project(rays.origins + self.metres(left) * rays.directions)
        if not rays.valid.any():
            return np.nan
        error = np.abs(again - pixels)
        if wraps(camera):  # left and right border are one place
            error[:, 0] = np.minimum(error[:, 0], np.abs(camera.width - error[:, 0]))
        error = np.where(seen[:, None], error, camera.width)[rays.valid]  # a lost pixel is a whole image off
        return float(error.max())

    def beyond(self) -> str:
        """How the model answers a step past the limit."""
        try:
            camera = self.camera(self.past)
        except ArgumentError:
            return "refused"
        return "in domain" if camera.valid(self.pixels(camera, self.past)).any() else "marked"


def parameter(name: str, key: str, limit: float, text: str, metres: float = 10.0, **options: Any) -> Approach:
    """``key`` runs from 0 up to ``limit``."""
    return Approach(
        text, lambda left: create(name, **{key: limit * (1 - left)}, **options), metres=lambda left: metres
    )


def vanishing(name: str, key: str, scale: float, text: str, **options: Any) -> Approach:
    """``key`` runs from ``scale`` down to 0."""
    return Approach(text, lambda left: create(name, **{key: scale * left}, **options))


def create(name: str, **options: Any) -> Camera:
    """A camera of the size of all."""
    return cameras.create(name, **{"width": SIZE, "height": SIZE, **options})


def wraps(camera: Camera) -> bool:
    """Whether the left and the right border are one place."""
    left, right = camera.unproject([(0, camera.height / 2), (camera.width, camera.height / 2)]).directions
    return bool(np.allclose(left, right, rtol=0, atol=1e-9))


def rows(part: Callable[[float], float]) -> Callable[[Camera, float], Array]:
    """Pixels of a panorama in the row at a part of its height, and the seam's columns with them."""
    u = SIZE * np.array([0, 0.1, 0.3, 0.5, 0.7, 0.9, 1])
    return lambda camera, left: np.stack([u, np.full_like(u, part(left) * camera.height)], axis=-1)


def edge(camera: Camera, left: float) -> Array:
    """Pixels that run to the last valid ones, all around."""
    return fan(camera, np.array([1 - left]))


def edge_to_the_right(camera: Camera, left: float) -> Array:
    """Of borders that are no circles."""
    return np.asarray(camera.center + np.array([[last_radius(camera) * (1 - left), 0.0]]))


def towards_pole(name: str, **options: Any) -> Approach:
    """Rows that run to the first."""
    return Approach("row → pole", lambda left: create(name, **options), rows(lambda left: 0.5 * left))


def towards_seam(name: str, **options: Any) -> Approach:
    """Columns that run to the last."""
    v = np.array([0.1, 0.4, 0.5, 0.8]) * SIZE
    return Approach(
        "column → ±180°",
        lambda left: create(name, **options),
        lambda camera, left: np.stack([np.full_like(v, SIZE * (1 - 0.5 * left)), v], axis=-1),
    )


def at_the_edge_of_a_face(name: str) -> Approach:
    """Pixels that run to a border between two slots, and to a corner."""
    along = SIZE * np.array([0.3, 0.4, 0.5])
    return Approach(
        "pixel → edge of a face",
        lambda left: create(name, layout="strip"),
        lambda camera, left: np.stack([np.full(3, SIZE / 3 * (1 - left / 3)), along], axis=-1),
    )
