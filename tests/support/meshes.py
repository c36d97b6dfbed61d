"""Meshes made by trimesh, and what rays meet of them: every triangle in float64, one by one."""

from dataclasses import dataclass

import numpy as np
import trimesh
from PIL import Image

from support.overlapping import meet

TO_GLTF = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
"""From Z up to the Y up of glTF."""
SIZE = (6.0, 5.0, 2.8)


@dataclass
class Truth:
    """Triangles (M, 3, 3) metres, world frame, and the label (M,) of each; M is small."""

    corners: np.ndarray
    label: np.ndarray

    def trace(self, origins, directions):
        """Return distance, label and index of the first triangle of rays (N, 3)."""
        starts = np.array(np.broadcast_to(origins, directions.shape), np.float64)
        distance, first = meet(starts, np.ascontiguousarray(directions), self.corners)
        return distance, np.where(np.isfinite(distance), self.label[first], 0), first


def room():
    """Return meshes by name, Z up, in metres: a room, and what stands in it."""
    x, y, z = SIZE

    def box(size, at):
        return trimesh.creation.box(size, trimesh.transformations.translation_matrix(at))

    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.35)
    ball.apply_translation((1.1, 0.9, 1.1))
    return {
        "Floor": box((x, y, 0.1), (0, 0, -0.05)),
        "Ceiling": box((x, y, 0.1), (0, 0, z + 0.05)),
        "Wall_North": box((0.1, y, z), (x / 2 + 0.05, 0, z / 2)),
        "Wall_South": box((0.1, y, z), (-x / 2 - 0.05, 0, z / 2)),
        "Wall_West": box((x, 0.1, z), (0, y / 2 + 0.05, z / 2)),
        "Wall_East": box((x, 0.1, z), (0, -y / 2 - 0.05, z / 2)),
        "Table": box((1.2, 0.7, 0.75), (1.2, 0.9, 0.375)),
        "Crate": box((0.5, 0.5, 0.5), (-0.6, -1.5, 0.25)),
        "Ball": ball,
    }


def write_room(path, seed=2):
    """Write the room as GLB, each object with a picture on it, and return its truth."""
    scene = trimesh.Scene()
    rng = np.random.default_rng(seed)
    meshes = room()
    for name, mesh in meshes.items():
        noise = np.kron(rng.integers(0, 60, (16, 16, 1)), np.ones((4, 4, 1))) + rng.integers(90, 190, 3)
        mesh.unmerge_vertices()
        across = np.argsort(mesh.extents)[1:]
        material = trimesh.visual.material.PBRMaterial(
            name=f"paint {name}", baseColorTexture=Image.fromarray(noise.astype(np.uint8)), doubleSided=True
        )
        mesh.visual = trimesh.visual.TextureVisuals(mesh.vertices[:, across] / 2, material=material)
        scene.add_geometry(mesh, node_name=name, geom_name=name, transform=TO_GLTF)
    path.write_bytes(scene.export(file_type="glb"))
    return truth_of(meshes)


def truth_of(meshes):
    """Return the truth of meshes by name, whose coordinates a file holds in float32."""
    corners = []
    labels = []
    for label, name in enumerate(sorted(meshes), start=1):
        corners.append(meshes[name].triangles)
        labels.append(np.full(len(meshes[name].faces), label))
    return Truth(np.concatenate(corners), np.concatenate(labels))


def directions(count, seed=0):
    """Return (N, 3) random unit vectors."""
    rays = np.random.default_rng(seed).normal(size=(count, 3))
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)
