"""Three meshes that are made by arrays, and images of them against each of their triangles in float64."""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

import omniscv
from support.drawn import drawn_camera
from support.mesh_files import Builder, y_up
from support.meshes import Truth

MODES = ("object_mask", "depth", "normals")
OFF_M = 1e-6
"""Depth may be off by this, and half a digit of float32."""
_NEAREST_M = 0.05  # of an optical centre to a surface


@dataclass
class World:
    """A mesh in a file, and its truth; images are taken from within ``low`` to ``high``, metres."""

    address: str
    truth: Truth
    low: tuple[float, float, float]
    high: tuple[float, float, float]


class Placed:
    """A GLB file and its triangles, put together side by side."""

    def __init__(self):
        self.built = Builder()
        self.corners = {}
        self.material = self.built.paint("Left")

    def shape(self, mesh):
        """Add a mesh in its own axes, Z up, and return its number and what the file holds of it."""
        place = y_up(mesh.vertices).astype("f4")
        attributes = {
            "POSITION": self.built.accessor(place),
            "TEXCOORD_0": self.built.accessor(mesh.vertices[:, :2].astype("f4")),
        }
        indices = self.built.accessor(mesh.faces.ravel().astype("u4"))
        primitive = {"attributes": attributes, "indices": indices, "material": self.material}
        return self.built.add("meshes", {"primitives": [primitive]}), place.astype(float)[mesh.faces]

    def place(self, name, shape, position=(0, 0, 0), turn_deg=0.0, scale=1.0):
        """Add a node; its turn is about the vertical."""
        number, corners = shape
        turn = Rotation.from_euler("y", turn_deg, degrees=True)
        (at,) = y_up(np.array([position], float))
        node = {"name": name, "mesh": number, "translation": at.tolist(), "rotation": turn.as_quat().tolist()}
        node = self.built.add("nodes", {**node, "scale": [scale] * 3})
        self.built.json["scenes"][0]["nodes"].append(node)
        placed = scale * corners @ turn.as_matrix().T + at
        self.corners[name] = np.stack([placed[..., 0], -placed[..., 2], placed[..., 1]], axis=-1)

    def write(self, path):
        self.built.write(path)
        label = [np.full(len(self.corners[name]), 1 + i) for i, name in enumerate(sorted(self.corners))]
        corners = [self.corners[name] for name in sorted(self.corners)]
        return Truth(np.concatenate(corners), np.concatenate(label))


def box(size):
    return trimesh.creation.box(size)


def furnished(folder, subdivisions=6):
    """A room with dented balls on pedestals: instances of three shapes, a million triangles in all.

    With each subdivision less it has a quarter of that.
    """
    placed = Placed()
    placed.place("Room", placed.shape(box((6, 5, 2.8))), (0, 0, 1.4))
    shapes = []
    for waves in (9, 14, 21):
        ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.25)
        ball.vertices *= (1 + 0.06 * np.sin(waves * ball.vertices).sum(axis=1))[:, None]
        shapes.append(placed.shape(ball))
    pedestal = placed.shape(box((0.3, 0.3, 0.7)))
    rng = np.random.default_rng(1)
    for i in range(12):
        across = 2.3 * np.exp(2j * np.pi * i / 12)
        placed.place(f"Pedestal {i:02}", pedestal, (across.real, 0.8 * across.imag, 0.35), rng.uniform(0, 90))
        at = (across.real, 0.8 * across.imag, 1.0)
        placed.place(f"Ball {i:02}", shapes[i % 3], at, rng.uniform(0, 360), rng.uniform(0.7, 1.2))
    truth = placed.write(folder / "furnished.glb")
    return World(f"mesh://{folder}/furnished.glb", truth, (-1.2, -0.9, 0.5), (1.2, 0.9, 2.3))


def scanned(folder):
    """A surface as a scanner has it: noise of 4 mm, holes, six objects by number, at coordinates of a map."""
    shift = np.array([512345.0, 5412345.0, 120.0])
    shell = trimesh.creation.icosphere(subdivisions=6, radius=2.5)
    rng = np.random.default_rng(2)
    points = shell.vertices.copy()
    points[:, 2] = 0.6 * points[:, 2]
    points += rng.normal(scale=0.004, size=points.shape)
    middles = points[shell.faces].mean(axis=1)
    holes = rng.normal(size=(12, 3))
    holes *= 2.3 / np.linalg.norm(holes, axis=1, keepdims=True)
    kept = np.linalg.norm(middles[:, None] - holes, axis=2).min(axis=1) > 0.35
    faces = shell.faces[kept]
    turns = np.arctan2(middles[kept, 1], middles[kept, 0]) / (2 * np.pi)
    number = 10 + np.floor(6 * (turns + 0.5)).astype("i4")
    vertex = np.zeros(len(points), [("p", "<f8", 3), ("c", "u1", 3)])
    vertex["p"] = points + shift
    vertex["c"] = (127 + 40 * points).clip(0, 255)
    face = np.zeros(len(faces), [("n", "u1"), ("v", "<i4", 3), ("id", "<i4")])
    face["n"] = 3
    face["v"] = faces
    face["id"] = number
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertex)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz")
    header += "".join(f"property uchar {color}\n" for color in ("red", "green", "blue"))
    header += f"element face {len(face)}\nproperty list uchar int vertex_indices\n"
    header += "property int object_id\nend_header\n"
    (folder / "scanned.ply").write_bytes(header.encode() + vertex.tobytes() + face.tobytes())
    truth = Truth(vertex["p"][faces], 1 + np.unique(number, return_inverse=True)[1])
    around = np.array([1, 1, 0.6])
    return World(f"mesh://{folder}/scanned.ply", truth, tuple(shift - around), tuple(shift + around))


def thin(folder):
    """Wires of 2 mm, slats, sheets and a net under an open sky."""
    placed = Placed()
    placed.place("Ground", placed.shape(box((12, 12, 0.02))), (0, 0, -0.01))
    wire = placed.shape(trimesh.creation.cylinder(radius=0.001, height=2.5, sections=8))
    slat = placed.shape(box((0.02, 1.2, 0.002)))
    ends = [[-0.4, 0, 0], [0.4, 0, 0], [0.4, 0, 1], [-0.4, 0, 1]]
    sheet = trimesh.Trimesh(ends, [[0, 1, 2], [0, 2, 3]], process=False)
    sheet = placed.shape(sheet)
    rng = np.random.default_rng(3)
    for i in range(40):
        across = rng.uniform(1.2, 3) * np.exp(1j * rng.uniform(0, 2 * np.pi))
        placed.place(f"Wire {i:02}", wire, (across.real, across.imag, 1.25))
    for i in range(60):
        placed.place(f"Slat {i:02}", slat, (-2.2, 0, 0.3 + 0.03 * i), 0.0)
    for i in range(8):
        across = 1.8 * np.exp(2j * np.pi * i / 8)
        placed.place(f"Sheet {i}", sheet, (across.real, across.imag, 0.4), rng.uniform(0, 360))
    truth = placed.write(folder / "thin.glb")
    return World(f"mesh://{folder}/thin.glb", truth, (-0.8, -0.8, 0.3), (0.8, 0.8, 2.0))


WORLDS = {"furnished, instances": furnished, "scanned, holes": scanned, "thin": thin}


@dataclass
class Judged:
    """Sampled pixels of one image: how many, and of these how many are wrong.

    ``labels`` and ``depths`` are wrong, ``off_m`` is the largest error of depth, ``unmarked`` pixels are
    wrong and have no mark.
    """

    rays: int
    labels: int
    depths: int
    off_m: float
    unmarked: int


def drawn_image(world, source, model, rng, px):
    """Return an image by a drawn camera of a model, from a drawn place."""
    camera = drawn_camera(model, rng, px)
    while True:
        position = rng.uniform(world.low, world.high)
        around = rng.normal(size=(400, 3))
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        if source.trace(position, around).distance.min() > _NEAREST_M:
            break
    pose = omniscv.Pose.from_angles(position, *rng.uniform(-180, 180, 3))
    return omniscv.render(camera, pose, source, MODES)


def judged(image, truth, rng, count):
    """Judge some pixels of an image by all triangles."""
    rays = image.camera.unproject()
    rows = np.flatnonzero(image.valid.ravel())
    rows = rng.choice(rows, min(count, len(rows)), replace=False)
    directions = (rays.directions.reshape(-1, 3)[rows] @ image.pose.R_w_c.T).copy()
    origins = image.pose.to_world(np.broadcast_to(rays.origins, rays.directions.shape).reshape(-1, 3)[rows])
    distance, label, _ = truth.trace(origins, directions)
    depth = image.depth.ravel()[rows].astype(float)
    both = np.isposinf(depth) & np.isposinf(distance)
    with np.errstate(invalid="ignore"):
        off = np.where(both, 0, np.abs(depth - distance))
    wrong_label = image.labels.ravel()[rows] != label
    wrong_depth = ~(off <= OFF_M + np.where(np.isfinite(distance), distance, 0) * 2.0**-24)
    marked = image.unsure.ravel()[rows] | image.label_edge.ravel()[rows]
    unmarked = (wrong_label | wrong_depth) & ~marked
    counts = [int(values.sum()) for values in (wrong_label, wrong_depth, unmarked)]
    return Judged(len(rows), counts[0], counts[1], float(off.max()), counts[2])
