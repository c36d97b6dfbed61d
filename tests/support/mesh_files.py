"""Small files of meshes by the writers of others: trimesh, pygltflib, DracoPy, meshopt, plyfile.

Each shows two unit squares that face the origin: Left at x = -2, Right at x = 2, both from y = -0.5 to 0.5
and z = 0 to 1, in world axes. Left is red in its lower half and green above; Right is blue, and has a white
quarter at its upper end towards y = 0.5.
"""

import io
import json

import DracoPy
import meshopt
import numpy as np
import plyfile
import pygltflib
import trimesh
from PIL import Image

RED = (255, 0, 0)
GREEN = (0, 255, 0)
BLUE = (0, 0, 255)
WHITE = (255, 255, 255)
SQUARE = np.array([[-0.5, 0.0], [0.5, 0.0], [0.5, 1.0], [-0.5, 1.0]])
"""y and z of the corners."""
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0.0]])
"""Of the corners, from a picture's upper left."""


def corners_w(x):
    """Return the corners (4, 3) of a square, world axes."""
    return np.column_stack([np.full(4, x), SQUARE])


def picture(name):
    """Return the picture (8, 8, 3) of a square."""
    pixels = np.zeros((8, 8, 3), np.uint8)
    if name == "Left":
        pixels[:4] = GREEN
        pixels[4:] = RED
    else:
        pixels[:] = BLUE
        pixels[:4, 4:] = WHITE
    return pixels


def png(pixels):
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


def y_up(points):
    """Return points (N, 3) of world axes in those of glTF."""
    return np.column_stack([points[:, 0], points[:, 2], -points[:, 1]])


class Builder:
    """A glTF file, put together by hand and written by pygltflib."""

    def __init__(self):
        self.json = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": [],
            "accessors": [], "bufferViews": [], "buffers": [], "materials": [], "textures": [], "images": [],
        }  # fmt: skip
        self.data = bytearray()

    def add(self, kind, item):
        self.json.setdefault(kind, []).append(item)
        return len(self.json[kind]) - 1

    def view(self, data, **more):
        while len(self.data) % 4:
            self.data += b"\0"
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more}
        self.data += data
        return self.add("bufferViews", view)

    def accessor(self, array, **more):
        types = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
        array = np.ascontiguousarray(array)
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[1 if array.ndim == 1 else array.shape[1]]
        item = {"componentType": types[array.dtype.str[1:]], "count": len(array), "type": kind, **more}
        if "bufferView" not in item:
            item["bufferView"] = self.view(array.tobytes())
        return self.add("accessors", item)

    def paint(self, name, **more):
        """Add a material with a square's picture, and return its number."""
        image = self.add("images", {"bufferView": self.view(png(picture(name))), "mimeType": "image/png"})
        info = {"index": self.add("textures", {"source": image}), **more}
        surface = {"baseColorTexture": info}
        return self.add(
            "materials", {"name": f"paint {name}", "pbrMetallicRoughness": surface, "doubleSided": True}
        )

    def node(self, name, primitive, **more):
        mesh = self.add("meshes", {"primitives": [primitive]})
        number = self.add("nodes", {"name": name, "mesh": mesh, **more})
        self.json["scenes"][0]["nodes"].append(number)
        return number

    def square(self, name, x, **more):
        """Add a square with its picture as a node of its own."""
        attributes = {
            "POSITION": self.accessor(y_up(corners_w(x)).astype("f4")),
            "TEXCOORD_0": self.accessor(UV.astype("f4")),
        }
        primitive = {"attributes": attributes, "indices": self.accessor(FACES.ravel().astype("u2"))}
        return self.node(name, {**primitive, "material": self.paint(name), **more})

    def write(self, path):
        self.json["buffers"] = [{"byteLength": len(self.data)}]
        for kind in [key for key, value in self.json.items() if value == []]:
            del self.json[kind]
        file = pygltflib.GLTF2.from_json(json.dumps(self.json))
        file.set_binary_blob(bytes(self.data))
        file.save_binary(str(path))


def plain_glb(path):
    built = Builder()
    built.square("Left", -2)
    built.square("Right", 2)
    built.write(path)


def tree_glb(path):
    """One mesh, placed twice by a tree of nodes: turned, scaled, mirrored; strips and fans; 8-bit indices."""
    built = Builder()
    unit = np.column_stack([np.zeros(4), SQUARE])
    uv = built.accessor(UV.astype("f4"))
    place = built.accessor(y_up(unit).astype("f4"))
    attributes = {"POSITION": place, "TEXCOORD_0": uv}
    strip = {"attributes": attributes, "mode": 5, "indices": built.accessor(np.array([0, 1, 3, 2], "u1"))}
    fan = {"attributes": attributes, "mode": 6, "indices": built.accessor(np.arange(4, dtype="u4"))}
    left = built.add("meshes", {"primitives": [{**strip, "material": built.paint("Left")}]})
    right = built.add("meshes", {"primitives": [{**fan, "material": built.paint("Right")}]})
    half = built.add("nodes", {"name": "Left", "mesh": left, "scale": [0.5, 0.5, 0.5]})
    twice = built.add("nodes", {"children": [half], "scale": [2, 2, 2], "translation": [-2, 0, 0]})
    turned = built.add("nodes", {"name": "Right", "mesh": right, "rotation": [0, 1, 0, 0]})
    matrix = np.diag([-1.0, 1, -1, 1])
    matrix[0, 3] = 2
    back = built.add("nodes", {"children": [turned], "matrix": matrix.T.ravel().tolist()})
    built.json["scenes"][0]["nodes"] = [twice, back]
    built.write(path)


def quantized_glb(path):
    """Positions of 16 bits, normalized and scaled by the node; places in pictures of 16 bits."""
    built = Builder()
    for name, x in (("Left", -2), ("Right", 2)):
        whole = np.round(y_up(corners_w(x)) / 2 * 32767).astype("i2")
        padded = np.column_stack([whole, np.zeros(4, "i2")])  # rows of 4 bytes each
        view = built.view(padded.tobytes(), byteStride=8)
        place = {"bufferView": view, "componentType": 5122, "count": 4, "type": "VEC3", "normalized": True}
        attributes = {
            "POSITION": built.add("accessors", place),
            "TEXCOORD_0": built.accessor((UV * 65535).astype("u2"), normalized=True),
        }
        indices = built.accessor(FACES.ravel().astype("u1"))
        primitive = {"attributes": attributes, "indices": indices, "material": built.paint(name)}
        built.node(name, primitive, scale=[2, 2, 2])
    built.json["extensionsRequired"] = built.json["extensionsUsed"] = ["KHR_mesh_quantization"]
    built.write(path)


def transformed_glb(path):
    """Pictures that are moved, scaled and turned on their squares; unlit."""
    built = Builder()
    for name, x in (("Left", -2), ("Right", 2)):
        transform = {"rotation": np.pi / 2, "scale": [0.5, 0.5], "offset": [1.0, 0.0]}
        turn = np.array([[0, 1], [-1, 0]])  # of the specification, for a quarter of a turn
        places = 2 * ((UV - [1.0, 0.0]) @ turn)
        reached = (places * 0.5) @ turn.T + [1.0, 0.0]
        np.testing.assert_allclose(reached, UV, atol=1e-12)
        attributes = {
            "POSITION": built.accessor(y_up(corners_w(x)).astype("f4")),
            "TEXCOORD_1": built.accessor(places.astype("f4")),
        }
        more = {"extensions": {"KHR_texture_transform": {**transform, "texCoord": 1}}}
        material = built.paint(name, **more)
        built.json["materials"][material]["extensions"] = {"KHR_materials_unlit": {}}
        indices = built.accessor(FACES.ravel().astype("u2"))
        built.node(name, {"attributes": attributes, "indices": indices, "material": material})
    built.json["extensionsUsed"] = ["KHR_texture_transform", "KHR_materials_unlit"]
    built.write(path)


def draco_glb(path):
    built = Builder()
    for name, x in (("Left", -2), ("Right", 2)):
        place = y_up(corners_w(x)).astype("f4")
        data = DracoPy.encode(place, FACES.astype("u4"), tex_coord=UV, quantization_bits=20)
        numbers = {row["attribute_type"]: row["unique_id"] for row in DracoPy.decode(data).attributes}
        view = built.view(data)
        attributes = {}
        for key, kind, count, width in (("POSITION", 0, 4, "VEC3"), ("TEXCOORD_0", 3, 4, "VEC2")):
            attributes[key] = built.add("accessors", {"componentType": 5126, "count": count, "type": width})
            numbers[key] = numbers.pop(kind)
        indices = built.add("accessors", {"componentType": 5125, "count": 6, "type": "SCALAR"})
        packed = {"KHR_draco_mesh_compression": {"bufferView": view, "attributes": numbers}}
        primitive = {"attributes": attributes, "indices": indices, "extensions": packed}
        built.node(name, {**primitive, "material": built.paint(name)})
    built.json["extensionsRequired"] = built.json["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    built.write(path)


def meshopt_glb(path):
    built = Builder()

    def packed(array, mode):
        data = meshopt.encode_gltf_buffer(array, mode)
        stride = array.itemsize * (array.shape[1] if array.ndim == 2 else 1)
        row = built.json["bufferViews"][built.view(data)]
        pack = {"buffer": 0, "byteOffset": row["byteOffset"], "byteLength": len(data), "byteStride": stride}
        pack |= {"count": len(array), "mode": mode}
        more = {"byteStride": stride} if mode == "ATTRIBUTES" else {}
        return built.view(array.tobytes(), extensions={"EXT_meshopt_compression": pack}, **more)

    for name, x in (("Left", -2), ("Right", 2)):
        place = y_up(corners_w(x)).astype("f4")
        faces = FACES.ravel().astype("u4")
        attributes = {
            "POSITION": built.accessor(place, bufferView=packed(place, "ATTRIBUTES")),
            "TEXCOORD_0": built.accessor(UV.astype("f4"), bufferView=packed(UV.astype("f4"), "ATTRIBUTES")),
        }
        indices = built.accessor(faces, bufferView=packed(faces, "TRIANGLES"))
        built.node(name, {"attributes": attributes, "indices": indices, "material": built.paint(name)})
    built.json["extensionsRequired"] = built.json["extensionsUsed"] = ["EXT_meshopt_compression"]
    built.write(path)


def trimesh_scene():
    scene = trimesh.Scene()
    for name, x in (("Left", -2), ("Right", 2)):
        material = trimesh.visual.material.PBRMaterial(
            name=f"paint {name}", baseColorTexture=Image.fromarray(picture(name)), doubleSided=True
        )
        visual = trimesh.visual.TextureVisuals(np.column_stack([UV[:, 0], 1 - UV[:, 1]]), material=material)
        mesh = trimesh.Trimesh(y_up(corners_w(x)), FACES, process=False, visual=visual)
        scene.add_geometry(mesh, node_name=name, geom_name=name)
    return scene


def trimesh_gltf(path):
    """A .gltf file with buffers and pictures beside it."""
    for name, data in trimesh_scene().export(file_type="gltf").items():
        (path.parent / (path.name if name == "model.gltf" else name)).write_bytes(data)


def obj(path):
    """Groups, materials by name, negative indices, lines that go on, quads."""
    lines = ["mtllib paint.mtl"]
    materials = ""
    for name, x in (("Left", -2), ("Right", 2)):
        Image.fromarray(picture(name)).save(path.parent / f"{name} picture.png")
        materials += f"newmtl paint {name}\nKd 1 1 1\nmap_Kd -clamp on {name} picture.png\n"
        lines += [f"o {name}", f"usemtl paint {name}"]
        lines += [f"v {a!r} \\\n {b!r} {c!r}" for a, b, c in corners_w(x).tolist()]
        lines += [f"vt {u!r} {1 - v!r}" for u, v in UV.tolist()]
        if name == "Left":
            lines.append("f 1/1 2/2/7 \\\n 3/3 4/4")
        else:
            lines.append("f -4/-4 -3/-3 -2/-2 -1/-1  # all of it")
    (path.parent / "paint.mtl").write_text(materials)
    path.write_text("\r\n".join(lines))


def ply(path, text=False, order="<", double=False, quads=False):
    """Vertex colours, and the objects of faces by number: Left is 7, Right is 12."""
    number = "f8" if double else "f4"
    colors = [RED, RED, GREEN, GREEN, BLUE, BLUE, WHITE, BLUE]
    points = np.concatenate([corners_w(-2), corners_w(2)])
    vertex = np.array(
        [(*point, *color) for point, color in zip(points.tolist(), colors, strict=True)],
        [("x", number), ("y", number), ("z", number), ("red", "u1"), ("green", "u1"), ("blue", "u1")],
    )
    if quads:
        rows = [([0, 1, 2, 3], 7), ([4, 5, 6, 7], 12)]
    else:
        rows = [(face, number) for start, number in ((0, 7), (4, 12)) for face in (FACES + start).tolist()]
    face = np.empty(len(rows), [("vertex_indices", "O"), ("object_id", "u1")])
    for i, (corners, number) in enumerate(rows):
        face[i] = (np.array(corners, "i4"), number)
    elements = [plyfile.PlyElement.describe(vertex, "vertex"), plyfile.PlyElement.describe(face, "face")]
    plyfile.PlyData(elements, text=text, byte_order=order).write(str(path))


def by_trimesh(path):
    """Both squares as one mesh, of forms that know neither names nor colours."""
    points = np.concatenate([corners_w(-2), corners_w(2)])
    mesh = trimesh.Trimesh(points, np.concatenate([FACES, FACES + 4]), process=False)
    mesh.export(path)


FORMS = {
    "glb": ("room.glb", plain_glb),
    "glb tree": ("room.glb", tree_glb),
    "glb quantized": ("room.glb", quantized_glb),
    "glb texture transform": ("room.glb", transformed_glb),
    "glb draco": ("room.glb", draco_glb),
    "glb meshopt": ("room.glb", meshopt_glb),
    "gltf": ("room.gltf", trimesh_gltf),
    "obj": ("room.obj", obj),
    "ply text": ("room.ply", lambda path: ply(path, text=True)),
    "ply big endian quads": ("room.ply", lambda path: ply(path, order=">", quads=True)),
    "ply doubles": ("room.ply", lambda path: ply(path, double=True)),
    "stl": ("room.stl", by_trimesh),
    "off": ("room.off", by_trimesh),
}
"""By form: the file's name, and its writer."""
