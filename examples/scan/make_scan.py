"""Make a furnished room as a GLB file, with pictures on its surfaces, as of a scan or from a modeller.

::

    pip install omniscv[mesh]
    python examples/scan/make_scan.py examples/scan/room.glb
    omniscv render examples/scan/scan.yaml
"""

import sys
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

SIZE = (6.0, 5.0, 2.8)  # metres
TO_GLTF = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])  # from Z up to Y up


def boards(rng, rgb, rows=16, px=512):
    """Return a picture of wooden boards."""
    v, u = np.mgrid[:px, :px] / px
    row = np.floor(v * rows).astype(int)
    tone = rng.uniform(0.75, 1.05, rows)[row]
    grain = 0.06 * np.sin(60 * v * rows + 9 * np.sin(2 * np.pi * (u + rng.uniform(0, 1, rows)[row])))
    gap = np.where(v * rows % 1 < 0.05, 0.55, 1.0)
    return picture(np.multiply.outer((tone + grain) * gap, rgb))


def plaster(rng, rgb, px=256):
    """Return a picture of a wall with a soft pattern."""
    coarse = Image.fromarray(rng.integers(0, 255, (32, 32), np.uint8)).resize(
        (px, px), Image.Resampling.BICUBIC
    )
    return picture(np.multiply.outer(0.94 + 0.06 * np.asarray(coarse) / 255, rgb))


def checks(rgb, other, count=8, px=256):
    """Return a picture of squares."""
    v, u = np.mgrid[:px, :px] * count // px
    return picture(np.where(((u + v) % 2)[..., None], rgb, other))


def picture(rgb):
    """Return a picture of colours (H, W, 3) from 0 to 1."""
    return Image.fromarray((255 * np.clip(rgb, 0, 1)).astype(np.uint8))


def box(size, at, turn_deg=0.0):
    """Return a box whose middle is at a place, turned about the vertical."""
    mesh = trimesh.creation.box(size)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(turn_deg), (0, 0, 1)))
    mesh.apply_translation(at)
    return mesh


def table(at):
    """Return a table top on four legs."""
    parts = [box((1.4, 0.8, 0.05), (0, 0, 0.72))]
    for x in (-0.62, 0.62):
        parts += [box((0.06, 0.06, 0.7), (x, y, 0.35)) for y in (-0.32, 0.32)]
    return trimesh.util.concatenate(parts).apply_translation(at)


def chair(at, turn_deg):
    """Return a chair."""
    parts = [box((0.45, 0.45, 0.05), (0, 0, 0.45)), box((0.05, 0.45, 0.5), (-0.2, 0, 0.72))]
    for x in (-0.19, 0.19):
        parts += [box((0.04, 0.04, 0.43), (x, y, 0.215)) for y in (-0.19, 0.19)]
    mesh = trimesh.util.concatenate(parts)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(turn_deg), (0, 0, 1)))
    return mesh.apply_translation(at)


def vase(at):
    """Return a turned vase."""
    z = np.linspace(0, 0.4, 60)
    profile = np.column_stack([0.07 + 0.05 * np.sin(11 * z + 0.4), z])
    return trimesh.creation.revolve(profile, sections=96).apply_translation(at)


def plant(at, rng):
    """Return a plant of bent leaves, each a strip of triangles that is seen from both sides."""
    leaves = []
    for turn in np.linspace(0, 2 * np.pi, 22, endpoint=False):
        t = np.linspace(0, 1, 12)
        reach = rng.uniform(0.3, 0.6)
        rise = rng.uniform(0.5, 1.1)
        spine = np.column_stack([reach * t**1.6, np.zeros_like(t), rise * t - 0.6 * reach * t**3])
        width = 0.05 * np.sin(np.pi * np.clip(t, 0.03, 0.97))
        points = np.concatenate([spine + np.outer(width, (0, 1, 0)), spine - np.outer(width, (0, 1, 0))])
        faces = []
        for i in range(len(t) - 1):
            faces += [[i, i + 1, i + 12], [i + 1, i + 13, i + 12]]
        leaf = trimesh.Trimesh(points, faces, process=False)
        leaf.apply_transform(trimesh.transformations.rotation_matrix(turn, (0, 0, 1)))
        leaves.append(leaf)
    return trimesh.util.concatenate(leaves).apply_translation(at)


def walls(rng):
    """Return floor, ceiling and walls, as :func:`objects`."""
    x, y, z = SIZE
    yield "Floor", box((x, y, 0.1), (0, 0, -0.05)), boards(rng, (0.72, 0.53, 0.36)), 2.0
    yield "Ceiling", box((x, y, 0.1), (0, 0, z + 0.05)), plaster(rng, (0.93, 0.93, 0.9)), 3.0
    for name, side, rgb in (
        ("Wall North", 1, (0.85, 0.8, 0.7)),
        ("Wall South", -1, (0.66, 0.75, 0.78)),
    ):
        yield name, box((0.1, y, z), (side * (x / 2 + 0.05), 0, z / 2)), plaster(rng, rgb), 3.0
    for name, side, rgb in (
        ("Wall West", 1, (0.87, 0.76, 0.66)),
        ("Wall East", -1, (0.72, 0.78, 0.7)),
    ):
        yield name, box((x, 0.1, z), (0, side * (y / 2 + 0.05), z / 2)), plaster(rng, rgb), 3.0


def objects():
    """Yield the objects of the room: name, mesh, its picture, and metres that the picture spans."""
    rng = np.random.default_rng(4)
    yield from walls(rng)
    walnut = boards(rng, (0.45, 0.3, 0.2), rows=6)
    cloth = checks((0.75, 0.2, 0.2), (0.9, 0.85, 0.75))
    rug = checks((0.25, 0.35, 0.55), (0.8, 0.78, 0.7), 12)
    yield "Rug", box((2.6, 1.8, 0.01), (0.6, 0.3, 0.006)), rug, 1.8
    yield "Table", table((1.2, 0.6, 0)), walnut, 1.4
    yield "Chair 1", chair((1.0, -0.2, 0), 90), cloth, 0.6
    yield "Chair 2", chair((1.5, 1.4, 0), -90), cloth, 0.6
    yield "Chair 3", chair((0.2, 0.6, 0), 0), cloth, 0.6
    yield "Shelf", box((0.35, 1.6, 1.9), (-2.75, -0.8, 0.95)), walnut, 1.0
    for number in range(7):
        book = box((0.22, 0.05, 0.25 + 0.02 * (number % 3)), (-2.72, -1.3 + 0.07 * number, 2.03))
        hue = np.abs(np.sin(np.array([1, 2, 3]) * (number + 1)))
        yield f"Book {number + 1}", book, plaster(rng, 0.3 + 0.6 * hue), 0.3
    yield "Vase", vase((1.5, 0.6, 0.745)), checks((0.15, 0.4, 0.5), (0.85, 0.9, 0.9), 10), 0.4
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.22)
    yield "Ball", ball.apply_translation((-0.9, 1.2, 0.22)), checks((0.9, 0.5, 0.1), (0.95, 0.9, 0.8), 6), 0.5
    pot = trimesh.creation.cylinder(0.2, 0.4, sections=64)
    yield "Pot", pot.apply_translation((-2.2, 1.8, 0.2)), plaster(rng, (0.7, 0.4, 0.3)), 0.5
    yield "Plant", plant((-2.2, 1.8, 0.38), rng), plaster(rng, (0.25, 0.5, 0.2)), 0.4
    painting = checks((0.9, 0.75, 0.2), (0.2, 0.3, 0.5), 5)
    yield "Picture", box((1.2, 0.03, 0.8), (-0.4, -SIZE[1] / 2 + 0.02, 1.6)), painting, 1.2


def covered(mesh, image, span_m):
    """Return a mesh with a picture on each of its faces, laid on by the two axes that the face spans most."""
    mesh.unmerge_vertices()
    away = np.abs(mesh.face_normals).argmax(axis=1).repeat(3)
    across = np.array([[1, 2], [0, 2], [0, 1]])[away]
    uv = np.take_along_axis(mesh.vertices, across, axis=1) / span_m
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image, doubleSided=True)
    mesh.visual = trimesh.visual.TextureVisuals(uv, material=material)
    return mesh


def main(path):
    scene = trimesh.Scene()
    for name, mesh, image, span_m in objects():
        scene.add_geometry(covered(mesh, image, span_m), node_name=name, geom_name=name, transform=TO_GLTF)
    Path(path).write_bytes(scene.export(file_type="glb"))
    triangles = sum(len(mesh.faces) for mesh in scene.geometry.values())
    print(f"{path}: {len(scene.geometry)} objects, {triangles} triangles")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "room.glb")
