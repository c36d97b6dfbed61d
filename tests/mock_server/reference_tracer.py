"""A slow tracer for the tests: reads the same scene files, shares no code or formula with the server.

Everything is a list of patches in the world frame. Flat ones are planes cut by an inside test (the floor by
counting crossings of the polygon, not by rectangles); round ones by the point of closest approach.
"""

from dataclasses import dataclass

import numpy as np


@dataclass
class Flat:
    """A plane through ``center``; ``inside`` says which world points on it belong."""

    name: str
    center: np.ndarray
    normal: np.ndarray
    inside: object

    def hits(self, o, d):
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (self.center - o) @ self.normal / (d @ self.normal)
            points = o + t[:, None] * d
            good = np.isfinite(t) & (t > 0) & self.inside(points)
        yield np.where(good, t, np.inf), np.broadcast_to(self.normal, d.shape)


@dataclass
class Round:
    """A sphere, or with ``half_height`` the side of an upright cylinder."""

    name: str
    center: np.ndarray
    radius: float
    half_height: float | None = None

    def hits(self, o, d):
        used = 3 if self.half_height is None else 2
        q, e = (o - self.center)[:, :used], d[:, :used]
        length = np.linalg.norm(e, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            unit = e / length[:, None]
            closest = -(q * unit).sum(axis=1)
            apart = np.linalg.norm(q + closest[:, None] * unit, axis=1)
            reach = np.sqrt((self.radius - apart) * (self.radius + apart))
            for s in (closest - reach, closest + reach):
                t = s / length
                points = o + t[:, None] * d - self.center
                good = np.isfinite(t) & (t > 0)
                if used == 2:
                    good &= np.abs(points[:, 2]) <= self.half_height
                    points = points * (1, 1, 0)
                yield np.where(good, t, np.inf), points / self.radius


def trace(data, origins, directions):
    """Of each ray (N, 3), directions unit: distance, name of the object ('' for none), normal facing it."""
    patches = list(_patches(data))
    distance = np.full(len(directions), np.inf)
    name = np.full(len(directions), "", dtype=object)
    normal = np.zeros_like(directions)
    for patch in patches:
        for t, n in patch.hits(origins, directions):
            nearer = t < distance
            distance[nearer], name[nearer] = t[nearer], patch.name
            facing = -np.sign((n * directions).sum(axis=1))[:, None]
            normal[nearer] = (n * facing)[nearer]
    return distance, name, normal


def _patches(data):
    if "room" in data:
        yield from _room(data["room"])
    for name, description in data.get("objects", {}).items():
        for solid in description["solids"]:
            yield from _solid(name, solid)


def _room(room):
    corners, height = np.array(room["floor"]), room.get("height", 2.8)
    for i, a in enumerate(corners):
        b = corners[(i + 1) % len(corners)]

        def on_wall(p, a=a, b=b):
            along = (p[:, :2] - a) @ (b - a) / ((b - a) @ (b - a))
            return (along >= 0) & (along <= 1) & (p[:, 2] >= 0) & (p[:, 2] <= height)

        across = np.array([b[1] - a[1], a[0] - b[0], 0.0]) / np.linalg.norm(b - a)
        yield Flat(f"Layout_Wall_{i + 1}", np.append(a, 0.0), across, on_wall)
    for name, z in (("Layout_Floor", 0.0), ("Layout_Ceiling", height)):
        yield Flat(name, np.array([0, 0, z]), np.array([0, 0, 1.0]), lambda p: _within(corners, p))


def _within(corners, p):
    """Even-odd rule."""
    crossings = np.zeros(len(p), dtype=int)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if a[1] != b[1]:
            x = a[0] + (p[:, 1] - a[1]) * (b[0] - a[0]) / (b[1] - a[1])
            crossings += ((a[1] > p[:, 1]) != (b[1] > p[:, 1])) & (p[:, 0] < x)
    return crossings % 2 == 1


def _solid(name, solid):
    center = np.array(solid["at"], dtype=float)
    if "sphere" in solid:
        yield Round(name, center, solid["sphere"])
    elif "cylinder" in solid:
        radius, height = solid["cylinder"]
        yield Round(name, center, radius, height / 2)
        for z in (-height / 2, height / 2):
            yield Flat(
                name,
                center + np.array([0, 0, z]),
                np.array([0, 0, 1.0]),
                lambda p: ((p - center)[:, :2] ** 2).sum(axis=1) <= radius**2,
            )
    else:
        yield from _box(name, center, np.array(solid["box"]) / 2, np.radians(solid.get("turn_deg", 0.0)))


def _box(name, center, half, turn):
    axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    for k in range(3):
        for sign in (-1, 1):
            i, j = (k + 1) % 3, (k + 2) % 3

            def on_face(p, i=i, j=j):
                local = np.abs((p - center) @ axes.T)
                return (local[:, i] <= half[i]) & (local[:, j] <= half[j])

            yield Flat(name, center + sign * half[k] * axes[k], axes[k], on_face)
