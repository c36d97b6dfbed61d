"""Approaches to the limits of camera models, and the round-trip error along them.

Error: ``|project(point on the ray of p) - p|`` in px, the largest of a few dozen pixels p, while a parameter
or the pixels approach a limit: the remainder ``left`` falls from 1 to 1e-16.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array

SIZE = 512
AZIMUTHS = np.linspace(-np.pi, np.pi, 13)[1:] - 0.1

Pixels = Callable[[Camera, float], Array]
"""(N, 2) pixels of a camera, by what is left to the limit."""


def bisect(inside: Callable[[float], bool], low: float, high: float, steps: int) -> float:
    """Return the largest number between ``low``, inside, and ``high`` that is still inside."""
    for _ in range(steps):
        middle = (low + high) / 2
        low, high = (middle, high) if inside(middle) else (low, middle)
    return low


def last_radius(camera: Camera) -> float:
    """Return the largest valid radius along a row, px, without knowledge of the model."""

    def inside(radius: float) -> bool:
        return bool(camera.valid(np.add(camera.center, (radius, 0))))

    # The centre itself may be invalid, as the tip of a cone is.
    return SIZE / 2 if inside(SIZE / 2) else bisect(inside, 1e-12 * SIZE, SIZE / 2, 60)


def fan(camera: Camera, fractions: Array) -> Array:
    """Return (N, 2) pixels at fractions of the last valid radius, in all directions from the centre."""
    along = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], axis=-1)
    offsets = np.multiply.outer(fractions, along).reshape(-1, 2)
    return np.asarray(camera.center + last_radius(camera) * offsets)


def everywhere(camera: Camera, left: float) -> Array:
    """Pixels of a few radii up to the last valid one."""
    return fan(camera, np.array([0.1, 0.5, 0.9, 1 - 1e-12]))


def edge(camera: Camera, left: float) -> Array:
    """Pixels that approach the last valid radius, in all directions."""
    return fan(camera, np.array([1 - left]))


def edge_to_the_right(camera: Camera, left: float) -> Array:
    """One pixel that approaches the last valid one, for borders that are no circles."""
    return np.asarray(camera.center + np.array([[last_radius(camera) * (1 - left), 0.0]]))


def tip(camera: Camera, left: float) -> Array:
    """Pixels that approach the centre."""
    return fan(camera, np.array([left]))


def row(fraction: Callable[[float], float]) -> Pixels:
    """Pixels of a panorama in the row at a fraction of its height, those of both borders included."""
    u = SIZE * np.array([0, 0.1, 0.3, 0.5, 0.7, 0.9, 1])
    return lambda camera, left: np.stack([u, np.full_like(u, fraction(left) * camera.height)], axis=-1)


towards_pole = row(lambda left: 0.5 * left)


def towards_seam(camera: Camera, left: float) -> Array:
    """Pixels of a column that approaches the last one."""
    v = np.array([0.1, 0.4, 0.5, 0.8]) * SIZE
    return np.stack([np.full_like(v, SIZE * (1 - 0.5 * left)), v], axis=-1)


def edge_of_a_face(camera: Camera, left: float) -> Array:
    """Pixels that approach the border between two slots of a strip, and a corner."""
    v = SIZE * np.array([0.3, 0.4, 0.5])
    return np.stack([np.full(3, SIZE / 3 * (1 - left / 3)), v], axis=-1)


@dataclass(frozen=True)
class Approach:
    """An approach to a limit.

    Attributes:
        limit: its name.
        camera: by what is left to the limit, from 1 to 0; less than 0 is beyond.
        pixels: that are tested.
        metres: distance of the points on their rays.
        past: what is left one step beyond the limit.
        known_px: what float64 can tell of the points themselves, if more than 1e-6 px.
    """

    limit: str
    camera: Callable[[float], Camera]
    pixels: Pixels = everywhere
    metres: Callable[[float], float] = lambda left: 10.0
    past: float = -1e-12
    known_px: Callable[[Array], Array] | None = None

    def error_px(self, left: float) -> float:
        """Return the largest error, or NaN if no pixel is valid. A lost pixel counts as the image's width."""
        camera = self.camera(left)
        pixels = self.pixels(camera, left)
        rays = camera.unproject(pixels)
        if not rays.valid.any():
            return np.nan
        again, seen = camera.project(rays.origins + self.metres(left) * rays.directions)
        error = np.abs(again - pixels)
        if _borders_meet(camera):
            error[:, 0] = np.minimum(error[:, 0], np.abs(camera.width - error[:, 0]))
        return float(np.where(seen[:, None], error, camera.width)[rays.valid].max())

    def beyond(self) -> str:
        """Return how the model answers one step past the limit."""
        try:
            camera = self.camera(self.past)
        except ArgumentError:
            return "refused"
        return "in domain" if camera.valid(self.pixels(camera, self.past)).any() else "marked"


def create(name: str, **options: object) -> Camera:
    """Return a camera of the size of all."""
    return cameras.create(name, **{"width": SIZE, "height": SIZE, **options})  # type: ignore[arg-type]


def _borders_meet(camera: Camera) -> bool:
    """Whether the middles of the left and the right border see one direction."""
    left, right = camera.unproject([(0, camera.height / 2), (camera.width, camera.height / 2)]).directions
    return bool(np.allclose(left, right, rtol=0, atol=1e-9))
