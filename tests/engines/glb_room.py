"""A furnished room as a GLB file, and its triangles: what an engine draws, and the exact truth of it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import trimesh
from PIL import Image
from support.overlapping import meet

SIZE = (6.0, 5.0, 2.8)
_TO_GLTF = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
"""From Z up to the Y up of glTF."""


def meshes():
    """Return the objects of the room by name: meshes in metres, Z up, the floor's middle at the origin."""
    x, y, z = SIZE

    def box(size, at):
        return trimesh.creation.box(size, trimesh.transformations.translation_matrix(at))

    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.35)
    ball.apply_translation((1.1, 0.9, 1.1))
    pillar = trimesh.creation.cylinder(radius=0.15, height=2.0, sections=48)
    pillar.apply_translation((-1.3, 1.1, 1.0))
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
        "Pillar": pillar,
    }


def write(path):
    """Write the room; every object has a texture of its own tint, laid on by its two largest extents."""
    scene = trimesh.Scene()
    rng = np.random.default_rng(2)
    for name, mesh in meshes().items():
        noise = np.kron(rng.integers(0, 60, (16, 16, 1)), np.ones((4, 4, 1))) + rng.integers(90, 190, 3)
        mesh.unmerge_vertices()
        across = np.argsort(mesh.extents)[1:]
        material = trimesh.visual.material.PBRMaterial(
            baseColorTexture=Image.fromarray(noise.astype(np.uint8)), metallicFactor=0.0, roughnessFactor=1.0
        )
        mesh.visual = trimesh.visual.TextureVisuals(mesh.vertices[:, across] / 2, material=material)
        scene.add_geometry(mesh, node_name=name, geom_name=name, transform=_TO_GLTF)
    path.write_bytes(scene.export(file_type="glb"))


class Triangles:
    """The room's triangles, traced one by one in float64."""

    def __init__(self, names):
        found = meshes()
        self.corners = np.concatenate([found[name].triangles for name in names])
        self.label = np.repeat(np.arange(len(names)) + 1, [len(found[name].faces) for name in names])
        a, b, c = self.corners.swapaxes(0, 1)
        self.normals = np.cross(b - a, c - a)
        self.normals /= np.linalg.norm(self.normals, axis=1, keepdims=True)

    def trace(self, origins, directions):
        starts = np.array(np.broadcast_to(origins, directions.shape)).reshape(-1, 3)
        rays = np.array(directions).reshape(-1, 3)
        distance, first = (each.reshape(directions.shape[:-1]) for each in meet(starts, rays, self.corners))
        normal = self.normals[first]
        seen = np.isfinite(distance)
        normal *= -np.sign(np.sum(normal * directions, axis=-1, keepdims=True)) * seen[..., None]
        return SimpleNamespace(distance=distance, label=np.where(seen, self.label[first], 0), normal=normal)
