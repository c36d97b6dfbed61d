"""Worlds as panoramas, cubes, fisheyes and two eyes, drawn by code that the product does not share."""

import numpy as np

from support.overlapping import WORLDS

AT = (0.2, -0.1, 1.4)
FACES = {
    "front": (1, 0, 0),
    "right": (0, -1, 0),
    "back": (-1, 0, 0),
    "left": (0, 1, 0),
    "up": (0, 0, 1),
    "down": (0, 0, -1),
}
"""Where a cube's faces look by their words, X forward, Y left, Z up."""


class Painted:
    """A world whose surfaces have tones, and waves of a strength over them; rays have colours 0 to 255."""

    def __init__(self, seed, kind="boxes", waves=18.0, light=1.0):
        random = np.random.default_rng(seed)
        self._trace, parts = WORLDS[kind](random, 9)
        self._waves = random.normal(0, 1.0, (parts, 6, 3)) * np.array([4, 7, 12, 18, 25, 35])[:, None]
        self._phases = random.uniform(0, 6.3, (parts, 6))
        self._tones = random.uniform(60, 190, (parts, 6, 3))
        self._strength = waves
        self._light = light

    def colors(self, rays, at=AT, samples=2):
        """Colours (H, W, 3) uint8 of rays (samples H, samples W, 3), means of samples."""
        height, width = (side // samples for side in rays.shape[:2])
        flat = rays.reshape(-1, 3)
        origins = np.tile(np.array(at, float), (len(flat), 1))
        lengths, part, side = self._trace(origins, flat)
        points = origins + flat * lengths[:, None]
        texture = sum(
            np.sin((points * self._waves[part, k]).sum(axis=1) + self._phases[part, k]) for k in range(6)
        )
        values = self._light * (self._tones[part, side] + self._strength * texture[:, None])
        means = values.reshape(height, samples, width, samples, 3).mean(axis=(1, 3))
        return np.uint8(np.clip(means, 0, 255) + 0.5)


def grid(width, height, samples=2):
    """Columns and rows of the samples of pixels, from -1 to 1."""
    x = (np.arange(width * samples) + 0.5) / (width * samples) * 2 - 1
    y = (np.arange(height * samples) + 0.5) / (height * samples) * 2 - 1
    return np.meshgrid(x, y)


def panorama(world, height, at=AT, R=None, part=(-1, 1, -1, 1), width=None):
    """A panorama 2:1, or a part of one, left to right and top to bottom from -1 to 1; R turns its rays."""
    x, y = grid(width or 2 * height, height)
    left, right, top, bottom = part
    theta = np.pi * (left + (x + 1) / 2 * (right - left))
    phi = -np.pi / 2 * (top + (y + 1) / 2 * (bottom - top))
    rays = np.stack([np.cos(phi) * np.cos(theta), -np.cos(phi) * np.sin(theta), np.sin(phi)], axis=-1)
    return world.colors(rays if R is None else rays @ np.transpose(R), at)


def faces(world, edge, extent=1.0, is_equi_angular=False):
    """Six faces by their words; of 90 degrees for an extent of 1."""
    x, y = grid(edge, edge)
    x, y = (np.tan(x * np.pi / 4), np.tan(y * np.pi / 4)) if is_equi_angular else (x * extent, y * extent)
    pictures = {}
    for word, ahead in FACES.items():
        ahead = np.array(ahead, float)
        upwards = {"up": (-1, 0, 0), "down": (1, 0, 0)}.get(word, (0, 0, 1))  # what the picture's top shows
        right = np.cross(ahead, upwards)
        rays = ahead + x[..., None] * right - y[..., None] * np.array(upwards, float)
        pictures[word] = world.colors(rays)
    return pictures


def two_fisheyes(world, height, fov_deg=190.0):
    """Circles of a front and a back fisheye in black corners."""
    x, y = grid(height, height)
    radius = np.hypot(x, y)
    angle = radius * np.radians(fov_deg) / 2
    across = np.sin(angle) / np.maximum(radius, 1e-9)
    pictures = []
    for sign in (1, -1):
        rays = np.stack([sign * np.cos(angle), -sign * x * across, -y * across], axis=-1)
        picture = world.colors(rays)
        picture[radius[::2, ::2] > 1] = 0
        pictures.append(picture)
    return np.concatenate(pictures, axis=1)


def two_eyes(world, height, is_above=False, apart_m=0.064):
    """VR180 side by side, or two whole spheres one above the other, squeezed to 2:1."""
    rows, part = (height // 2, (-1, 1, -1, 1)) if is_above else (height, (-0.5, 0.5, -1, 1))
    eyes = []
    for y in (apart_m / 2, -apart_m / 2):
        at = (AT[0], AT[1] + y, AT[2])
        eyes.append(panorama(world, rows, at, None, part, 2 * height if is_above else height))
    return np.concatenate(eyes, axis=0 if is_above else 1)


def flat(world, height):
    """A picture of a plain lens, 2:1."""
    x, y = grid(2 * height, height)
    return world.colors(np.stack([np.ones_like(x), -x, -0.5 * y], axis=-1))
