"""Pictures of worlds with poses, drawn by code that the product does not share, and what spoils them.

Rays meet triangles, or what MuJoCo holds. Colours are sums of waves over the surface.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from numba import njit
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from omniscv.geometry.pinhole import Projection
from omniscv.importing.conventions import PAIRS, WIDTH, Convention, ask
from omniscv.importing.overlap import PosedPictures, Shot

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
        x0 = (u - cx) / fx
        y0 = (v - cy) / fy
        x, y = x0, y0
        for _ in range(20):
            x, y = x0 / (1 + k1 * (x * x + y * y)), y0 / (1 + k1 * (x * x + y * y))
        return np.stack([x, y, np.ones_like(u)], axis=-1)


def walk(at, seed=0, step_deg=9.0, straight=False, still=False):
    """Poses at times along a circle in the room, looking about; or a straight line; or from one place."""
    random = np.random.default_rng(seed)
    phases = random.uniform(0, 2 * np.pi, 5)
    count = len(at)
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


_BOX = np.array(list(np.ndindex(2, 2, 2)), float)[
    [[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6], [0, 2, 6],
     [0, 6, 4], [1, 3, 7], [1, 7, 5]]
]  # fmt: skip


def _boxes(random, boxes):
    """Triangles (T, 3, 3) of a room of 6 x 5 x 3 m and its boxes, none of them in the way."""

    def drawn(*ends):
        return [[*random.uniform(*ends[:2], 2), random.uniform(*ends[2:])] for _ in range(boxes)]

    low = np.array([[-3.0, -2.5, 0], *drawn(-2.6, 2.2, 0, 1.6)])
    size = np.array([[6.0, 5, 3], *drawn(0.3, 1.1, 0.3, 1.4)])
    away = np.abs((low + size / 2)[:, :2]).max(axis=1) > 1.75
    away[0] = True
    return _met([a + b * _BOX for a, b in zip(low[away], size[away], strict=True)])


def _mesh(random, boxes):
    """A dented cave of loose triangles, stairs in it, and prisms, tilted."""
    ball = random.normal(size=(260, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    cave = (ball * random.uniform(2.7, 3.6, (len(ball), 1)))[ConvexHull(ball).simplices] + [0, 0, 1.4]
    stairs = [[1.8 + 0.2 * i, -0.8, 0] + _BOX * [0.2, 1.6, 0.18 * (i + 1)] for i in range(6)]

    def thrown(shape, size):
        angle = random.uniform(0.6, 5.7)
        turn = Rotation.from_rotvec(random.normal(size=3)).as_matrix()
        turned = shape * random.uniform(*size, 3) @ turn
        return turned + np.array([2.2 * np.cos(angle), 2.2 * np.sin(angle), random.uniform(0.4, 2.4)])

    prisms = [thrown(_BOX[[0, 1, 4, 5, 8, 9]], (0.4, 0.9)) for _ in range(7)]
    loose = [thrown(random.normal(size=(1, 3, 3)), (0.2, 0.4)) for _ in range(20)]
    return _met([cave, np.concatenate(stairs), *prisms, np.concatenate(loose)])


def _met(parts):
    """Return what rays meet first in a world of triangles, and the number of its parts."""
    corners = np.concatenate(parts)
    part = np.repeat(np.arange(len(parts)), [len(each) for each in parts])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.abs(normals).argmax(axis=1)
    side = 2 * axis + (normals[np.arange(len(axis)), axis] > 0)

    def trace(origins, rays):
        lengths, index = meet(origins, rays, corners)
        return lengths, part[index], side[index]

    return trace, len(parts)


@njit(cache=True)
def meet(origins, rays, corners):
    """Return the length of each ray to the first triangle, and which that is (Moeller and Trumbore)."""
    lengths, nearest = np.full(len(origins), np.inf), np.zeros(len(origins), np.int64)
    for k in range(len(corners)):
        a, u, v = corners[k, 0], corners[k, 1] - corners[k, 0], corners[k, 2] - corners[k, 0]
        for i in range(len(origins)):
            dx, dy, dz = rays[i, 0], rays[i, 1], rays[i, 2]
            px, py, pz = dy * v[2] - dz * v[1], dz * v[0] - dx * v[2], dx * v[1] - dy * v[0]
            volume = u[0] * px + u[1] * py + u[2] * pz
            if volume == 0:
                continue
            sx, sy, sz = origins[i, 0] - a[0], origins[i, 1] - a[1], origins[i, 2] - a[2]
            first = (sx * px + sy * py + sz * pz) / volume
            qx, qy, qz = sy * u[2] - sz * u[1], sz * u[0] - sx * u[2], sx * u[1] - sy * u[0]
            second = (dx * qx + dy * qy + dz * qz) / volume
            t = (v[0] * qx + v[1] * qy + v[2] * qz) / volume
            if first >= 0 and second >= 0 and first + second <= 1 and 0 < t < lengths[i]:
                lengths[i], nearest[i] = t, k
    return lengths, nearest


def _mujoco(random, boxes):
    """A room with round things that MuJoCo meets."""
    mujoco = pytest.importorskip("mujoco")
    sides = np.array([12.5, 11.8, 10.6]) * [*np.eye(3), *-np.eye(3)]
    rows = [("box", [9, 9, 9], at, [0, 0, 0]) for at in sides]
    for kind in ("sphere", "capsule", "cylinder", "ellipsoid") * 3:
        at = 2.2 * np.exp(1j * random.uniform(0, 6.3))
        size = random.uniform(0.15, 0.45, 3)
        turn = random.uniform(0, 180, 3)
        rows.append((kind, size, [at.real, at.imag, random.uniform(-1.2, 1)], turn))
    geom = '<geom type="{}" size="{}" pos="{}" euler="{}"/>'
    text = ""
    for kind, *numbers in rows:
        text += geom.format(kind, *(" ".join(map(str, each)) for each in numbers))
    body = f"<body pos='0 0 1.5'>{text}</body>"
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    mujoco.mj_forward(model, data := mujoco.MjData(model))

    def trace(origins, rays):
        lengths = np.zeros(len(rays))
        part = np.zeros(len(rays), np.int32)
        for row in np.split(np.arange(len(rays)), np.flatnonzero(np.diff(origins, axis=0).any(axis=1)) + 1):
            at = np.zeros(len(row))
            of = np.zeros(len(row), np.int32)
            start = origins[row[0]]
            ray = rays[row].ravel()
            mujoco.mj_multiRay(model, data, start, ray, None, 1, -1, of, at, None, len(row), 1e9)
            lengths[row] = at
            part[row] = of
        return lengths, part, 0 * part

    return trace, len(rows)


WORLDS = {"boxes": _boxes, "mesh": _mesh, "mujoco": _mujoco}
"""By name what rays meet; none of them knows the product's own scenes."""


def room(
    seed=0, boxes=9, width=96, height=72, plain=False, k1=0.0, late=0.0, rolling=0.0, world="boxes", **path
):
    """Shots of a world, by default a room of 6 x 5 x 3 m with boxes; ``plain``: walls of one colour each.

    Pictures have a distortion ``k1`` that their lens lacks, are taken ``late`` frames after their poses, and
    their rows within ``rolling`` frames.
    """
    random = np.random.default_rng(seed)
    count = path.pop("count", 8)
    R, t = walk(np.arange(count), seed, **path)
    trace, parts = WORLDS[world](random, boxes)
    waves = random.normal(0, 1.0, (parts, 6, 3)) * np.array([4, 7, 12, 18, 25, 35])[:, None]
    phases = random.uniform(0, 6.3, (parts, 6))
    tones = random.uniform(60, 190, (parts, 6, 3))
    lens = 0.85 * width, 0.85 * width, width / 2, height / 2
    shots = Shots(np.zeros((count, height, width)), None, R, t, lens)
    lit = []
    for i in range(count):
        turns, places = walk(i + late + rolling * ((np.arange(height) + 0.5) / height - 0.5), seed, **path)
        rays = np.einsum("hij,hwj->hwi", turns, shots.rays(k1)).reshape(-1, 3)
        origins = np.repeat(places, width, axis=0)
        lengths, part, side = trace(origins, rays)
        points = origins + rays * lengths[:, None]
        texture = sum(np.sin((points * waves[part, k]).sum(axis=1) + phases[part, k]) for k in range(6))
        lit.append(np.clip(tones[part, side] + (0 if plain else 18) * texture[:, None], 0, 255))
        shots.depth[i] = lengths.reshape(height, width)
    return replace(shots, lit=np.round(lit).astype(np.uint8).reshape(count, height, width, 3))


def noisy(shots, seed=0, much=1.0, moving=0.0):
    """The shots of a structured-light camera: noise and steps that grow with depth, holes, JPEG, drift.

    ``moving``: the share of pixels where something passes in front.
    """
    random = np.random.default_rng(seed)
    depth = shots.depth + random.normal(0, 1, shots.depth.shape) * 0.0015 * much * shots.depth**2
    step = 0.0028 * much * depth**2
    depth = np.round(depth / step) * step
    edges = np.abs(np.diff(shots.depth, axis=2, append=shots.depth[:, :, -1:])) > 0.1
    depth[edges | (random.random(depth.shape) < 0.03 * much)] = 0
    lit = np.clip(shots.lit + random.normal(0, 3 * much, shots.lit.shape), 0, 255).astype(np.uint8)
    lit = np.stack([cv2.imdecode(cv2.imencode(".jpg", each)[1], cv2.IMREAD_COLOR) for each in lit])
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
    R = M @ shots.R @ AXES[axes].T
    t = shots.t @ M * per_m
    at = np.clip(np.arange(len(R)) - late, 0, len(R) - 1)
    R = R[at]
    t = t[at]
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


def read(shots, R=None, t=None, depth=1.0, ray=False, pairs=PAIRS, most=WIDTH):
    """Shots as the product has them, with other poses and depth."""
    stored = depth * shots.depth * (np.linalg.norm(shots.rays(), axis=-1) if ray else 1)
    lens = Projection(*shots.lens)
    fov = 2 * np.arctan(shots.depth.shape[2] / 2 / shots.lens[0])
    R, t = (shots.R, shots.t) if R is None else (R, t)
    made = [Shot.of(each, lit, lens, most) for each, lit in zip(stored, shots.lit, strict=True)]
    return PosedPictures.read(R, t, lambda i, width: made[i], fov, pairs, most)


def asked(shots, words, *told, **pictures):
    """The verdict on shots whose poses and depth are said to be as in words."""
    return ask(read(shots, *told, **pictures), words)
