"""What a camera must capture, by the protocol reference's own formulas, and how images are compared."""

import io

import numpy as np
from PIL import Image


def png(data):
    """(H, W, 4) uint8."""
    return np.asarray(Image.open(io.BytesIO(data)))


def npy(data):
    """The array of an NPY file."""
    return np.load(io.BytesIO(data))


def seen_by_hand(scene, location, rotation, fov, width, height):
    """Hits and planar depth (metres) of a pinhole's rays: made in Unreal's axes, traced after the mirror."""
    f = width / 2 / np.tan(np.radians(fov) / 2)
    u, v = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    return seen_along(scene, location, rotation, u / f, v / f)


def seen_along(scene, location, rotation, right_m, down_m):
    """The same of rays that are so far right of the axis, and below it, one metre ahead."""
    P, Y, R = np.radians(rotation)
    S = np.sin
    C = np.cos
    forward = np.array([C(P) * C(Y), C(P) * S(Y), S(P)])
    right = np.array([S(R) * S(P) * C(Y) - C(R) * S(Y), S(R) * S(P) * S(Y) + C(R) * C(Y), -S(R) * C(P)])
    up = np.array([-(C(R) * S(P) * C(Y) + S(R) * S(Y)), C(Y) * S(R) - C(R) * S(P) * S(Y), C(R) * C(P)])
    rays = forward + right_m[..., None] * right - down_m[..., None] * up
    hits = scene.trace(np.array(location) * (0.01, -0.01, 0.01), rays * (1, -1, 1))
    return hits, hits.distance / np.linalg.norm(rays, axis=-1)


def nearly_all_equal(got, expected, tolerance=0):
    """All but pixels on an edge, where the last digit decides between two surfaces."""
    off = np.abs(got.astype(float) - expected).max(axis=-1) > tolerance
    assert off.mean() < 0.005
