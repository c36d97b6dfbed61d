"""Pictures of rooms with poses, drawn by formulas that the product does not share, and what spoils them.

Rooms are a box with boxes in it; rays meet them by their slabs. Colours are sums of waves over the surface.
"""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from omniscv.sources.recording.conventions import PAIRS, WIDTH, Convention, ask
from omniscv.sources.recording.overlap import PosedPictures, Shot

AXES = {
    "camera": np.eye(3),
    "opengl": np.diag([1.0, -1, -1]),
    "body": np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
    "ned": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "unreal": np.array([[0.0, 0, 1], [1, 0, 0], [0, -1, 0]]),
    "povray": np.diag([1.0, -1, 1]),
    "-y +x +z": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
}
"""By name where right, down and ahead of the camera point in a file's axes: columns."""


@dataclass
class Shots:
    """Planar depth (N, H, W), colours (N, H, W, 3) uint8, camera-to-world poses of OpenCV's axes, metres."""

    depth: np.ndarray
    lit: np.ndarray
    R: np.ndarray
    t: np.ndarray
    lens: tuple[float, float, float, float]

    def rays(self, k1=0.0):
        """Rays (H, W, 3) through the pixels' centres, one ahead."""
        height, width = self.depth.shape[1:]
        fx, fy, cx, cy = self.lens
        v, u = np.mgrid[:height, :width] + 0.5
        x0, y0 = (u - cx) / fx, (v - cy) / fy
        x, y = x0, y0
        for _ in range(20):
            x, y = x0 / (1 + k1 * (x * x + y * y)), y0 / (1 + k1 * (x * x + y * y))
        return np.stack([x, y, np.ones_like(u)], axis=-1)


def walk(at, seed=0, step_deg=9.0, straight=False, still=False):
    """Poses at times along a circle in the room, looking about; or a straight line; or from one place."""
    random = np.random.default_rng(seed)
    phases, count = random.uniform(0, 2 * np.pi, 5), len(at)
    s = at * np.radians(step_deg)
    yaw = s + 0.3 * np.sin(2 * s + phases[0])
    angles = [yaw, 0.12 * np.sin(3 * s + phases[1]), 0.1 * np.sin(2.3 * s + phases[2])]
    t = np.stack([0.9 * np.cos(s), 0.8 * np.sin(s), 1.4 + 0.25 * np.sin(1.7 * s + phases[3])], axis=1)
    if straight:
        t = np.array([-1.0, -0.2, 1.4]) + np.outer(at, [0.08, 0.02, 0.0])
        angles = [np.full(count, 0.4), np.full(count, 0.05), np.zeros(count)]
    if still:
        t = np.tile([0.2, -0.1, 1.4], (count, 1))
    level = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    return Rotation.from_euler("zyx", np.stack(angles, axis=1)).as_matrix() @ level, t


def room(seed=0, boxes=9, width=96, height=72, plain=False, k1=0.0, late=0.0, rolling=0.0, **path):
    """Shots of a room of 6 x 5 x 3 m with boxes; ``plain``: bare walls of one colour each.

    Pictures have a distortion ``k1`` that their lens lacks, are taken ``late`` frames after their poses, and
    their rows within ``rolling`` frames.
    """
    random = np.random.default_rng(seed)
    count = path.pop("count", 8)
    R, t = walk(np.arange(count), seed, **path)
    low = [[-3.0, -2.5, 0.0]] + [
        [*random.uniform(-2.6, 2.2, 2), random.uniform(0, 1.6)] for _ in range(boxes)
    ]
    size = [[6.0, 5.0, 3.0]] + [
        [*random.uniform(0.3, 1.1, 2), random.uniform(0.3, 1.4)] for _ in range(boxes)
    ]
    low, high = np.array(low), np.array(low) + size
    away = (np.abs((low + high) / 2)[:, :2] + 0.0).max(axis=1) > 1.75  # of the walk
    away[0] = True
    low, high = low[away], high[away]
    waves = random.normal(0, 1.0, (len(low), 6, 3)) * np.array([4, 7, 12, 18, 25, 35])[:, None]
    phases, tones = random.uniform(0, 6.3, (len(low), 6)), random.uniform(60, 190, (len(low), 6, 3))
    focal = 0.85 * width
    shots = Shots(np.zeros((count, height, width)), None, R, t, (focal, focal, width / 2, height / 2))
    lit = np.zeros((count, height, width, 3))
    for i in range(count):
        rows = i + late + rolling * ((np.arange(height) + 0.5) / height - 0.5)
        turns, places = walk(rows, seed, **path)
        d, origin = np.einsum("hij,hwj->hwi", turns, shots.rays(k1)), places[:, None]
        nearest = np.full(d.shape[:2], np.inf)
        for k, (a, b) in enumerate(zip(low, high, strict=True)):
            ends = np.stack([(a - origin) / d, (b - origin) / d])
            enter, leave = ends.min(axis=0), ends.max(axis=0)
            axis = leave.argmin(axis=-1) if k == 0 else enter.argmax(axis=-1)
            hit = leave.min(axis=-1) if k == 0 else enter.max(axis=-1)
            met = (hit > 0) & (hit < nearest) & ((k == 0) | (enter.max(axis=-1) < leave.min(axis=-1)))
            p = origin + d * hit[..., None]
            face = 2 * axis + (np.take_along_axis(d, axis[..., None], -1)[..., 0] > 0)
            texture = np.sin(p @ waves[k].T + phases[k]).sum(axis=-1) * (0 if plain else 18)
            color = np.clip(tones[k][face] + texture[..., None], 0, 255)
            nearest, lit[i] = np.where(met, hit, nearest), np.where(met[..., None], color, lit[i])
        shots.depth[i] = nearest
    return replace(shots, lit=np.round(lit).astype(np.uint8))


def noisy(shots, seed=0, much=1.0, moving=0.0):
    """The shots of a structured-light camera: noise and steps that grow with depth, holes, drifting poses.

    ``moving``: the share of pixels where something passes in front.
    """
    random = np.random.default_rng(seed)
    depth = shots.depth + random.normal(0, 1, shots.depth.shape) * 0.0015 * much * shots.depth**2
    step = 0.0028 * much * depth**2
    depth = np.round(depth / step) * step
    edges = np.abs(np.diff(shots.depth, axis=2, append=shots.depth[:, :, -1:])) > 0.1
    depth[edges | (random.random(depth.shape) < 0.03 * much)] = 0
    lit = np.clip(shots.lit + random.normal(0, 3 * much, shots.lit.shape), 0, 255).astype(np.uint8)
    count, height, width = depth.shape
    for i in range(count if moving else 0):
        edge = int(np.sqrt(moving * height * width))
        y, x = random.integers(0, height - edge), random.integers(0, width - edge)
        depth[i, y : y + edge, x : x + edge] = random.uniform(0.8, 2)
        lit[i, y : y + edge, x : x + edge] = random.integers(0, 255, 3)
    turns = Rotation.from_rotvec(np.cumsum(random.normal(0, 5e-4 * much, (count, 3)), axis=0)).as_matrix()
    drift = np.cumsum(random.normal(0, 1e-3 * much, (count, 3)), axis=0)
    return replace(shots, depth=depth, lit=lit, R=shots.R @ turns, t=shots.t + drift)


def inverted(R, t):
    """The inverse of poses."""
    return R.swapaxes(1, 2), -np.einsum("nji,nj->ni", R, t)


def written(shots, axes="camera", inverse=False, transposed=False, per_m=1.0, order=(0, 1, 2, 3), late=0):
    """Rotations and translations as a file in some convention has them; left-handed ones mirror the world."""
    M = np.diag([1.0, np.linalg.det(AXES[axes]), 1.0])
    R, t = M @ shots.R @ AXES[axes].T, shots.t @ M * per_m
    at = np.clip(np.arange(len(R)) - late, 0, len(R) - 1)
    R, t = R[at], t[at]
    R, t = inverted(R, t) if inverse else (R, t)
    R = R.swapaxes(1, 2) if transposed else R
    return Rotation.from_quat(Rotation.from_matrix(R).as_quat()[:, list(order)]).as_matrix(), t


def convention(axes="camera", **more):
    """The product's name of what :func:`written` wrote."""
    return Convention(axes=tuple((AXES[axes].ravel() + 0.0).tolist()), **more)


MISDESCRIBED = {
    **{axes: ({"axes": axes}, {"axes": axes}) for axes in AXES if axes != "camera"},
    "world to camera": ({"inverse": True}, {"inverse": True}),
    "world to camera, opengl": ({"axes": "opengl", "inverse": True}, {"axes": "opengl", "inverse": True}),
    "transposed": ({"transposed": True}, {"transposed": True}),
    "world to camera, transposed": ({"inverse": True, "transposed": True},) * 2,
    "cm": ({"per_m": 100}, {"ratio": 100.0}),
    "mm": ({"per_m": 1000}, {"ratio": 1000.0}),
    "feet": ({"per_m": 1 / 0.3048}, {"ratio": 1 / 0.3048}),
    "1/5000 m called mm": ({"depth": 5.0}, {"ratio": 0.2}),
    "along the ray": ({"ray": True}, {"along": True}),
    "w first": ({"order": (3, 0, 1, 2)}, {"quaternion": "w first"}),
    "w last": ({"order": (1, 2, 3, 0)}, {"quaternion": "w last"}),
    "late": ({"late": 2}, {"shift": 2}),
    "opengl, cm": ({"axes": "opengl", "per_m": 100}, {"axes": "opengl", "ratio": 100.0}),
    "unreal, cm": ({"axes": "unreal", "per_m": 100}, {"axes": "unreal", "ratio": 100.0}),
    "world to camera, along the ray": ({"inverse": True, "ray": True}, {"inverse": True, "along": True}),
    "ned, mm, along the ray": (
        {"axes": "ned", "per_m": 1000, "ray": True},
        {"axes": "ned", "ratio": 1000.0, "along": True},
    ),
}
"""By name what :func:`written` is told, with ``depth`` and ``ray`` of the pictures; and the convention."""


def asked(shots, words, R=None, t=None, depth=1.0, ray=False, lit=True):
    """The verdict on shots whose poses and depth are said to be as in words."""
    R, t = (shots.R, shots.t) if R is None else (R, t)
    stored = depth * shots.depth * (np.linalg.norm(shots.rays(), axis=-1) if ray else 1)
    lens = SimpleNamespace(**dict(zip(("fx", "fy", "cx", "cy"), shots.lens, strict=True)))

    def read(i, width):
        return Shot.of(stored[i], shots.lit[i] if lit else None, lens, width)

    fov = 2 * np.arctan(shots.depth.shape[2] / 2 / shots.lens[0])
    return ask(PosedPictures.read(R, t, read, fov, PAIRS, WIDTH), words)
