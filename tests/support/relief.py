"""A lab of fine relief: structures of many kinds by seed, and a float64 tracer that shares no other's code.

The camera stands at the origin and looks along z (x right, y down); the structure lies about ``AWAY`` metres
ahead, before a wall. Its features are so many captured pixels large. One picture of it is captured, an image
is composed of that picture, and what it claims is compared with the tracer. ``scripts/judge-relief`` prints a
table.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numba
import numpy as np

import omniscv
from omniscv.geometry import Pose
from omniscv.sources.base import Capabilities, Capture, ObjectTable, Request, Source, View
from omniscv.sources.pictures import PictureSource

AWAY = 3.0
BEHIND = 4.5
EDGE_PX = 384
HALF_M = 2.4
"""Of the structures' width: beyond what the images see."""
MODES = ("object_mask", "depth")


class World(NamedTuple):
    """Parallelograms (corner, two edges), balls (centre, radius), rods (two ends, radius); labels of each."""

    quads: np.ndarray
    balls: np.ndarray
    rods: np.ndarray
    labels: tuple[np.ndarray, np.ndarray, np.ndarray]

    def trace(self, directions):
        """Return distances and labels (N,) along unit rays (N, 3) from the origin; inf and 0 for none."""
        distance = np.full(len(directions), np.inf)
        label = np.zeros(len(directions), np.int64)
        _quads(directions, self.quads, self.labels[0], distance, label)
        _balls(directions, self.balls, self.labels[1], distance, label)
        _rods(directions, self.rods, self.labels[2], distance, label)
        return distance, label

    def seen_from(self, point):
        quads = self.quads.copy()
        balls = self.balls.copy()
        rods = self.rods.copy()
        for corners in (quads[:, :3], balls[:, :3], rods[:, :3], rods[:, 3:6]):
            corners -= point
        return World(quads, balls, rods, self.labels)


@numba.njit(cache=True)
def _quads(rays, quads, labels, distance, label):
    for k in range(len(quads)):
        p, u, v = quads[k, :3], quads[k, 3:6], quads[k, 6:]
        n0, n1, n2 = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        above = n0 * p[0] + n1 * p[1] + n2 * p[2]
        uu, uv, vv = (u * u).sum(), (u * v).sum(), (v * v).sum()
        area = uu * vv - uv * uv
        for i in range(len(rays)):
            d0, d1, d2 = rays[i, 0], rays[i, 1], rays[i, 2]
            t = above / (n0 * d0 + n1 * d1 + n2 * d2)
            if not 0 < t < distance[i]:
                continue
            x, y, z = t * d0 - p[0], t * d1 - p[1], t * d2 - p[2]
            of_u, of_v = x * u[0] + y * u[1] + z * u[2], x * v[0] + y * v[1] + z * v[2]
            a, b = (vv * of_u - uv * of_v) / area, (uu * of_v - uv * of_u) / area
            if 0 <= a <= 1 and 0 <= b <= 1:
                distance[i], label[i] = t, labels[k]


@numba.njit(cache=True)
def _balls(rays, balls, labels, distance, label):
    for k in range(len(balls)):
        x, y, z, r = balls[k]
        for i in range(len(rays)):
            along = x * rays[i, 0] + y * rays[i, 1] + z * rays[i, 2]
            left = along * along - (x * x + y * y + z * z - r * r)
            if left >= 0:
                t = along - np.sqrt(left)
                if 0 < t < distance[i]:
                    distance[i], label[i] = t, labels[k]


@numba.njit(cache=True)
def _rods(rays, rods, labels, distance, label):
    for k in range(len(rods)):
        p, axis, r = rods[k, :3], rods[k, 3:6] - rods[k, :3], rods[k, 6]
        length = np.sqrt((axis * axis).sum())
        axis = axis / length
        pa = (p * axis).sum()
        for i in range(len(rays)):
            da = rays[i, 0] * axis[0] + rays[i, 1] * axis[1] + rays[i, 2] * axis[2]
            a = 1.0 - da * da
            b = rays[i, 0] * p[0] + rays[i, 1] * p[1] + rays[i, 2] * p[2] - da * pa
            left = b * b - a * ((p * p).sum() - pa * pa - r * r)
            if left >= 0 and a > 0:
                t = (b - np.sqrt(left)) / a
                if 0 < t < distance[i] and 0 <= t * da - pa <= length:
                    distance[i], label[i] = t, labels[k]


def _turned(rng, parts, most_deg=12.0):
    """Yield parts of a structure, turned together by a random small rotation about its middle."""
    angle = np.radians(rng.uniform(-most_deg, most_deg))
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    K = np.cross(np.eye(3), axis)
    R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    for kind, part in parts:
        points = _POINTS[kind]
        triples = part[: len(part) // 3 * 3].reshape(-1, 3)
        about = np.where(np.arange(len(triples))[:, None] < points, (0.0, 0.0, AWAY), 0.0)
        yield kind, np.concatenate([((triples - about) @ R.T + about).ravel(), part[triples.size :]])


_POINTS = {"quad": 1, "ball": 1, "rod": 2}
"""How many of a part's first triples are points; others are edges, and the rest is a radius."""


def quad(p, u, v):
    return "quad", np.concatenate([p, u, v]).astype(np.float64)


def rod(p, q, r):
    return "rod", np.array([*p, *q, r], np.float64)


def ball(p, r):
    return "ball", np.array([*p, r], np.float64)


def box(low, high):
    """The three faces of a box that the camera may see, and the two others."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    x, y, z = np.diag(high - low)
    return [quad(low, x, y), quad(low, y, z), quad(low + x, y, z), quad(low, x, z), quad(low + y, x, z)]


def extruded(profile):
    """Walls along y through the corners (x, z) of a profile."""
    tall = np.array([0.0, 2 * HALF_M, 0.0])
    for (x, z), (x1, z1) in pairwise(profile):
        yield quad((x, -HALF_M, z), (x1 - x, 0, z1 - z), tall)


TALL = (0.0, 2 * HALF_M, 0.0)
WIDE = (2 * HALF_M, 0.0, 0.0)


def across(pitch):
    return np.arange(-HALF_M, HALF_M, pitch)


def around(pitch, most=24):
    reach = min(HALF_M, most * pitch)
    return np.arange(-reach, reach, pitch)


def upright(xs, radius, z=AWAY, lean=0.0):
    return [rod((x, -HALF_M, z), (x + lean, HALF_M, z), radius) for x in xs]


def level(ys, radius, z):
    return [rod((-HALF_M, y, z), (HALF_M, y, z), radius) for y in ys]


def strips(xs, width, z=AWAY, more=0.0):
    return [quad((x, -HALF_M, z), (width, more, 0), TALL) for x in xs]


def saw(degrees):
    def make(rng, p):
        high = p / 2 * np.tan(np.radians(degrees))
        return list(extruded([(x, AWAY + high * (k % 2)) for k, x in enumerate(across(p / 2))]))

    return make


def panels(rng, p):
    return [quad((x, -HALF_M, AWAY + 0.003 * rng.integers(2)), (p, 0, 0), TALL) for x in across(p)]


def stairs(rng, p):
    x = -HALF_M
    z = AWAY - 0.5
    corners = [(x, z)]
    while x < HALF_M:
        corners += [(x + p, z), (x + p, z + p * 0.6)]
        x, z = corners[-1]
    return list(extruded(corners))


def grazing(rng, p):
    """Stairs away along the line of sight, below it."""
    parts = []
    for k, z in enumerate(np.arange(1.0, BEHIND, p * 4)):
        corner = (-HALF_M, 0.9 - k * p * 0.5, z)
        parts += [quad(corner, WIDE, (0, 0, p * 4)), quad(corner, WIDE, (0, p * 0.5, 0))]
    return parts


def boards(rng, p):
    """A floor of boards with slits of a tenth, seen at a grazing angle, and the ground below."""
    parts = [quad((-HALF_M, 0.75, 0.8), WIDE, (0, 0, BEHIND))]
    for x in across(p):
        parts += box((x, 0.7, 0.8), (x + 0.9 * p, 0.75, BEHIND))
    return parts


def books(rng, p):
    parts = []
    x = -HALF_M
    while x < HALF_M:
        width = p * rng.uniform(0.6, 1.4)
        z = AWAY + rng.uniform(-0.08, 0.08)
        parts += box((x, -HALF_M, z), (x + width, HALF_M, z + 0.3))
        x += width + rng.choice([0.0, 0.0, 0.15 * p])
    return parts


def gravel(rng, p):
    spread = min(HALF_M, 15 * p)
    return [
        ball((*rng.uniform(-spread, spread, 2), AWAY + rng.uniform(-p, p)), p * rng.uniform(0.3, 0.7))
        for _ in range(900)
    ]


def leaves(rng, p):
    spread = min(HALF_M, 15 * p)
    parts = []
    for _ in range(900):
        u, v = rng.normal(size=(2, 3))
        v -= u * (u @ v) / (u @ u)
        u, v = p * u / np.linalg.norm(u), 0.7 * p * v / np.linalg.norm(v)
        parts.append(quad((*rng.uniform(-spread, spread, 2), AWAY + rng.uniform(-0.3, 0.3)), u, v))
    return parts


def fence(rng, p):
    parts = []
    for x in across(p):
        parts += box((x, -HALF_M, AWAY), (x + 0.6 * p, HALF_M, AWAY + 0.02))
    return parts


def cables(rng, p):
    ends = rng.uniform(-HALF_M, HALF_M, (60, 2))
    return [
        rod((a, -HALF_M, AWAY + 0.01 * k), (b, HALF_M, AWAY - 0.01 * k), p / 2)
        for k, (a, b) in enumerate(ends)
    ]


def bricks(rng, p):
    reach = min(HALF_M, 22 * p)
    at = [
        (x, y, AWAY)
        for k, y in enumerate(np.arange(-reach, reach, p))
        for x in np.arange(-reach - (k % 2) * p, reach, 2 * p)
    ]
    ground = quad((-HALF_M, -HALF_M, AWAY + 0.005), WIDE, TALL)
    return [ground, *(quad(corner, (1.8 * p, 0, 0), (0, 0.8 * p, 0)) for corner in at)]


def waves(rng, p):
    xs = across(p / 12)
    return list(extruded(np.stack([xs, AWAY + p / 4 * np.sin(2 * np.pi * xs / p)], axis=1)))


# Drawn when the rules were fixed.


def shingles(rng, p):
    at = [(x - k % 2 * 0.5 * p, y) for k, y in enumerate(around(p)) for x in around(p)]
    lifted = rng.uniform(0.5, 1.5, len(at))
    return [
        quad((x, y, AWAY - 0.05 * p * up), (0.94 * p, 0, 0), (0, 1.25 * p, 0.35 * p))
        for (x, y), up in zip(at, lifted, strict=True)
    ]


def perforated(rng, p):
    """A sheet with square holes."""
    sheet = [quad((-2, y, AWAY), (4, 0, 0), (0, 0.45 * p, 0)) for y in around(p)]
    at = [(x, y + 0.45 * p, AWAY) for y in around(p) for x in around(p)]
    return sheet + [quad(corner, (0.45 * p, 0, 0), (0, 0.55 * p, 0)) for corner in at]


def twigs(rng, p):
    parts = []
    spread = min(HALF_M, 18 * p)
    for _ in range(500):
        a = [*rng.uniform(-spread, spread, 2), AWAY + rng.uniform(-0.4, 0.4)]
        toward = rng.normal(size=3)
        b = a + toward / np.linalg.norm(toward) * p * rng.uniform(3, 9)
        parts.append(rod(a, b, p * rng.uniform(0.12, 0.4)))
    return parts


def cans(rng, p):
    at = [(x + k % 2 * p / 2, y, AWAY + p * rng.uniform(-0.1, 0.1))
          for k, y in enumerate(around(1.3 * p, 17)) for x in around(p)]  # fmt: skip
    return [rod((x, y, z), (x, y + 1.28 * p, z), 0.49 * p) for x, y, z in at]


def shell(rng, p):
    """Large balls, of which each shows a rim."""
    at = [(x, y) for x in around(p, 20) for y in around(1.7 * p, 12)]
    return [ball((x, y + p * rng.uniform(-0.1, 0.1), AWAY + 2.4 * p + 0.25 * x), 2.5 * p) for x, y in at]


def chain_link(rng, p):
    return [
        rod((a - s * HALF_M, -HALF_M, AWAY + z), (a + s * HALF_M, HALF_M, AWAY + z), p / 9)
        for a in np.arange(-2 * HALF_M, 2 * HALF_M, p)
        for s, z in ((1, 0), (-1, p / 9))
    ]


KINDS: dict[str, Callable[..., list]] = {
    "logs": lambda rng, p: upright(across(p), p / 2),
    "saw 45": saw(45), "saw 20": saw(20), "panels 3 mm": panels, "stairs": stairs,
    "stairs, grazing": grazing, "boards, grazing": boards, "books": books,
    "louver": lambda rng, p: [quad((-HALF_M, y, AWAY), WIDE, (0, 0.9 * p, 0.7 * p)) for y in across(p)],
    "balls": lambda rng, p: [
        ball((x, y, AWAY), p / 2) for x in across(p) for y in across(p) if max(abs(x), abs(y)) < 40 * p
    ],
    "gravel": gravel,
    # Two layers, one turned against the other.
    "bars": lambda rng, p: upright(across(p), p / 4) + upright(across(p), p / 4, AWAY + 0.3, lean=0.4),
    "mesh": lambda rng, p: upright(across(p), p / 8) + level(across(p), p / 8, AWAY + p / 8),
    "leaves": leaves, "fence": fence, "cables": cables, "bricks": bricks, "waves": waves,
    # Ladders of bars across, at several depths.
    "rungs": lambda rng, p: [bar for z in (2.6, 3.1, 3.7) for bar in level(across(p), p / 5, z)],
    "saw 70": saw(70), "shingles": shingles,
    # Turned away by 22 degrees.
    "half-open louver": lambda rng, p: [
        quad((-2, y, AWAY + 0.8), (4, 0, -1.6), (0, 0.55 * p, 0.8 * p)) for y in across(p)
    ],
    "perforated sheet": perforated, "chain link": chain_link, "twigs": twigs, "cans": cans, "shell": shell,
    "two gratings": lambda rng, p: (
        strips(across(p), 0.5 * p) + strips(across(1.13 * p), 0.6 * p, AWAY + 0.45, more=0.02)
    ),
}  # fmt: skip


def world(kind, px, seed, turn_deg=12.0, objects=200):
    """Return a structure of many objects whose features are ``px`` captured pixels large at its middle."""
    rng = np.random.default_rng([seed, *kind.encode()])
    parts = _turned(rng, KINDS[kind](rng, px * AWAY / (EDGE_PX / 2)), turn_deg)
    wall = quad((-9, -9, BEHIND), (18, 0, 0), (0, 18, 0))
    every = [(*wall, 1), *((*part, 2 + k % objects) for k, part in enumerate(parts))]
    arrays = []
    labels = []
    for name, size in (("quad", 9), ("ball", 4), ("rod", 7)):
        arrays.append(np.array([part for each, part, _ in every if each == name]).reshape(-1, size))
        labels.append(np.array([label for each, _, label in every if each == name], np.int64))
    return World(*arrays, tuple(labels))


FLOATS = "npy"
HALF_FLOATS = "npy planar cm"
MILLIMETRES = "png uint16 1000"
COLORS = {f"o{k:03d}": (k, 255 - k, 7) for k in range(1, 202)}


def captured(scene, view, encoding=FLOATS):
    at_x, at_y = ((np.arange(size) + 0.5 - size / 2) / view.focal_px for size in (view.width, view.height))
    rays = np.stack([*np.broadcast_arrays(at_x[None], at_y[:, None], 1.0)], axis=-1)
    lengths = np.linalg.norm(rays, axis=-1)
    rays_w = (rays / lengths[..., None]).reshape(-1, 3) @ view.pose.R_w_c.T
    distance, label = scene.seen_from(view.pose.t_w_c).trace(rays_w)
    depth = distance.reshape(lengths.shape) / lengths
    if encoding == HALF_FLOATS:  # as plugin 1.x sends them: centimetres
        depth = (depth * 100).astype(np.float16).astype(np.float64) / 100
    elif encoding == MILLIMETRES:
        depth = np.round(depth * 1000) / 1000
    mask = np.array([(0, 0, 0), *COLORS.values()], np.uint8)[label.reshape(lengths.shape)]
    return {
        "depth": Capture(Request(view, "depth"), view, depth.astype(np.float32), encoding=encoding),
        "object_mask": Capture(Request(view, "object_mask"), view, mask),
    }


VIEW = View(Pose(np.zeros(3), np.eye(3)), 90.0, EDGE_PX, EDGE_PX)


class Traced(Source):
    capabilities = Capabilities(frozenset(MODES))

    def __init__(self, scene):
        self._captured = lru_cache(8)(lambda view: captured(scene, view))

    def capture(self, requests):
        return (self._captured(request.view)[request.mode] for request in requests)

    def objects(self):
        return ObjectTable(COLORS)


BARS = """
room: {{floor: [[-3, -3], [3, -3], [3, 3], [-3, 3]], height: 3,
  walls: [{{kind: plain, colors: [[0.8, 0.7, 0.6]]}}]}}
objects: {{Bars: {{texture: {{kind: plain, colors: [[0.2, 0.2, 0.2]]}}, solids: [{}]}}}}
"""


def scene_of_bars(folder, pitch_m):
    """Write a scene of bars before a wall; the path of its file."""
    at = np.arange(-2.5, 2.5, pitch_m)
    bars = (f"{{box: [0.02, {0.6 * pitch_m:.5f}, 3], at: [2.6, {y:.5f}, 1.5]}}" for y in at)
    (folder / "bars.yaml").write_text(BARS.format(", ".join(bars)))
    return str(folder / "bars.yaml")


class Judged(NamedTuple):
    """Shares of the pixels that look at the structure: wrong, and not marked."""

    depth: float
    labels: float


def judge(kind, px, seed, encoding=FLOATS, camera_px=300, objects=200):
    """Return how an image of a structure errs without saying so."""
    scene = world(kind, px, seed, objects=objects)
    camera = omniscv.cameras.create("fisheye-equidistant", camera_px, camera_px, fov_deg=70)
    turn = Pose.from_angles((0, 0, 0), yaw_deg=0.7, pitch_deg=0.4, roll_deg=11.3)
    pose = Pose(np.zeros(3), Pose.from_angles((0, 0, 0)).R_w_c.T @ turn.R_w_c)
    picture = PictureSource([*captured(scene, VIEW, encoding).values()], ObjectTable(COLORS))
    return judged(omniscv.render(camera, pose, picture, MODES), scene)


def judged(image, scene):
    distance, label = scene.trace(image.camera.unproject().directions[image.valid] @ image.pose.R_w_c.T)
    on = label > 1
    depth = image.depth[image.valid].astype(float)
    bound = image.depth_error[image.valid].astype(float)
    unsure = image.unsure[image.valid]
    edge = image.label_edge[image.valid]
    off = ~(np.abs(depth - distance) <= bound * (1 + 1e-6) + 1e-6 * distance) & ~unsure
    other = (image.labels[image.valid] != label) & ~edge & ~unsure
    return Judged(off[on].mean(), other[on].mean())


def table(kinds=tuple(KINDS), sizes=(1.4, 2.0, 3.0, 4.5), seeds=(21, 22), camera_px=200) -> Iterator[str]:
    """Yield rows of Markdown: percent of the pixels on a structure whose depth, or label, is wrong and not
    marked."""
    columns = [(px, encoding) for encoding in (FLOATS, HALF_FLOATS) for px in sizes]
    titles = [f"{px:g} px, {'floats' if encoding == FLOATS else 'half floats'}" for px, encoding in columns]
    yield f"| kind | {' | '.join(titles)} |"
    yield "|---" * (1 + len(columns)) + "|"
    wrong = np.empty((len(kinds), len(columns), 2))
    for kind, shares in zip(kinds, wrong, strict=True):
        for column, (px, encoding) in zip(shares, columns, strict=True):
            column[:] = 100 * np.mean([judge(kind, px, seed, encoding, camera_px) for seed in seeds], axis=0)
        yield _cells(kind, shares)
    yield _cells("mean", wrong.mean(axis=0))


def _cells(kind, shares):
    return f"| {kind} | {' | '.join(f'{depth:.2f}, {label:.2f}' for depth, label in shares)} |"
