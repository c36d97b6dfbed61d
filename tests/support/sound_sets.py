"""Sound sets of posed pictures: worlds of triangles and of MuJoCo, and paths of hands, robots and turntables.

None of them has a fault: whatever a doctor names in them is a false alarm.
"""

from itertools import product

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from support.overlapping import _BOX as BOX
from support.overlapping import WORLDS, Shots, noisy
from support.overlapping import _met as met

LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
WIDTH, HEIGHT = 96, 72
FOCAL = 0.85 * WIDTH
SKY = (120, 160, 230)


def box(low, size):
    return np.array(low) + BOX * np.array(size)


def hull(points):
    return points[ConvexHull(points).simplices]


def round_things(random, is_tall):
    """Cylinders or balls, at 1.3 m and more from the middle, and the room around them."""
    parts = [box((-3, -2.6, 0), (6, 5.2, 2.9))]
    for _ in range(9):
        angle = random.uniform(0, 6.28)
        far = random.uniform(1.6, 2.3)
        middle = np.array([far * np.cos(angle), far * np.sin(angle), 0])
        radius = random.uniform(0.15, 0.4)
        if is_tall:
            turns = np.linspace(0, 2 * np.pi, 24, endpoint=False)
            ring = radius * np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1)
            above = ring + np.array([0, 0, random.uniform(0.5, 2.5)])
            parts.append(hull(middle + np.concatenate([ring, above])))
        else:
            ball = random.normal(size=(90, 3))
            ball *= radius / np.linalg.norm(ball, axis=1, keepdims=True)
            parts.append(hull(middle + ball + (0, 0, random.uniform(0.4, 2.3))))
    return parts


def slanted(random):
    """An attic: walls that lean, and wedges."""
    floor = np.array([[-3, -2.6, 0], [3, -2.4, 0], [3.2, 2.6, 0], [-3.2, 2.5, 0]])
    top = 0.55 * floor + (0, 0, 3.1) + random.normal(0, 0.15, (4, 3))
    parts = [hull(np.concatenate([floor, top]))]
    for _ in range(7):
        angle = random.uniform(0, 6.28)
        middle = 1.9 * np.array([np.cos(angle), np.sin(angle), 0])
        parts.append(hull(middle + random.uniform(-0.45, 0.45, (7, 3)) + (0, 0, random.uniform(0.3, 1.6))))
    return parts


def outdoors(random):
    """Hills, houses and poles below a sky without depth."""
    x, y = np.meshgrid(np.linspace(-30, 30, 15), np.linspace(-30, 30, 15))
    z = 0.35 * np.sin(0.35 * x + random.uniform(0, 6)) + 0.3 * np.sin(0.3 * y + random.uniform(0, 6)) - 0.4
    points = np.stack([x, y, z], axis=-1)
    lower = np.stack([points[:-1, :-1], points[:-1, 1:], points[1:, 1:]], axis=2).reshape(-1, 3, 3)
    upper = np.stack([points[:-1, :-1], points[1:, 1:], points[1:, :-1]], axis=2).reshape(-1, 3, 3)
    parts = [np.concatenate([lower, upper])]
    for _ in range(14):
        angle = random.uniform(0, 6.28)
        far = random.uniform(3.5, 14)
        at = (far * np.cos(angle), far * np.sin(angle), -1)
        parts.append(box(at, (*random.uniform(0.2, 3, 2), random.uniform(1.5, 6))))
    return parts


def corridor(random):
    """A corridor of 16 m with door frames and radiators."""
    parts = [box((-8, -0.95, 0), (16, 1.9, 2.6))]
    for x in np.arange(-7, 8, 1.7):
        side = random.choice([-0.95, 0.83])
        parts.append(box((x, side, 0), (random.uniform(0.5, 1.0), 0.12, random.uniform(0.7, 2.1))))
    return parts


def floor(random):
    """A flat floor, seen from above, with nothing on it."""
    return [box((-20, -20, -0.5), (40, 40, 0.5))]


def walls(random):
    """An empty room of flat walls."""
    return [box((-3, -2.5, 0), (6, 5, 2.8))]


def of_parts(build):
    return lambda random: met(build(random))


SCENES = {
    "cylinders": of_parts(lambda random: round_things(random, True)),
    "balls": of_parts(lambda random: round_things(random, False)),
    "slanted": of_parts(slanted),
    "outdoors": of_parts(outdoors),
    "corridor": of_parts(corridor),
    "floor": of_parts(floor),
    "walls": of_parts(walls),
    "boxes": lambda random: WORLDS["boxes"](random, 9),
    "mujoco": lambda random: WORLDS["mujoco"](random, 9),
}


def path(kind, scene, count, random):
    """Rotations and positions of a path; over a flat floor cameras look down."""
    s = np.arange(count) / count
    wobble = random.normal(0, 1, (count, 3))
    yaw = 2.2 * s + random.uniform(0, 6)
    pitch = np.zeros(count)
    roll = np.zeros(count)
    t = np.stack([0.9 * np.cos(3 * s), 0.7 * np.sin(3 * s), 1.4 + 0 * s], axis=1)
    if kind == "hand-held":
        yaw = yaw + 0.08 * wobble[:, 0]
        pitch = 0.15 * np.sin(5 * s) + 0.05 * wobble[:, 1]
        roll = 0.06 * wobble[:, 2]
        t = t + 0.04 * random.normal(0, 1, (count, 3))
    elif kind == "orbit":
        t = np.stack([np.cos(2.5 * s), np.sin(2.5 * s), 1.4 + 0 * s], axis=1)
        yaw = 2.5 * s
        pitch = np.full(count, -0.1)
    elif kind == "line":
        t = np.array([-1.0, -0.2, 1.4]) + np.outer(s, [1.7, 0.25, 0.0])
        yaw = np.full(count, 0.3)
    elif kind == "turn":
        t = np.tile([0.1, -0.1, 1.4], (count, 1))
        pitch = 0.1 * np.sin(4 * s)
    if scene == "corridor":
        t = t * (2, 0.3, 1)
        yaw = 0.4 * np.sin(3 * s) + (0 if kind != "turn" else 2 * s)
    if scene == "floor":
        pitch = pitch - 0.9
    R = Rotation.from_euler("zyx", np.stack([yaw, -pitch, roll], axis=1)).as_matrix() @ LEVEL
    return R, t


def sound_set(scene, kind, seed, count=14):
    """Shots of a scene along a path; 0 is depth of no surface."""
    random = np.random.default_rng([seed, *map(ord, scene + kind)])
    trace, parts = SCENES[scene](random)
    R, t = path(kind, scene, count, random)
    waves = random.normal(0, 1.0, (parts, 5, 3)) * np.array([3, 6, 11, 17, 26])[:, None]
    phases = random.uniform(0, 6.3, (parts, 5))
    tones = random.uniform(60, 190, (parts, 6, 3))
    shots = Shots(np.zeros((count, HEIGHT, WIDTH)), None, R, t, (FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2))
    rays = shots.rays().reshape(-1, 3)
    lit = np.zeros((count, HEIGHT, WIDTH, 3), np.uint8)
    for i in range(count):
        rays_w = rays @ R[i].T
        origins = np.tile(t[i], (len(rays), 1))
        lengths, part, side = trace(origins, rays_w)
        is_hit = np.isfinite(lengths) & (lengths > 0)
        points = origins + rays_w * np.where(is_hit, lengths, 0)[:, None]
        texture = np.zeros(len(points))
        for k in range(5):
            texture += np.sin((points * waves[part, k]).sum(axis=1) + phases[part, k])
        colors = tones[part, side] + 18 * texture[:, None]
        colors[~is_hit] = SKY
        lit[i] = np.clip(colors, 0, 255).reshape(HEIGHT, WIDTH, 3)
        shots.depth[i] = np.where(is_hit, lengths, 0).reshape(HEIGHT, WIDTH)
    shots.lit = lit
    return shots


KINDS = ("hand-held", "orbit", "level", "line", "turn")
SETS = [
    (scene, kind, seed, is_noisy)
    for seed in range(3)
    for scene, kind, is_noisy in product(SCENES, KINDS, (0, 1))
][:210]
"""Scene, path, seed, and whether depth, colours and poses have the noise of a structured-light camera."""


def drawn(scene, kind, seed, is_noisy):
    shots = sound_set(scene, kind, seed)
    if not is_noisy:
        return shots
    spoilt = noisy(shots, seed)
    spoilt.depth = np.nan_to_num(spoilt.depth, nan=0.0)
    return spoilt
